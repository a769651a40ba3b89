"""Random walks that complete a posterior sample where rejection cannot.

Where beats vary little, the networks that explain them fill so small a part of the parameter space
that none of millions of uniform draws falls into it. Walks that start from acceptable networks find
more: approximate Bayesian computation by Markov chains, with the same acceptance rule, and the
uniform prior over the ranges.

References
----------
P. Marjoram, J. Molitor, V. Plagnol and S. Tavaré, "Markov chain Monte Carlo without likelihoods",
PNAS 100(26), 2003.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.progress import StageProgress, no_progress
from fascicle.inference.abc.distance import ErrorDensity, from_reference
from fascicle.inference.abc.rejection import Sampling
from fascicle.inference.abc.settings import AbcSettings
from fascicle.inference.evaluation import Evaluation, Objective, best_of

STEP = (0.01, 0.5)  # of the unit cube, log-uniform: long steps suit what the ECG does not see
LONGEST = 3  # times the steps asked for; then the walk stops even if θ_min still improves

Move = Callable[[int, Floats], Floats]


@dataclass(frozen=True)
class _Chains:
    """Where every walk stands, and what the next steps are judged against.

    Attributes
    ----------
    reference : Evaluation
        θ_min.
    density : ErrorDensity
        Of its per-beat errors.
    states : tuple of Evaluation
        One a walk; each is acceptable.
    """

    reference: Evaluation
    density: ErrorDensity
    states: tuple[Evaluation, ...]

    def distance(self, evaluation: Evaluation) -> float:
        """Total variation from θ_min."""
        return from_reference(evaluation, self.density)

    def stepped(self, proposals: Sequence[Evaluation], tolerance: float) -> _Chains:
        """Move the walks whose proposal is acceptable."""
        states = tuple(
            new if self.distance(new) < tolerance else old
            for old, new in zip(self.states, proposals, strict=True)
        )
        return replace(self, states=states)

    def improved(self, proposals: Sequence[Evaluation], tolerance: float) -> _Chains | None:
        """Chains about a new θ_min, if a proposal is better and too far from this one.

        Walks that are no longer acceptable start again from it.
        """
        best = best_of([*proposals, self.reference])
        if best.loss >= self.reference.loss or self.distance(best) < tolerance:
            return None
        moved = _Chains(best, ErrorDensity.fit(best.beat_errors), self.states)
        kept = tuple(s if moved.distance(s) < tolerance else best for s in self.states)
        return replace(moved, states=kept)


def propose(rng: np.random.Generator, positions: Floats) -> Floats:
    """Propose a step from each position, symmetric in the cube, shape (walks, d).

    Gaussian in a random subset of coordinates, with a random scale; reflected at the faces.
    """
    count, dimension = positions.shape
    low, high = np.log(STEP)
    scale = np.exp(rng.uniform(low, high, (count, 1)))
    moves = rng.random((count, dimension)) < rng.random((count, 1))
    moves[np.arange(count), rng.integers(dimension, size=count)] = True
    steps = np.where(moves, scale * rng.standard_normal((count, dimension)), 0.0)
    folded = np.mod(positions + steps, 2.0)
    return np.asarray(np.where(folded > 1.0, 2.0 - folded, folded))


def walk(
    found: Sampling,
    move: Move,
    objective: Objective,
    settings: AbcSettings,
    progress: StageProgress = no_progress,
) -> Sampling:
    """Complete a sample that rejection left short.

    As many walks as samples are wanted start from those accepted and from θ_min, and take
    `settings.walk_steps` steps; where one ends is a sample. A step to a better point that is too
    far from θ_min to be accepted makes it the new θ_min, and the count of steps begins again.

    Parameters
    ----------
    found : Sampling
        What rejection gave.
    move : callable
        Gives the proposals of a step, (walks, d), from its number and the positions (walks, d).
    objective : Objective
        Evaluates them.
    settings : AbcSettings
        Tolerance, number of samples, and steps of every walk after θ_min last changed.
    progress : callable
        Called with the steps taken since then, and their number.
    """
    starts = [*found.accepted, found.reference]
    chains = _Chains(
        found.reference,
        ErrorDensity.fit(found.reference.beat_errors),
        tuple(starts[k % len(starts)] for k in range(settings.samples)),
    )
    since = 0
    for step in range(LONGEST * settings.walk_steps):
        points = move(step, np.array([state.point for state in chains.states]))
        proposals = objective(list(points))
        better = chains.improved(proposals, settings.tolerance)
        chains = better if better is not None else chains.stepped(proposals, settings.tolerance)
        since = 0 if better is not None else since + 1
        progress(since, settings.walk_steps)
        if since == settings.walk_steps:
            break
    distances = np.array([chains.distance(state) for state in chains.states])
    return Sampling(chains.reference, chains.states, distances)
