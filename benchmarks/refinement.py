"""Refinement of the best points of the optimisation by differential evolution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution

from fascicle.core.arrays import Floats
from fascicle.core.progress import StageProgress, no_progress
from fascicle.inference.evaluation import Evaluation, Objective

POPULATION = 20
# Small steps in about half of the coordinates: the best of four settings on a recorded and on a
# simulated ECG.
MUTATION, RECOMBINATION = (0.1, 0.6), 0.5
SMALLEST = 5  # population that SciPy's differential evolution accepts
APART = 0.1  # of the unit cube, in some coordinate: so that the population spans several basins


def refine(
    rng: np.random.Generator,
    evaluated: Sequence[Evaluation],
    objective: Objective,
    generations: int,
    progress: StageProgress = no_progress,
) -> None:
    """Improve on the best known points by differential evolution.

    The loss has many local minima, since trees change their branching as parameters change. A
    population that begins at the best points known, mutually apart, moves each of them towards the
    best by differences of the others ("current to best"); where an evaluation costs milliseconds,
    this finds what a surrogate of the same data cannot resolve.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    evaluated : sequence of Evaluation
        Evaluations so far.
    objective : Objective
        Evaluates, and keeps, the points of a generation.
    generations : int
        How many; each costs up to `POPULATION` evaluations. Nothing is done with fewer than
        `SMALLEST` feasible points that are apart.
    progress : StageProgress
        Called with the generations done, and `generations`.

    References
    ----------
    R. Storn and K. Price, "Differential evolution", Journal of Global Optimization 11, 1997.
    """
    population = spread(evaluated)
    if not generations or len(population) < SMALLEST:
        return
    done = 0

    def losses(points: Floats) -> Floats:
        outcomes = objective(list(np.ascontiguousarray(points.T)))
        return np.array([e.loss if e.feasible else np.inf for e in outcomes])

    def generation_done(intermediate_result: OptimizeResult) -> None:
        nonlocal done
        done += 1
        progress(done, generations)

    differential_evolution(
        losses,
        [(0.0, 1.0)] * population.shape[1],
        strategy="currenttobest1bin",
        mutation=MUTATION,
        recombination=RECOMBINATION,
        init=population,
        maxiter=generations,
        tol=0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=rng,
        callback=generation_done,
    )


def spread(evaluated: Sequence[Evaluation]) -> Floats:
    """The best points that are mutually apart, best first, shape (at most `POPULATION`, d)."""
    chosen: list[Floats] = []
    for evaluation in sorted((e for e in evaluated if e.feasible), key=lambda e: e.loss):
        if all(np.abs(evaluation.point - other).max() > APART for other in chosen):
            chosen.append(evaluation.point)
        if len(chosen) == POPULATION:
            break
    return np.array(chosen)
