"""One run of adaptive importance sampling: weighted draws from the posterior, and the evidence.

Draws from the prior come first; they may be many, and are the same for every recording. Where
their likelihoods are high, a Student's t distribution is placed, more points are drawn from it, and
so on. Every point counts with its posterior density over the density of all that was
drawn from, so early and poor proposals do no harm. Points live in normal scores: the prior is a
standard normal.

The likelihood of a network jumps with the smallest change of its parameters, so that single points
have weights that no neighbour has. The largest weights are replaced by what a generalised Pareto
distribution expects, whose shape k says whether they can be trusted.

References
----------
O. Cappé, A. Guillin, J.-M. Marin and C. P. Robert, "Population Monte Carlo", J. Comput. Graph.
Stat. 13(4), 2004; J.-M. Cornuet et al., "Adaptive multiple importance sampling", Scand. J. Stat.
39(4), 2012; A. Vehtari et al., "Pareto smoothed importance sampling", J. Mach. Learn.
Res. 25, 2024.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr, ndtri

from fascicle.core.arrays import Floats
from fascicle.core.threads import one_thread
from fascicle.inference.importance.proposal import fitted, standard_normal

BATCH = 500  # points that one proposal gives
FEWEST = 2 * BATCH  # points beside the prior's, so that proposals are put to the test
ADAPTED = 150.0  # effective sample that a proposal is fitted to; the posterior is flattened for it
TRUSTED = 0.7  # shape of the largest weights up to which they are
EDGE = 1e-9  # of the unit interval, beyond which normal scores are infinite

# Log-likelihoods (m,) of points (m, d) of the unit cube; -inf where there is none.
LogLikelihoods = Callable[[Floats], Floats]


@dataclass(frozen=True)
class State:
    """Where a run stands.

    Attributes
    ----------
    log_evidence : float
    effective : float
        Effective sample size.
    tail : float
        Shape k of the largest weights; beyond `TRUSTED` they say too little.
    evaluations : int
        Beside the prior's.
    """

    log_evidence: float
    effective: float
    tail: float
    evaluations: int


@dataclass(frozen=True)
class Run:
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
        Whether the effective sample was reached with weights that can be trusted.
    proposals : list
        Distributions that points were drawn from, in normal scores, the prior's first.
    counts : list of int
        How many were drawn from each.
    """

    points: Floats
    weights: Floats
    log_likelihoods: Floats
    state: State
    complete: bool
    proposals: list[Any]
    counts: list[int]

    def draw(
        self, rng: np.random.Generator, count: int
    ) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """Numbers (count,) of points, equally weighted draws in random order (systematic)."""
        ends = np.cumsum(self.weights)
        positions = (np.arange(count) + rng.random()) / count * ends[-1]
        return np.asarray(rng.permutation(np.searchsorted(ends, positions)))


Sampling = Generator[Floats, Floats, Run]  # asks for log-likelihoods of points


@one_thread
def importance_sample(log_likelihoods: LogLikelihoods, *runs: Sampling) -> list[Run]:
    """Sample posteriors in runs that have nothing in common but are evaluated together.

    Parameters
    ----------
    log_likelihoods : callable
        Evaluates the points that all runs ask for at a time: workers wait for as few as can be.
    *runs : generators
        Made by `sampling`.

    Returns
    -------
    list of Run
        Each as if it had been alone.
    """
    ended: dict[int, Run] = {}
    asked = {number: next(run) for number, run in enumerate(runs)}
    while asked:
        values = log_likelihoods(np.concatenate([*asked.values()]))
        ends = np.cumsum([len(points) for points in asked.values()])
        answers = dict(zip(asked, np.split(values, ends[:-1]), strict=True))
        asked = {}
        for number, answer in answers.items():
            try:
                asked[number] = runs[number].send(answer)
            except StopIteration as end:
                ended[number] = end.value
    return [ended[number] for number in range(len(runs))]


def sampling(
    rng: np.random.Generator,
    prior: Floats,
    *,
    effective: int,
    most: int,
    begun: Run | None = None,
    progress: Callable[[State], None] = lambda state: None,
) -> Sampling:
    """Sample the posterior under a uniform prior on the unit cube: a run for `importance_sample`.

    Parameters
    ----------
    rng : numpy.random.Generator
        Of all random numbers.
    prior : (n, d) array
        Draws from the prior.
    effective : int
        Effective sample size to reach.
    most : int
        Evaluations beside the prior's after which the run stops, complete or not.
    begun : Run, optional
        Of another posterior under the same prior, with the same draws of it: its points count
        here, too, and its evaluations are not among `most`.
    progress : callable
        Called after every batch.

    Yields
    ------
    (m, d) array
        Points, of which the (m,) log-likelihoods are to be sent: the prior's, and then `BATCH` at a
        time.

    Returns
    -------
    Run
    """
    points = prior if begun is None else begun.points
    proposals = [standard_normal(prior.shape[1])] if begun is None else list(begun.proposals)
    counts = [len(prior)] if begun is None else list(begun.counts)
    most += sum(counts[1:])
    scores = ndtri(np.clip(points, EDGE, 1 - EDGE))
    values = yield points
    while True:
        weights, state = _weigh(scores, values, proposals, counts)
        progress(state)
        complete = (
            state.effective >= effective and state.tail <= TRUSTED and state.evaluations >= FEWEST
        )
        if complete or state.evaluations >= most:
            return Run(points, weights, values, state, complete, proposals, counts)
        proposals.append(fitted(scores, _flattened(weights)))
        counts.append(min(BATCH, most - state.evaluations))
        new = proposals[-1].rvs(counts[-1], random_state=rng).reshape(counts[-1], -1)
        inside = np.clip(ndtr(new), EDGE, 1 - EDGE)
        points, scores = np.concatenate([points, inside]), np.concatenate([scores, new])
        values = np.concatenate([values, (yield inside)])


def _weigh(
    scores: Floats, values: Floats, proposals: list[Any], counts: list[int]
) -> tuple[Floats, State]:
    """Weights of all points, with the largest smoothed, and where the run stands."""
    from arviz import psislw

    shares = np.log(np.array(counts) / np.sum(counts))
    drawn = logsumexp(
        [np.atleast_1d(p.logpdf(scores)) for p in proposals], axis=0, b=np.exp(shares)[:, None]
    )
    raw = values + proposals[0].logpdf(scores) - drawn
    possible = np.isfinite(raw)
    smoothed, tail = psislw(raw[possible])
    weights = np.zeros(len(raw))
    weights[possible] = np.exp(smoothed - smoothed.max())
    weights /= weights.sum()
    evidence = float(logsumexp(raw[possible]) - np.log(len(raw)))
    size = float(1 / (weights**2).sum())
    return weights, State(evidence, size, float(tail), int(np.sum(counts[1:])))


def _flattened(weights: Floats) -> Floats:
    """The weights to the highest power, at most 1, that leaves an effective sample `ADAPTED`."""
    logs = np.log(np.maximum(weights, np.finfo(float).tiny))

    def flat(power: float) -> Floats:
        powers = np.where(weights > 0, np.exp(power * (logs - logs.max())), 0.0)
        return np.asarray(powers / powers.sum())

    def beyond(power: float) -> float:
        return float(1 / (flat(power) ** 2).sum()) - ADAPTED

    if beyond(1.0) >= 0 or beyond(0.0) <= 0:
        return flat(float(beyond(1.0) >= 0))
    return flat(float(brentq(beyond, 0.0, 1.0)))
