"""What one run of the forward model tells the inference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Evaluation:
    """The outcome at one point of the parameter space.

    Attributes
    ----------
    point : (d,) array
        Where, in the unit cube.
    loss : float
        Mismatch with the mean beat (mV²); NaN where the parameters give no tree.
    beat_errors : (n_beats,) array
        Mismatch with each recorded beat (mV²); empty where the parameters give no tree.
    reason : str
        Why there is no tree; empty where there is one.
    """

    point: NDArray[np.float64]
    loss: float
    beat_errors: NDArray[np.float64]
    reason: str = ""

    @property
    def feasible(self) -> bool:
        """Whether the parameters gave a tree, and so an ECG."""
        return not self.reason


# Evaluates several points of the unit cube, in order, on as many cores as the caller allows.
Objective = Callable[[Sequence[NDArray[np.float64]]], list[Evaluation]]
