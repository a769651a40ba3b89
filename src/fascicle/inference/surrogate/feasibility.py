"""The probability that parameters give a tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fascicle.inference.surrogate.exponential import (
    CHUNK,
    ExponentialGP,
    Hyperparameters,
    fit,
    to_tensor,
)
from fascicle.inference.surrogate.observations import Observations
from fascicle.inference.surrogate.threads import in_chunks


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
        """Learn the hyper-parameters, from `start` if given, and condition on the labels."""
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

    def log_probability(self, points: Tensor) -> Tensor:
        """Logarithm of the probability at `points` (m, d), shape (m,); differentiable."""
        if self.gp is None:
            return torch.zeros(len(points), dtype=points.dtype)
        mean, variance = self.gp.moments(points)
        z = (self.offset + mean) / torch.sqrt(variance + self.gp.hyperparameters.noise)
        logarithm: Tensor = torch.special.log_ndtr(z)
        return logarithm

    def probability(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability that each of `points` (m, d) gives a tree, shape (m,)."""
        result = np.empty(len(points))

        def work(part: slice) -> None:
            result[part] = self.log_probability(to_tensor(points[part])).exp().numpy()

        in_chunks(work, len(points), CHUNK)
        return result
