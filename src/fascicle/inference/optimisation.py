"""Bayesian optimisation: the first points, and one step to the largest expected improvement.

Expected improvement is taken by its logarithm, safe where improvement is next to impossible.
For a predicted mean m and standard deviation s, expected improvement is s h(u), u = (best − m)/s,

    h(u) = φ(u) + u Φ(u),

φ and Φ being the density and the distribution function of the standard normal. Far below zero h
underflows, and u Φ(u) cancels φ(u) long before; so its logarithm is taken in three regimes, as by
Ament et al.:

    u > −1            log(φ(u) + u Φ(u))
    −1000 < u ≤ −1    log φ(u) + log(1 − |u| M(|u|)),    M(x) = Φ(−x)/φ(x) = √(π/2) erfcx(x/√2)
    u ≤ −1000         log φ(u) + log((1 − 3/u²)/u²)

M is Mills' ratio. The last line has the first two terms of its asymptotic series; what these leave
out at u = −1000, and what the cancellation in the second line loses there, is about 1e-10.

References
----------
S. Ament, S. Daulton, D. Eriksson, M. Balandat, E. Bakshy, "Unexpected improvements to expected
improvement for Bayesian optimization", NeurIPS 2023.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.special import erfcx, ndtr
from scipy.stats import qmc

from fascicle.core.arrays import Floats
from fascicle.core.threads import one_thread
from fascicle.inference.gaussian_process import ExponentialGP, Hyperparameters
from fascicle.inference.surrogates import FeasibilityGP, LossGP, Observations


def latin_hypercube(rng: np.random.Generator, count: int, dimension: int) -> Floats:
    """Sample (count, dimension) of the unit cube, after McKay et al. (Technometrics 21, 1979).

    Every coordinate has exactly one point in each of `count` equal intervals.
    """
    return np.asarray(qmc.LatinHypercube(d=dimension, rng=rng).random(count), dtype=np.float64)


@dataclass(frozen=True)
class Surrogates:
    """Observations of the optimisation, and Gaussian processes conditioned on them.

    Attributes
    ----------
    observations : Observations
        At least one of them feasible.
    learnt_from : int
        Number of observations, the first ones, from which the hyper-parameters were learnt.
    loss : LossGP
    feasibility : FeasibilityGP
        Not in the paper, whose trees always grow; used to propose points, and for nothing else.
    """

    observations: Observations
    learnt_from: int
    loss: LossGP
    feasibility: FeasibilityGP

    @classmethod
    def learn(cls, observations: Observations, before: Surrogates | None = None) -> Surrogates:
        """Learn the hyper-parameters, starting from earlier ones where there are any."""
        start = before.loss.gp.hyperparameters if before is not None else None
        loss = LossGP.fit(observations, start, iterations(start))
        start = before.feasibility.hyperparameters if before is not None else None
        feasibility = FeasibilityGP.fit(observations, start, iterations(start))
        return cls(observations, len(observations), loss, feasibility)

    def extended(self, observations: Observations) -> Surrogates:
        """Condition on more observations, the new ones last, with the same hyper-parameters."""
        return replace(
            self,
            observations=observations,
            loss=self.loss.extended(observations),
            feasibility=self.feasibility.extended(observations),
        )

    def updated(self, observations: Observations, refit_every: int) -> Surrogates:
        """Condition on more observations; learn again where it is time, or a first tree failed."""
        first_failure = self.feasibility.gp is None and not observations.feasible.all()
        if first_failure or len(observations) - self.learnt_from >= refit_every:
            return Surrogates.learn(observations, self)
        return self.extended(observations)

    def to_json(self) -> str:
        """Give the state besides the observations, as text; every float comes back exactly."""
        feasibility = self.feasibility.hyperparameters
        return json.dumps(
            {
                "loss": self.loss.gp.hyperparameters.to_json(),
                "feasibility": feasibility.to_json() if feasibility is not None else None,
                "learnt_from": self.learnt_from,
                "observations": len(self.observations),
            }
        )

    @classmethod
    def from_json(cls, text: str, observations: Observations) -> Surrogates:
        """Restore surrogates, bit for bit, from the text of `to_json` and the observations."""
        state = json.loads(text)
        loss = Hyperparameters.from_json(state["loss"])
        labels = state["feasibility"]
        first = observations.first(state["learnt_from"])
        learnt = cls(
            first,
            state["learnt_from"],
            LossGP.condition(first, loss),
            FeasibilityGP.condition(first, Hyperparameters.from_json(labels) if labels else None),
        )
        return learnt.extended(observations.first(state["observations"]))


@one_thread
def step(rng: np.random.Generator, surrogates: Surrogates) -> Floats:
    """Propose the next point to evaluate, shape (d,).

    It maximises expected improvement times the probability of feasibility.
    """
    observations, loss = surrogates.observations, surrogates.loss
    points = observations.points[observations.feasible]
    mean, _ = loss.gp.predict(points)
    order = np.argsort(mean, kind="stable")
    best = float(mean[order[0]])
    acquisition = FeasibleLogImprovement(loss.gp, surrogates.feasibility, best)
    return maximise(rng, acquisition, points[order[:5]], observations.points)


def iterations(start: Hyperparameters | None) -> int:
    """Largest number of L-BFGS-B iterations of a fit from this start."""
    return 100 if start is None else 10


@dataclass(frozen=True)
class FeasibleLogImprovement:
    """log EI(x) + log P(x is feasible), after Gardner et al. (ICML 2014).

    `gp` is of the standardised loss; `best` is the loss to improve on.
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
    observed: Floats,
) -> Floats:
    """Find the best point of the unit cube for an acquisition function, shape (d,).

    Candidates are uniform points, and perturbations of the best points (k, d), where the kernel has
    a cusp; the best few of each are polished by L-BFGS-B. The result keeps away from
    observed points (n, d), see `first_apart`.
    """
    uniform = rng.random((2000, best_points.shape[1]))
    local = perturbed(rng, best_points, 1000)
    raw, values = [uniform, local], [acquisition(uniform), acquisition(local)]
    starts = np.vstack(
        [x[np.argsort(-v, kind="stable")[:4]] for x, v in zip(raw, values, strict=True)]
    )
    polished = _polished(acquisition, starts)
    values = [acquisition(polished), *values]
    order = np.argsort(-np.concatenate(values), kind="stable")
    return first_apart(np.vstack([polished, *raw])[order], observed)


def first_apart(candidates: Floats, observed: Floats) -> Floats:
    """Find the first candidate, of (m, d), that is 1e-4 away from all observed points (n, d).

    A nearer one (any coordinate's range is 1) adds nothing.
    """
    distance, _ = cKDTree(observed).query(candidates, p=np.inf, distance_upper_bound=1e-4)
    return np.asarray(
        candidates[np.isinf(distance).argmax()]
    )  # infinite: no observed point so near


def _polished(acquisition: FeasibleLogImprovement, starts: Floats) -> Floats:
    """Maxima (k, d) of searches from `starts` (k, d), joined in one on the sum at half the cost.

    Where it stops early, its points are judged by their values like the others.
    """

    def negative(vector: Floats) -> tuple[float, Floats]:
        values, gradients = acquisition.with_gradients(vector.reshape(starts.shape))
        return -float(values.sum()), -gradients.ravel()

    bounds, options = [(0.0, 1.0)] * starts.size, {"maxiter": 60}
    begin = starts.ravel()
    result = minimize(negative, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return np.asarray(np.clip(result.x, 0.0, 1.0).reshape(starts.shape))


def perturbed(rng: np.random.Generator, centres: Floats, count: int) -> Floats:
    """Gaussian perturbations (count, d) of some points in a random subset of coordinates.

    The centres (k, d) are equally likely; deviations are log-uniform from 1e-3 to 0.3.
    """
    dimension = centres.shape[1]
    low, high = np.log((1e-3, 0.3))
    spread = np.exp(rng.uniform(low, high, (count, 1)))
    moved = rng.random((count, dimension)) < rng.random((count, 1))
    moved[np.arange(count), rng.integers(dimension, size=count)] = True
    points = centres[rng.integers(len(centres), size=count)]
    shifted = points + moved * spread * rng.standard_normal((count, dimension))
    return np.asarray(np.clip(shifted, 0.0, 1.0))


def log_h(u: Floats | float) -> Floats:
    """Logarithm of h(u) = φ(u) + u Φ(u), elementwise."""
    upper, lower = np.maximum(u, -1.0), np.minimum(u, -1.0)
    direct = np.log(_density(upper) + upper * ndtr(upper))
    safe = -0.5 * lower**2 - 0.5 * math.log(2 * math.pi) + np.log(_h_over_density(lower))
    return np.asarray(np.where(u > -1.0, direct, safe))


def log_expected_improvement(mean: Floats | float, variance: Floats | float, best: float) -> Floats:
    """Logarithm of the expected improvement below `best` of normal predictions (m,)."""
    deviation = np.sqrt(variance)
    return np.asarray(log_h((best - mean) / deviation) + np.log(deviation))


def log_expected_improvement_slopes(
    mean: Floats | float, variance: Floats | float, best: float
) -> tuple[Floats, Floats]:
    """Derivatives of `log_expected_improvement` with respect to mean and variance, elementwise.

    ∂/∂m = −Φ(u)/(s h) and ∂/∂s² = φ(u)/(2 s² h), for predictions m, s². Of Φ/h and φ/h neither
    underflows.
    """
    deviation = np.sqrt(variance)
    u = (best - mean) / deviation
    upper, lower = np.maximum(u, -1.0), np.minimum(u, -1.0)
    h, safe_ratio = np.exp(log_h(upper)), 1 / _h_over_density(lower)
    density_ratio = np.where(u > -1.0, _density(upper) / h, safe_ratio)
    probability_ratio = np.where(u > -1.0, ndtr(upper) / h, _mills(-lower) * safe_ratio)
    return np.asarray(-probability_ratio / deviation), np.asarray(density_ratio / (2 * variance))


def _density(u: Floats | float) -> Floats:
    return np.asarray(np.exp(-0.5 * np.square(u) - 0.5 * math.log(2 * math.pi)))


def _mills(x: Floats | float) -> Floats:
    """Mills' ratio Φ(−x)/φ(x)."""
    return np.asarray(math.sqrt(math.pi / 2) * erfcx(np.asarray(x) / math.sqrt(2)))


def _h_over_density(u: Floats | float) -> Floats:
    """h(u)/φ(u) = 1 − |u| M(|u|) where u ≤ −1."""
    x = -np.asarray(u)
    near = np.minimum(x, 1e3)
    far = (1 - 3 / x**2) / x**2
    return np.asarray(np.where(x < 1e3, 1 - near * _mills(near), far))
