"""The surrogate of the loss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fascicle.inference.surrogate.exponential import ExponentialGP, Hyperparameters, fit
from fascicle.inference.surrogate.observations import Observations

EQUAL = 1e-12  # losses whose standard deviation is this small a part of their mean are equal


@dataclass(frozen=True)
class LossGP:
    """Zero-mean process on the standardised losses of the feasible points.

    Attributes
    ----------
    gp : ExponentialGP
        Of the standardised loss.
    offset, scale : float
        Mean and standard deviation of the losses (mV²).
    """

    gp: ExponentialGP
    offset: float
    scale: float

    @classmethod
    def fit(
        cls, observations: Observations, start: Hyperparameters | None, iterations: int
    ) -> LossGP:
        """Learn the hyper-parameters and condition on the losses.

        Parameters
        ----------
        observations : Observations
        start : Hyperparameters or None
            Where to start; None starts at the modes of the priors.
        iterations : int
            At most so many L-BFGS-B iterations.
        """
        points, z, _, _ = _standardised(observations)
        return cls.condition(observations, fit(points, z, start, iterations))

    @classmethod
    def condition(cls, observations: Observations, hyperparameters: Hyperparameters) -> LossGP:
        """Condition on the losses with known hyper-parameters."""
        points, z, offset, scale = _standardised(observations)
        return cls(ExponentialGP.condition(points, z, hyperparameters), offset, scale)

    def with_guess(
        self, observations: Observations, point: NDArray[np.float64]
    ) -> tuple[LossGP, Observations]:
        """Believe the mean at a pending `point` (d,) (kriging believer), and count it as known.

        Hyper-parameters, offset and scale stay.
        """
        grown = observations.with_guess(point, float(self.predict(point[None, :])[0][0]))
        feasible = grown.feasible
        z = (grown.losses[feasible] - self.offset) / self.scale
        gp = ExponentialGP.condition(grown.points[feasible], z, self.gp.hyperparameters)
        return LossGP(gp, self.offset, self.scale), grown

    def predict(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (mV²) and variance (mV⁴) of the noise-free loss at `points` (m, d), (m,) each."""
        mean, variance = self.gp.predict(points)
        return self.offset + self.scale * mean, self.scale**2 * variance

    def mean_many(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (mV²) at millions of points (m, d), and their nearness to the data, (m,) each."""
        mean, nearness = self.gp.mean_many(points)
        return self.offset + self.scale * mean, nearness

    def variance_limit(self, nearness: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance (mV⁴) that points of this nearness to the data cannot exceed, shape (m,)."""
        return self.scale**2 * self.gp.variance_limit(nearness)


def _standardised(
    observations: Observations,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Feasible points, their standardised losses, and the mean and deviation taken out."""
    feasible = observations.feasible
    losses = observations.losses[feasible]
    offset, scale = float(losses.mean()), float(losses.std())
    scale = scale if scale > EQUAL * abs(offset) else 1.0  # equal losses have none of their own
    return observations.points[feasible], (losses - offset) / scale, offset, scale
