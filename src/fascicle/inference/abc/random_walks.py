"""Random walks that complete a posterior sample where rejection cannot.

Where beats vary little, the networks that explain them fill so small a part of the parameter space
that none of millions of uniform draws falls into it. Walks that start from what is known to be
acceptable find more: approximate Bayesian computation by Markov chains (Marjoram et al., PNAS 2003)
with the same acceptance rule, and the uniform prior over the ranges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fascicle.inference.abc.distance import ErrorDensity, from_reference
from fascicle.inference.abc.rejection import Rules, Sampling
from fascicle.inference.evaluation import Evaluation, Objective

STEP = (0.01, 0.5)  # of the unit cube, log-uniform: long steps suit what the ECG does not see
LONGEST = 3  # times the sweeps asked for; then the walk stops even if θ_min still improves

Move = Callable[[int, NDArray[np.float64]], NDArray[np.float64]]


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
        feasible = [evaluation for evaluation in proposals if evaluation.feasible]
        best = min(feasible, key=lambda evaluation: evaluation.loss, default=self.reference)
        if best.loss >= self.reference.loss or self.distance(best) < tolerance:
            return None
        moved = _Chains(best, ErrorDensity.fit(best.beat_errors), self.states)
        kept = tuple(s if moved.distance(s) < tolerance else best for s in self.states)
        return replace(moved, states=kept)


def propose(rng: np.random.Generator, positions: NDArray[np.float64]) -> NDArray[np.float64]:
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
    rules: Rules,
    sweeps: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Sampling:
    """Complete a sample that rejection left short.

    As many walks as samples are wanted start from those accepted and from θ_min, and take `sweeps`
    steps; where one ends is a sample. A step to a better point that is too far from θ_min to be
    accepted makes it the new θ_min, and the count of steps begins again.

    Parameters
    ----------
    found : Sampling
        What rejection gave.
    move : callable
        Gives the proposals of a sweep, (walks, d), from its number and the positions (walks, d).
    objective : Objective
        Evaluates them.
    rules : Rules
        Tolerance and number of samples.
    sweeps : int
        Steps of every walk after θ_min last changed.
    progress : callable
        Called with the steps taken since then, and `sweeps`.
    """
    starts = [*found.accepted, found.reference]
    chains = _Chains(
        found.reference,
        ErrorDensity.fit(found.reference.beat_errors),
        tuple(starts[k % len(starts)] for k in range(rules.samples)),
    )
    evaluated, since = found.evaluated, 0
    for sweep in range(LONGEST * sweeps):
        points = move(sweep, np.array([state.point for state in chains.states]))
        proposals = objective(list(points))
        evaluated += len(proposals)
        better = chains.improved(proposals, rules.tolerance)
        chains = better if better is not None else chains.stepped(proposals, rules.tolerance)
        since = 0 if better is not None else since + 1
        progress(since, sweeps)
        if since == sweeps:
            break
    distances = np.array([chains.distance(state) for state in chains.states])
    return replace(
        found,
        reference=chains.reference,
        accepted=chains.states,
        distances=distances,
        evaluated=evaluated,
        sweeps=sweep + 1,
    )
