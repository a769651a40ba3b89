"""Approximate Bayesian computation: which candidates explain the beats as well as the best one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fascicle.inference.abc.distance import ErrorDensity, from_reference
from fascicle.inference.evaluation import Evaluation, Objective

# Candidates to try in a round, from the round's number and all evaluations so far.
Propose = Callable[[int, Sequence[Evaluation]], NDArray[np.float64]]


@dataclass(frozen=True)
class Rules:
    """When a candidate is accepted and when to stop.

    Attributes
    ----------
    samples : int
        Accepted candidates wanted.
    tolerance : float
        A candidate is accepted if its distance is below this.
    patience : int
        So many rejections in a row end a round: the surrogate is refitted, candidates drawn anew.
    rounds : int
        At most so many rounds; then the sampling stops with what it has.
    batch : int
        Candidates evaluated at once.
    """

    samples: int = 30
    tolerance: float = 0.9
    patience: int = 50
    rounds: int = 4
    batch: int = 1


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
    evaluated : int
        Candidates evaluated, in all rounds.
    rounds : int
        Rounds begun.
    sweeps : int
        Steps of every random walk (`fascicle.inference.abc.random_walks`); 0 where rejection was
        enough.
    """

    reference: Evaluation
    accepted: tuple[Evaluation, ...]
    distances: NDArray[np.float64]
    evaluated: int
    rounds: int
    sweeps: int = 0


@dataclass(frozen=True)
class _Tally:
    """Verdicts so far against one reference."""

    reference: Evaluation
    density: ErrorDensity
    rules: Rules
    accepted: tuple[Evaluation, ...] = ()
    distances: tuple[float, ...] = ()
    rejections: int = 0
    surpassed: bool = False

    @classmethod
    def against(cls, reference: Evaluation, rules: Rules) -> _Tally:
        return cls(reference, ErrorDensity.fit(reference.beat_errors), rules)

    @property
    def complete(self) -> bool:
        return len(self.accepted) >= self.rules.samples

    @property
    def over(self) -> bool:
        """Whether the round ends here."""
        return self.complete or self.surpassed or self.rejections >= self.rules.patience

    def judge(self, evaluation: Evaluation) -> _Tally:
        """Add one more verdict; no more are accepted than are wanted."""
        distance = from_reference(evaluation, self.density)
        if distance < self.rules.tolerance:
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


def best_of(evaluations: Sequence[Evaluation]) -> Evaluation:
    """Find the feasible evaluation with the lowest loss, the first of equals."""
    feasible = [evaluation for evaluation in evaluations if evaluation.feasible]
    return min(feasible, key=lambda evaluation: evaluation.loss)


def sample(
    known: Sequence[Evaluation],
    propose: Propose,
    objective: Objective,
    rules: Rules,
    progress: Callable[[int, int, int], None] = lambda accepted, evaluated, rounds: None,
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
        Evaluates them.
    rules : Rules
    progress : callable
        Called with the numbers accepted, evaluated, and of the round.
    """
    tried: list[Evaluation] = []
    tally = _Tally.against(best_of(known), rules)
    for number in range(rules.rounds):
        candidates = propose(number, [*known, *tried])
        tally = _round(replace(tally, rejections=0), candidates, objective, tried, number, progress)
        if tally.surpassed and not tally.complete:
            tally = _judged_again(rules, best_of([*known, *tried]), tried)
        if tally.complete:
            break
    return Sampling(
        tally.reference, tally.accepted, np.array(tally.distances), len(tried), number + 1
    )


def _round(
    tally: _Tally,
    candidates: NDArray[np.float64],
    objective: Objective,
    tried: list[Evaluation],
    number: int,
    progress: Callable[[int, int, int], None],
) -> _Tally:
    """Try candidates until the round is over; appends to `tried`."""
    for start in range(0, len(candidates), tally.rules.batch):
        if tally.over:
            break
        for evaluation in objective(list(candidates[start : start + tally.rules.batch])):
            tried.append(evaluation)
            tally = tally.judge(evaluation)
        progress(len(tally.accepted), len(tried), number + 1)
    return tally


def _judged_again(rules: Rules, best: Evaluation, tried: Sequence[Evaluation]) -> _Tally:
    """Tally all candidates so far against a new reference."""
    tally = _Tally.against(best, rules)
    for evaluation in tried:
        tally = tally.judge(evaluation)
    return tally
