"""Approximate Bayesian computation: which candidates explain the beats as well as the best one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.inference.abc.distance import ErrorDensity, from_reference
from fascicle.inference.abc.settings import AbcSettings
from fascicle.inference.evaluation import Evaluation, Objective, best_of

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
        θ_min: the best point of the optimisation, or the one that took its place.
    accepted : tuple of Evaluation
    distances : (len(accepted),) array
        Total variation from the reference, each.
    """

    reference: Evaluation
    accepted: tuple[Evaluation, ...]
    distances: Floats


@dataclass(frozen=True)
class _Tally:
    """Verdicts so far against one reference."""

    reference: Evaluation
    density: ErrorDensity
    settings: AbcSettings
    accepted: tuple[Evaluation, ...] = ()
    distances: tuple[float, ...] = ()
    rejections: int = 0
    surpassed: bool = False

    @classmethod
    def against(
        cls, reference: Evaluation, settings: AbcSettings, tried: Iterable[Evaluation] = ()
    ) -> _Tally:
        """Start from what was tried before, judged against a new reference."""
        tally = cls(reference, ErrorDensity.fit(reference.beat_errors), settings)
        for evaluation in tried:
            tally = tally.judge(evaluation)
        return tally

    @property
    def complete(self) -> bool:
        return len(self.accepted) >= self.settings.samples

    @property
    def over(self) -> bool:
        """Whether the round ends here."""
        return self.complete or self.surpassed or self.rejections >= self.settings.refit_after

    def judge(self, evaluation: Evaluation) -> _Tally:
        """Add one more verdict; no more are accepted than are wanted."""
        distance = from_reference(evaluation, self.density)
        if distance < self.settings.tolerance:
            if self.complete:
                return self
            return replace(
                self,
                accepted=(*self.accepted, evaluation),
                distances=(*self.distances, distance),
                rejections=0,
            )
        better = evaluation.feasible and evaluation.loss < self.reference.loss
        return replace(self, rejections=self.rejections + 1, surpassed=self.surpassed or better)


def sample(
    known: Sequence[Evaluation],
    propose: Propose,
    objective: Objective,
    settings: AbcSettings,
    progress: RoundProgress = lambda accepted, evaluated, number: None,
) -> Sampling:
    """Try candidates in turn until enough are accepted.

    A candidate is accepted if the total variation between the densities of its per-beat errors
    and of those of θ_min, the best point known, is below the tolerance. One point differs from
    the paper: a candidate that is *better* than θ_min, and too far from it to be accepted, shows
    that θ_min was not the minimum. It ends the round, and becomes θ_min of the next; the
    candidates evaluated before are judged again, from their stored errors.

    Parameters
    ----------
    known : sequence of Evaluation
        From the optimisation; at least one feasible.
    propose : callable
        Gives the candidates of a round, shape (m, d), in the order in which to try them.
    objective : Objective
        Evaluates them, `settings.workers` at a time.
    settings : AbcSettings
        Tolerance, number of samples, length of the rounds.
    progress : callable
        Called with the numbers accepted, evaluated, and of the round.
    """
    tried: list[Evaluation] = []
    tally = _Tally.against(best_of(known), settings)
    for number in range(settings.rounds):
        tally = replace(tally, rejections=0)
        candidates = propose(number)
        for start in range(0, len(candidates), settings.workers):
            for evaluation in objective(list(candidates[start : start + settings.workers])):
                tried.append(evaluation)
                tally = tally.judge(evaluation)
            progress(len(tally.accepted), len(tried), number + 1)
            if tally.over:
                break
        if tally.surpassed and not tally.complete:
            tally = _Tally.against(best_of([*known, *tried]), settings, tried)
        if tally.complete:
            break
    return Sampling(tally.reference, tally.accepted, np.array(tally.distances))
