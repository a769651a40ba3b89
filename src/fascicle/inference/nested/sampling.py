"""One run of nested sampling: weighted draws from the posterior, and the evidence.

References
----------
J. U. Lange, "nautilus: boosting Bayesian importance nested sampling with deep learning", MNRAS
525(2), 2023.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.threads import one_thread

BATCH = 100  # points at a time, whatever the number of workers, so that it changes no result
NETWORKS = 4  # neural networks that vote on where the likelihood is high
LIVE_SHARE = 0.01  # of the evidence may be left in the live points when exploration ends
IMPOSSIBLE = -1e10  # log-likelihood of a point without one; the sampler sorts it, so it is finite

# Log-likelihoods (m,) of points (m, d) of the unit cube; -inf where there is none.
LogLikelihoods = Callable[[Floats], Floats]


@dataclass(frozen=True)
class State:
    """Where a run stands.

    Attributes
    ----------
    log_evidence : float
        So far; only what has been explored counts.
    effective : float
        Effective sample size so far.
    evaluations : int
    explored : bool
        Whether all but `LIVE_SHARE` of the evidence has been found.
    """

    log_evidence: float
    effective: float
    evaluations: int
    explored: bool


@dataclass(frozen=True)
class NestedRun:
    """The outcome of a run.

    Attributes
    ----------
    points : (n, d) array
        In the unit cube.
    weights : (n,) array
        Of the points; they add up to 1.
    log_likelihoods : (n,) array
    state : State
        At the end.
    complete : bool
        Whether the run ended by itself, and not for its number of evaluations.
    """

    points: Floats
    weights: Floats
    log_likelihoods: Floats
    state: State
    complete: bool

    def draw(
        self, rng: np.random.Generator, count: int
    ) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """Numbers (count,) of points, equally weighted draws in random order (systematic)."""
        ends = np.cumsum(self.weights)
        positions = (np.arange(count) + rng.random()) / count * ends[-1]
        return np.asarray(rng.permutation(np.searchsorted(ends, positions)))


@one_thread
def nested_sample(
    seed: int,
    dimension: int,
    log_likelihoods: LogLikelihoods,
    *,
    live: int,
    effective: int,
    most: int,
    progress: Callable[[State], None] = lambda state: None,
) -> NestedRun:
    """Sample the posterior under a uniform prior on the unit cube.

    Parameters
    ----------
    seed : int
        Of all random numbers.
    dimension : int
        d.
    log_likelihoods : callable
        Evaluates batches of `BATCH` points.
    live : int
        Live points: more find more modes, and cost more.
    effective : int
        Effective sample size to reach.
    most : int
        Evaluations after which the run stops, complete or not.
    progress : callable
        Called after every batch.
    """
    from nautilus import Sampler

    def evaluate(points: Floats) -> Floats:
        values = np.maximum(log_likelihoods(points), IMPOSSIBLE)
        if sampler.n_like:
            progress(_state(sampler))
        return values

    sampler = Sampler(
        lambda points: points,
        evaluate,
        n_dim=dimension,
        n_live=live,
        n_networks=NETWORKS,
        n_batch=BATCH,
        vectorized=True,
        pass_dict=False,
        seed=seed,
    )
    with warnings.catch_warnings():  # its networks vote; none of them has to have converged
        warnings.filterwarnings("ignore", "Stochastic Optimizer")
        complete = sampler.run(f_live=LIVE_SHARE, n_eff=effective, n_like_max=most)
    points, log_weights, found = sampler.posterior()
    weights = np.exp(log_weights - log_weights.max())
    found = np.where(found > IMPOSSIBLE, found, -np.inf)
    return NestedRun(points, weights / weights.sum(), found, _state(sampler), bool(complete))


def _state(sampler: Any) -> State:
    return State(
        float(sampler.log_z), float(sampler.n_eff), int(sampler.n_like), bool(sampler.explored)
    )
