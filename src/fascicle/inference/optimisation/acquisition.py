"""Expected improvement where a tree is expected."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from botorch.acquisition import LogExpectedImprovement
from botorch.exceptions.warnings import OptimizationWarning
from botorch.generation.gen import gen_candidates_scipy
from botorch.models.model import Model
from numpy.typing import NDArray
from torch import Tensor

from fascicle.inference.surrogate.exponential import ExponentialGP, to_tensor
from fascicle.inference.surrogate.feasibility import FeasibilityGP
from fascicle.inference.surrogate.loss_gp import LossGP

RAW_UNIFORM = 2000
RAW_LOCAL = 1000  # perturbations of the best points: the kernel has a cusp there
LOCAL_CENTRES = 5
LOCAL_SPREAD = (1e-3, 0.3)  # of the unit cube, log-uniform
RESTARTS = 4  # of each kind of raw point
ITERATIONS = 40
NEAREST = 1e-4  # a proposal nearer to a known point (any coordinate's range is 1) tells nothing


class _Surrogate(Model):  # type: ignore[misc]
    """What BoTorch's analytic acquisition functions ask of a model: marginal moments."""

    num_outputs = 1

    def __init__(self, gp: ExponentialGP) -> None:
        super().__init__()
        self.gp = gp

    def posterior(self, X: Tensor, **_: Any) -> SimpleNamespace:
        """Mean and variance at X (b, 1, d), shape (b, 1, 1) each."""
        mean, variance = self.gp.moments(X[:, 0, :])
        return SimpleNamespace(mean=mean[:, None, None], variance=variance[:, None, None])


class FeasibleLogImprovement(LogExpectedImprovement):  # type: ignore[misc]
    """log EI(x) + log P(x is feasible), after Gardner et al. (ICML 2014).

    log EI is the numerically safe one of Ament et al. (NeurIPS 2023), of the standardised loss
    below the least posterior mean at a data point.
    """

    def __init__(self, loss: LossGP, feasibility: FeasibilityGP, best: float) -> None:
        super().__init__(_Surrogate(loss.gp), best_f=best, maximize=False)
        self.feasibility = feasibility

    def forward(self, X: Tensor) -> Tensor:
        """Value at X (b, 1, d), shape (b,)."""
        improvement: Tensor = super().forward(X)
        return improvement + self.feasibility.log_probability(X[:, 0, :])


@dataclass(frozen=True)
class Region:
    """A box inside the unit cube.

    Attributes
    ----------
    lower, upper : (d,) arrays
        Its corners.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @classmethod
    def everywhere(cls, dimension: int) -> Region:
        """Take the whole cube."""
        return cls(np.zeros(dimension), np.ones(dimension))

    @classmethod
    def around(cls, centre: NDArray[np.float64], radius: float) -> Region:
        """Take what of the cube is within `radius` of `centre` in every coordinate."""
        return cls(np.maximum(centre - radius, 0.0), np.minimum(centre + radius, 1.0))

    def draw(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Draw `count` uniform points, shape (count, d)."""
        width = self.upper - self.lower
        return np.asarray(self.lower + width * rng.random((count, len(self.lower))))

    def clip(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Move points outside to its surface."""
        return np.asarray(np.clip(points, self.lower, self.upper))


def maximise(
    rng: np.random.Generator,
    acquisition: FeasibleLogImprovement,
    best_points: NDArray[np.float64],
    known: NDArray[np.float64],
    region: Region,
) -> NDArray[np.float64]:
    """Find the best point of a region for an acquisition function, shape (d,).

    Uniform raw points and perturbations of `best_points` (k, d), the best few of each polished by
    L-BFGS-B; the winner keeps away from the `known` points (n, d).
    """
    uniform = region.draw(rng, RAW_UNIFORM)
    local = region.clip(perturbed(rng, best_points, RAW_LOCAL))
    starts = np.vstack([_best(acquisition, uniform), _best(acquisition, local)])
    with warnings.catch_warnings(record=True) as caught:  # BoTorch overrides any filter
        polished, _ = gen_candidates_scipy(
            to_tensor(starts)[:, None, :],
            acquisition,
            lower_bounds=to_tensor(region.lower),
            upper_bounds=to_tensor(region.upper),
            options={"maxiter": ITERATIONS},
        )
    for told in caught:
        # a line search that ends early leaves a point that is judged with the others below
        if not issubclass(told.category, OptimizationWarning):
            warnings.warn_explicit(told.message, told.category, told.filename, told.lineno)
    candidates = np.vstack([polished.detach().numpy()[:, 0, :], starts, uniform])
    gap = np.abs(candidates[:, None, :] - known[None, :, :]).max(2).min(1)
    allowed = candidates[gap > NEAREST]
    return np.array(allowed[np.argmax(_values(acquisition, allowed))])


def perturbed(
    rng: np.random.Generator, centres: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Gaussian perturbations (count, d) of `centres` (k, d) in a random subset of coordinates."""
    dimension = centres.shape[1]
    low, high = np.log(LOCAL_SPREAD)
    spread = np.exp(rng.uniform(low, high, (count, 1)))
    moved = rng.random((count, dimension)) < rng.random((count, 1))
    moved[np.arange(count), rng.integers(dimension, size=count)] = True
    points = centres[rng.integers(len(centres), size=count)]
    shifted = points + moved * spread * rng.standard_normal((count, dimension))
    return np.asarray(np.clip(shifted, 0.0, 1.0))


def _values(
    acquisition: FeasibleLogImprovement, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    with torch.no_grad():
        return np.array(acquisition(to_tensor(points)[:, None, :]).numpy())


def _best(acquisition: FeasibleLogImprovement, points: NDArray[np.float64]) -> NDArray[np.float64]:
    order = np.argsort(-_values(acquisition, points), kind="stable")
    return points[order[:RESTARTS]]
