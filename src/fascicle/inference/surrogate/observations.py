"""What the surrogate learns from: the points tried so far and what came of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Booleans, Floats
from fascicle.inference.evaluation import Evaluation


@dataclass(frozen=True)
class Observations:
    """Points of the unit cube with their losses.

    Attributes
    ----------
    points : (n, d) array
        In the unit cube.
    losses : (n,) array
        Mismatch (mV², or its logarithm); NaN where the parameters give no tree.
    """

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
        """Where there is a loss, shape (n,)."""
        return np.isfinite(self.losses)

    def logarithmic(self) -> Observations:
        """The same points with the logarithm of each loss.

        Losses spread over two decades; on their logarithm a stationary process can tell small ones
        apart, which is where the optimisation and the posterior happen.
        """
        return Observations(self.points, np.log(np.maximum(self.losses, np.finfo(float).tiny)))

    def with_guess(self, point: Floats, loss: float) -> Observations:
        """Add one more, at `point` of shape (d,)."""
        return Observations(np.vstack([self.points, point]), np.append(self.losses, loss))
