"""Evaluation of the forward model, as the inference sees it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fascicle.core.arrays import Floats


@dataclass(frozen=True)
class Evaluation:
    """The outcome at one point of the parameter space.

    Attributes
    ----------
    point : (d,) array
        Point of the unit cube.
    loss : float
        Mismatch with the mean beat (mV²), of several recordings their sum; NaN where the
        parameters give no tree.
    beat_errors : (n_beats,) array
        Mismatch with each beat of the first recording (mV²); empty where the parameters give no
        tree.
    reason : str, optional
        Why the parameters give no tree, for people; None where they give one.
    log_likelihoods : (n_recordings,) array
        Log-likelihood of each recording's mean beat; empty where they were not computed.
    """

    point: Floats
    loss: float
    beat_errors: Floats
    reason: str | None = None
    log_likelihoods: Floats = field(default_factory=lambda: np.empty(0))

    @classmethod
    def infeasible(cls, point: Floats, reason: str) -> Evaluation:
        """Make the evaluation of a point (d,) that gives no tree."""
        return cls(point, np.nan, np.empty(0), reason)

    @property
    def log_likelihood(self) -> float:
        """Sum over all recordings; NaN where it was not computed."""
        return float(self.log_likelihoods.sum()) if len(self.log_likelihoods) else np.nan

    @property
    def feasible(self) -> bool:
        """True if the parameters gave a tree, and so an ECG."""
        return self.reason is None


# Evaluates points of the unit cube; outcomes come in their order, as soon as they are there.
Objective = Callable[[Sequence[Floats]], Iterable[Evaluation]]


def best_of(evaluations: Iterable[Evaluation]) -> Evaluation:
    """Find the feasible evaluation with the lowest loss, the first of equals; there must be one."""
    return min((e for e in evaluations if e.feasible), key=lambda e: e.loss)
