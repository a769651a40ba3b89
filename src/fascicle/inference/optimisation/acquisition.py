"""Expected improvement where a tree is expected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats
from fascicle.inference.optimisation.log_improvement import (
    log_expected_improvement,
    log_expected_improvement_slopes,
)
from fascicle.inference.surrogate.exponential import ExponentialGP
from fascicle.inference.surrogate.surrogates import FeasibilityGP

RAW_UNIFORM = 2000
RAW_LOCAL = 1000  # perturbations of the best points: the kernel has a cusp there
LOCAL_CENTRES = 5
LOCAL_SPREAD = (1e-3, 0.3)  # of the unit cube, log-uniform
RESTARTS = 4  # of each kind of raw point
ITERATIONS = 60  # of all restarts together
NEAREST = 1e-4  # a proposal nearer to a known point (any coordinate's range is 1) adds nothing


@dataclass(frozen=True)
class FeasibleLogImprovement:
    """log EI(x) + log P(x is feasible), after Gardner et al. (ICML 2014).

    Attributes
    ----------
    gp : ExponentialGP
        Of the standardised loss.
    feasibility : FeasibilityGP
    best : float
        The standardised loss to improve on.
    """

    gp: ExponentialGP
    feasibility: FeasibilityGP
    best: float

    def __call__(self, points: Floats) -> Floats:
        """Value at `points` (m, d), shape (m,)."""
        mean, variance = self.gp.predict(points)
        improvement = log_expected_improvement(mean, variance, self.best)
        return improvement + self.feasibility.log_probability(points)

    def with_gradients(self, points: Floats) -> tuple[Floats, Floats]:
        """Value at a few `points` (k, d), shape (k,), and the gradients (k, d)."""
        mean, variance, by_mean, by_variance = self.gp.moments_and_gradients(points)
        improvement = log_expected_improvement(mean, variance, self.best)
        per_mean, per_variance = log_expected_improvement_slopes(mean, variance, self.best)
        feasible, gradients = self.feasibility.log_probability_and_gradient(points)
        by_improvement = per_mean[:, None] * by_mean + per_variance[:, None] * by_variance
        return improvement + feasible, gradients + by_improvement


def maximise(
    rng: np.random.Generator,
    acquisition: FeasibleLogImprovement,
    best_points: Floats,
    known: Floats,
) -> Floats:
    """Find the best point of the unit cube for an acquisition function, shape (d,).

    Uniform raw points and perturbations of the best points, the best few of each polished by
    L-BFGS-B.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    acquisition : FeasibleLogImprovement
    best_points : (k, d) array
        What is perturbed.
    known : (n, d) array
        The result keeps `NEAREST` away from these.
    """
    uniform = rng.random((RAW_UNIFORM, best_points.shape[1]))
    local = perturbed(rng, best_points, RAW_LOCAL)
    raw, values = [uniform, local], [acquisition(uniform), acquisition(local)]
    starts = np.vstack([x[_descending(v)[:RESTARTS]] for x, v in zip(raw, values, strict=True)])
    polished = _polished(acquisition, starts)
    candidates = np.vstack([polished, *raw])
    order = _descending(np.concatenate([acquisition(polished), *values]))
    return first_apart(candidates[order], known)


def first_apart(candidates: Floats, known: Floats) -> Floats:
    """Find the first candidate, of (m, d), that is `NEAREST` away from all known points (n, d)."""
    distance, _ = cKDTree(known).query(candidates, p=np.inf, distance_upper_bound=NEAREST)
    return np.asarray(candidates[np.isinf(distance).argmax()])  # none is found: infinite


def _descending(values: Floats) -> NDArray[np.intp]:
    return np.argsort(-values, kind="stable")


def _polished(acquisition: FeasibleLogImprovement, starts: Floats) -> Floats:
    """Ends (k, d) of searches from `starts` (k, d), all in one, as sum: that costs half as much.

    Where it stops early, its points are judged by their values like the others.
    """

    def negative(vector: Floats) -> tuple[float, Floats]:
        values, gradients = acquisition.with_gradients(vector.reshape(starts.shape))
        return -float(values.sum()), -gradients.ravel()

    bounds, options = [(0.0, 1.0)] * starts.size, {"maxiter": ITERATIONS}
    begin = starts.ravel()
    result = minimize(negative, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return np.asarray(np.clip(result.x, 0.0, 1.0).reshape(starts.shape))


def perturbed(rng: np.random.Generator, centres: Floats, count: int) -> Floats:
    """Gaussian perturbations (count, d) of some points in a random subset of coordinates.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    centres : (k, d) array
        Points of the unit cube, each as likely as the others to be perturbed.
    count : int
    """
    dimension = centres.shape[1]
    low, high = np.log(LOCAL_SPREAD)
    spread = np.exp(rng.uniform(low, high, (count, 1)))
    moved = rng.random((count, dimension)) < rng.random((count, 1))
    moved[np.arange(count), rng.integers(dimension, size=count)] = True
    points = centres[rng.integers(len(centres), size=count)]
    shifted = points + moved * spread * rng.standard_normal((count, dimension))
    return np.asarray(np.clip(shifted, 0.0, 1.0))
