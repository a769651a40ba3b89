"""Runs of tempered sampling of a posterior, by emulated likelihoods of the recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.progress import Progress
from fascicle.inference.tempered_sampling import SamplingRun, State, temper

RUNS = 2  # independent runs, whose difference shows whether they have converged

Emulated = Callable[[Floats], Floats]  # log-likelihoods (n,) of a recording at points (n, d)


def of_all(emulated: Sequence[Emulated], points: Floats) -> Floats:
    """Log-likelihoods (n,) of all recordings together at points (n, d)."""
    return np.asarray(np.sum([log_likelihoods(points) for log_likelihoods in emulated], axis=0))


def sampled(
    emulated: Sequence[Emulated],
    dimension: int,
    rngs: Sequence[np.random.Generator],
    count: int,
    said: str,
    progress: Progress | None,
) -> list[SamplingRun]:
    """Sample the posterior of recordings by runs of `count` particles, one with each generator."""
    states: dict[int, State] = {}

    def one(run: int, rng: np.random.Generator) -> SamplingRun:
        def reported(state: State) -> None:
            states[run] = state
            _report(states, len(rngs), said, progress)

        try:
            sampled_run: SamplingRun = temper(
                partial(of_all, emulated), dimension, rng, count, reported
            )
        except ValueError as error:  # hardly any point has a likelihood, as by a user's own
            raise InputError(f"{error}, and the likelihood") from None
        return sampled_run

    with ThreadPoolExecutor(len(rngs)) as pool:
        return list(pool.map(one, range(len(rngs)), rngs))


def _report(states: Mapping[int, State], runs: int, said: str, progress: Progress | None) -> None:
    if progress is None or len(states) < runs:
        return
    evidences = " and ".join(f"{states[k].log_evidence:.1f}" for k in range(runs))
    # the logarithm of the temperature rises about evenly in time
    coldest = min(state.temperature for state in states.values())
    done = round(100 * (1 + np.log10(max(coldest, 1e-3)) / 3))
    progress("sampling", max(1, done), 100, f"{said}, log evidence {evidences}")
