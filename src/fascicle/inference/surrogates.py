"""Observed losses, and surrogates of the loss and of the probability of a tree."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from fascicle.core.arrays import Booleans, Floats
from fascicle.inference.evaluation import Evaluation
from fascicle.inference.gaussian_process import ExponentialGP, Hyperparameters, fit


@dataclass(frozen=True)
class Observations:
    """Points (n, d) of the unit cube and their losses (n,) (mV²), NaN without a tree."""

    points: Floats
    losses: Floats

    @classmethod
    def of(cls, evaluations: Iterable[Evaluation]) -> Observations:
        """Points and losses of some evaluations, in their order."""
        chosen = list(evaluations)
        return cls(
            np.array([evaluation.point for evaluation in chosen], dtype=np.float64),
            np.array([evaluation.loss for evaluation in chosen], dtype=np.float64),
        )

    @property
    def feasible(self) -> Booleans:
        """Mask (n,) of the points that have a loss."""
        return np.isfinite(self.losses)

    def __len__(self) -> int:
        return len(self.losses)

    def first(self, count: int) -> Observations:
        """Return the first `count` observations."""
        return Observations(self.points[:count], self.losses[:count])


@dataclass(frozen=True)
class LossGP:
    """Zero-mean process `gp` on the standardised losses of the feasible points.

    `offset` and `scale` are the mean and the standard deviation of the losses (mV²).
    """

    gp: ExponentialGP
    offset: float
    scale: float

    @classmethod
    def fit(
        cls, observations: Observations, start: Hyperparameters | None, iterations: int
    ) -> LossGP:
        """Learn the hyper-parameters, as `fit` does, and condition on the losses."""
        points, z, _, _ = _standardised(observations)
        return cls.condition(observations, fit(points, z, start, iterations))

    @classmethod
    def condition(cls, observations: Observations, hyperparameters: Hyperparameters) -> LossGP:
        """Condition on the losses with known hyper-parameters."""
        points, z, offset, scale = _standardised(observations)
        return cls(ExponentialGP.condition(points, z, hyperparameters), offset, scale)

    def extended(self, observations: Observations) -> LossGP:
        """Condition on more observations, the new ones last, with the same hyper-parameters."""
        points, z, offset, scale = _standardised(observations)
        return LossGP(self.gp.extended(points[len(self.gp.scaled) :], z), offset, scale)

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Mean (mV²) and variance (mV⁴) of the noise-free loss at `points` (m, d), (m,) each."""
        mean, variance = self.gp.predict(points)
        return self.offset + self.scale * mean, self.scale**2 * variance

    def mean_many(self, points: Floats) -> tuple[Floats, Floats]:
        """Mean (mV²) at millions of points (m, d), and their nearness to the data, (m,) each."""
        mean, nearness = self.gp.mean_many(points)
        return self.offset + self.scale * mean, nearness

    def variance_limit(self, nearness: Floats) -> Floats:
        """Variance (mV⁴) that points of this nearness to the data cannot exceed, shape (m,)."""
        return self.scale**2 * self.gp.variance_limit(nearness)


@dataclass(frozen=True)
class FeasibilityGP:
    """Gaussian process on labels +1 (a tree) and −1 (none), mapped by the normal c.d.f.

    The probability is Φ((b + m(x)) / √(v(x) + σₙ²)) with b the mean label: least-squares
    classification (Rasmussen & Williams 2006, section 6.5). It needs no approximate inference, so
    it is fast and always has a solution. The process `gp` is of the labels less b, the `offset`;
    None as long as every known point is feasible: the probability is 1.
    """

    gp: ExponentialGP | None
    offset: float

    @classmethod
    def fit(
        cls, observations: Observations, start: Hyperparameters | None, iterations: int
    ) -> FeasibilityGP:
        """Learn the hyper-parameters, as `fit` does, and condition on the labels."""
        if observations.feasible.all():
            return cls(None, 1.0)
        centred, _ = _labels(observations)
        return cls.condition(observations, fit(observations.points, centred, start, iterations))

    @classmethod
    def condition(
        cls, observations: Observations, hyperparameters: Hyperparameters | None
    ) -> FeasibilityGP:
        """Condition on the labels with known hyper-parameters; None if all points are feasible."""
        if hyperparameters is None:
            return cls(None, 1.0)
        centred, offset = _labels(observations)
        return cls(ExponentialGP.condition(observations.points, centred, hyperparameters), offset)

    def extended(self, observations: Observations) -> FeasibilityGP:
        """Condition on more observations, the new ones last, with the same hyper-parameters."""
        if self.gp is None:
            return self
        centred, offset = _labels(observations)
        new = observations.points[len(self.gp.scaled) :]
        return FeasibilityGP(self.gp.extended(new, centred), offset)

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """Hyper-parameters of the process; None as long as every known point is feasible."""
        return self.gp.hyperparameters if self.gp is not None else None

    def log_probability(self, points: Floats) -> Floats:
        """Logarithm of the probability that each of `points` (m, d) gives a tree, shape (m,)."""
        if self.gp is None:
            return np.zeros(len(points))
        mean, variance = self.gp.predict(points)
        z = (self.offset + mean) / np.sqrt(variance + self.gp.hyperparameters.noise)
        return np.asarray(log_ndtr(z))

    def log_probability_and_gradient(self, points: Floats) -> tuple[Floats, Floats]:
        """Logarithm of the probability at a few `points` (k, d), (k,), and its gradients (k, d).

        With z = (b + m) / s and s² = v + σₙ²: ∇ log Φ(z) = φ(z)/Φ(z) · (∇m − z ∇v / 2s) / s.
        """
        if self.gp is None:
            return np.zeros(len(points)), np.zeros_like(points)
        mean, variance, by_mean, by_variance = self.gp.moments_and_gradients(points)
        s = np.sqrt(variance + self.gp.hyperparameters.noise)
        z = (self.offset + mean) / s
        logarithm = log_ndtr(z)
        ratio = np.exp(-0.5 * z * z - 0.5 * math.log(2 * math.pi) - logarithm)
        gradient = by_mean - (z / (2 * s))[:, None] * by_variance
        return logarithm, (ratio / s)[:, None] * gradient


def _labels(observations: Observations) -> tuple[Floats, float]:
    """Labels less their mean, and that mean."""
    labels = np.where(observations.feasible, 1.0, -1.0)
    offset = float(labels.mean())
    return labels - offset, offset


def _standardised(observations: Observations) -> tuple[Floats, Floats, float, float]:
    """Feasible points, their standardised losses, and the mean and deviation taken out."""
    feasible = observations.feasible
    losses = observations.losses[feasible]
    offset, scale = float(losses.mean()), float(losses.std())
    # losses that are equal but for rounding have no scale of their own
    scale = scale if scale > 1e-12 * abs(offset) else 1.0
    return observations.points[feasible], (losses - offset) / scale, offset, scale
