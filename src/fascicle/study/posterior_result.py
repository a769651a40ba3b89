"""The outcome of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Posterior:
    """Posterior samples, and how they came about.

    Attributes
    ----------
    points : (n, d) array
        Accepted samples in the unit cube.
    values : mapping of str to (n,) array
        The same by parameter name, each in its own unit.
    losses : (n,) array
        Mismatch of each with the mean beat (mV²).
    distances : (n,) array
        Total variation between its per-beat errors and those of the best point.
    best_point : (d,) array
        The point with the least mismatch, in the unit cube.
    best_values : mapping of str to float
        The same by parameter name.
    best_loss : float
        Mismatch there (mV²).
    wanted : int
        Samples asked for; `len(points)` is less where walks did not part from one another.
    evaluated : int
        Candidates evaluated after the optimisation.
    rounds : int
        Times that candidates were drawn from a newly fitted surrogate.
    sweeps : int
        Steps of the random walks that completed the sample; 0 where rejection was enough.
    """

    points: NDArray[np.float64]
    values: Mapping[str, NDArray[np.float64]]
    losses: NDArray[np.float64]
    distances: NDArray[np.float64]
    best_point: NDArray[np.float64]
    best_values: Mapping[str, float]
    best_loss: float
    wanted: int
    evaluated: int
    rounds: int
    sweeps: int

    @property
    def complete(self) -> bool:
        """Whether as many samples were accepted as were asked for."""
        return len(self.points) >= self.wanted
