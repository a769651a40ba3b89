"""The probability that parameters give a tree."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from fascicle.inference.surrogate.exponential import ExponentialGP, Hyperparameters, fit
from fascicle.inference.surrogate.observations import Observations


@dataclass(frozen=True)
class FeasibilityGP:
    """Gaussian process on the labels +1 (a tree) and −1 (none), read through the normal c.d.f.

    The probability is Φ((b + m(x)) / √(v(x) + σₙ²)) with b the mean label: least-squares
    classification (Rasmussen & Williams 2006, section 6.5). It needs no approximate inference, so
    it is fast and always has a solution.

    Attributes
    ----------
    gp : ExponentialGP or None
        Of label − `offset`; None as long as every known point is feasible: the probability is 1.
    offset : float
        Mean label.
    """

    gp: ExponentialGP | None
    offset: float

    @classmethod
    def fit(
        cls, observations: Observations, start: Hyperparameters | None, iterations: int
    ) -> FeasibilityGP:
        """Learn the hyper-parameters and condition on the labels.

        Parameters
        ----------
        observations : Observations
        start : Hyperparameters or None
            Where to start; None starts at the modes of the priors.
        iterations : int
            At most so many L-BFGS-B iterations.
        """
        if observations.feasible.all():
            return cls(None, 1.0)
        labels = np.where(observations.feasible, 1.0, -1.0)
        hyperparameters = fit(observations.points, labels - labels.mean(), start, iterations)
        return cls.condition(observations, hyperparameters)

    @classmethod
    def condition(
        cls, observations: Observations, hyperparameters: Hyperparameters | None
    ) -> FeasibilityGP:
        """Condition on the labels; `hyperparameters` None stands for 'all feasible'."""
        if hyperparameters is None:
            return cls(None, 1.0)
        labels = np.where(observations.feasible, 1.0, -1.0)
        offset = float(labels.mean())
        gp = ExponentialGP.condition(observations.points, labels - offset, hyperparameters)
        return cls(gp, offset)

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """Those of the process; None as long as every known point is feasible."""
        return self.gp.hyperparameters if self.gp is not None else None

    def log_probability(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Logarithm of the probability that each of `points` (m, d) gives a tree, shape (m,)."""
        if self.gp is None:
            return np.zeros(len(points))
        mean, variance = self.gp.predict(points)
        z = (self.offset + mean) / np.sqrt(variance + self.gp.hyperparameters.noise)
        return np.asarray(log_ndtr(z))

    def log_probability_and_gradient(
        self, point: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64]]:
        """Logarithm of the probability at one `point` (d,), and its gradient (d,).

        With z = (b + m) / s and s² = v + σₙ²: ∇ log Φ(z) = φ(z)/Φ(z) · (∇m − z ∇v / 2s) / s.
        """
        if self.gp is None:
            return 0.0, np.zeros_like(point)
        mean, variance, by_mean, by_variance = self.gp.moments_and_gradients(point)
        s = math.sqrt(variance + self.gp.hyperparameters.noise)
        z = (self.offset + mean) / s
        logarithm = float(log_ndtr(z))
        ratio = math.exp(-0.5 * z * z - 0.5 * math.log(2 * math.pi) - logarithm)
        return logarithm, ratio * (by_mean - z * by_variance / (2 * s)) / s

    def probability(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability that each of `points` (m, d) gives a tree, shape (m,)."""
        return np.exp(self.log_probability(points))
