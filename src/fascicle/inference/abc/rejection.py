"""Approximate Bayesian computation: which candidates explain the beats as well as the best one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.inference.abc.distance import ErrorDensity, from_reference
from fascicle.inference.abc.settings import AbcSettings
from fascicle.inference.evaluation import Evaluation, Objective

# Candidates (m, d) to try in a round, from its number.
Propose = Callable[[int], Floats]
# Progress callback of the sampling: accepted, evaluated, round (from 1).
RoundProgress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class Sampling:
    """Outcome of the sampling.

    Attributes
    ----------
    reference : Evaluation
        θ_min.
    accepted : tuple of Evaluation
    distances : (len(accepted),) array
        Total variation from the reference, each.
    """

    reference: Evaluation
    accepted: tuple[Evaluation, ...]
    distances: Floats


@dataclass(frozen=True)
class _Tally:
    """Verdicts so far."""

    density: ErrorDensity
    settings: AbcSettings
    accepted: tuple[Evaluation, ...] = ()
    distances: tuple[float, ...] = ()
    rejections: int = 0

    @property
    def complete(self) -> bool:
        return len(self.accepted) >= self.settings.samples

    @property
    def over(self) -> bool:
        """Whether the round ends here."""
        return self.complete or self.rejections >= self.settings.refit_after

    def judge(self, evaluation: Evaluation) -> _Tally:
        """Add one more verdict; no more are accepted than are wanted."""
        if self.complete:
            return self
        distance = from_reference(evaluation, self.density)
        if distance >= self.settings.tolerance:
            return replace(self, rejections=self.rejections + 1)
        return replace(
            self,
            accepted=(*self.accepted, evaluation),
            distances=(*self.distances, distance),
            rejections=0,
        )


def sample(
    reference: Evaluation,
    propose: Propose,
    objective: Objective,
    settings: AbcSettings,
    progress: RoundProgress = lambda accepted, evaluated, number: None,
) -> Sampling:
    """Try candidates in turn until enough are accepted.

    A candidate is accepted if the total variation between the densities of its per-beat errors
    and of those of θ_min is below the tolerance. `settings.refit_after` rejections in a row, or
    want of candidates, end a round. A candidate that is better than θ_min, and too far from it,
    is rejected like any other.

    Parameters
    ----------
    reference : Evaluation
        θ_min, the best point of the optimisation.
    propose : callable
        Gives the candidates of a round, shape (m, d), in the order in which to try them.
    objective : Objective
        Evaluates them, `settings.workers` at a time.
    settings : AbcSettings
        Tolerance, number of samples, length of the rounds.
    progress : callable
        Called with the numbers accepted, evaluated, and of the round.
    """
    evaluated = 0
    tally = _Tally(ErrorDensity.fit(reference.beat_errors), settings)
    for number in range(settings.rounds):
        tally = replace(tally, rejections=0)
        candidates = propose(number)
        for start in range(0, len(candidates), settings.workers):
            for evaluation in objective(list(candidates[start : start + settings.workers])):
                evaluated += 1
                tally = tally.judge(evaluation)
            progress(len(tally.accepted), evaluated, number + 1)
            if tally.over:
                break
        if tally.complete:
            break
    return Sampling(reference, tally.accepted, np.array(tally.distances))
