"""One run of adaptive importance sampling: weighted draws from the posterior, and the evidence.

Draws from the prior come first, the same for every recording. Where their likelihoods are high, a
Student's t distribution is placed, more points are drawn from it, and so on. Every point counts
with its posterior density over the density of all that was drawn from, so early and poor proposals
do no harm. Points live in normal scores: the prior is a standard normal.

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

BATCH = 500  # points that one proposal gives
TRUSTED = 0.7  # shape of the largest weights up to which they are

# Log-likelihoods (m,) of points (m, d) of the unit cube; -inf where there is none.
LogLikelihoods = Callable[[Floats], Floats]


@dataclass(frozen=True)
class State:
    """Where a run stands."""

    log_evidence: float
    effective: float  # sample size
    tail: float  # shape k of the largest weights; beyond `TRUSTED` they say too little
    evaluations: int  # without the prior's


@dataclass(frozen=True)
class SamplingRun:
    """The outcome of a run.

    Attributes
    ----------
    points : (n, d) array
        In the unit cube.
    weights, log_likelihoods : (n,) arrays
        Of the points; the weights add up to 1.
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


Sampling = Generator[Floats, Floats, SamplingRun]  # asks for log-likelihoods of points


@one_thread
def importance_sample(log_likelihoods: LogLikelihoods, *runs: Sampling) -> list[SamplingRun]:
    """Sample posteriors in runs that have nothing in common but are evaluated together.

    The points that all runs (made by `sampling`) ask for at a time are evaluated in one call:
    workers wait for as few as can be. Each run is as if it had been alone.
    """
    ended: dict[int, SamplingRun] = {}
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
    begun: SamplingRun | None = None,
    progress: Callable[[State], None] = lambda state: None,
) -> Sampling:
    """Sample the posterior under a uniform prior on the unit cube: a run for `importance_sample`.

    Parameters
    ----------
    prior : (n, d) array
        Draws from the prior.
    effective : int
        Effective sample size to reach.
    most : int
        Evaluations, without the prior's, after which the run stops, complete or not.
    begun : SamplingRun, optional
        Of another posterior under the same prior, with the same draws of it: its points count
        here, too, and its evaluations are not among `most`.
    progress : callable
        Called after every batch.

    Yields
    ------
    (m, d) array
        Points, of which the (m,) log-likelihoods are to be sent: the prior's, and then `BATCH` at a
        time.
    """
    points = prior if begun is None else begun.points
    proposals = [standard_normal(prior.shape[1])] if begun is None else list(begun.proposals)
    counts = [len(prior)] if begun is None else list(begun.counts)
    most += sum(counts[1:])
    edge = 1e-9  # of the unit interval, beyond which normal scores are infinite
    scores = ndtri(np.clip(points, edge, 1 - edge))
    values = yield points
    while True:
        weights, state = _weigh(scores, values, proposals, counts)
        progress(state)
        # with a few proposals beyond the prior, so that these are put to the test
        complete = (
            state.effective >= effective
            and state.tail <= TRUSTED
            and state.evaluations >= 2 * BATCH
        )
        if complete or state.evaluations >= most:
            return SamplingRun(points, weights, values, state, complete, proposals, counts)
        proposals.append(fitted(scores, _flattened(weights)))
        counts.append(min(BATCH, most - state.evaluations))
        new = proposals[-1].rvs(counts[-1], random_state=rng).reshape(counts[-1], -1)
        inside = np.clip(ndtr(new), edge, 1 - edge)
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
    """The weights to the highest power, at most 1, that leaves an effective sample of 150."""
    logs = np.log(np.maximum(weights, np.finfo(float).tiny))

    def flat(power: float) -> Floats:
        powers = np.where(weights > 0, np.exp(power * (logs - logs.max())), 0.0)
        return np.asarray(powers / powers.sum())

    def beyond(power: float) -> float:
        return float(1 / (flat(power) ** 2).sum()) - 150.0

    if beyond(1.0) >= 0 or beyond(0.0) <= 0:
        return flat(float(beyond(1.0) >= 0))
    return flat(float(brentq(beyond, 0.0, 1.0)))


def standard_normal(dimension: int) -> Any:
    """Make the standard normal distribution, as SciPy's frozen ones."""
    from scipy.stats import multivariate_normal

    return multivariate_normal(np.zeros(dimension))


def fitted(points: Floats, weights: Floats) -> Any:
    """Fit Student's t distribution to points (n, d) with weights (n,), as SciPy's frozen ones.

    One is enough, and with few effective points better than a mixture: the posterior of a network
    is broad in most parameters, and bent in none so far that a heavy tail would not cover it.
    """
    from scipy.stats import multivariate_t

    freedom = 8  # tails that are heavier than the posterior's
    mean = weights @ points
    apart = points - mean
    covariance = 1.15 * (weights * apart.T) @ apart + 0.01 * np.eye(len(mean))
    return multivariate_t(mean, covariance * (freedom - 2) / freedom, df=freedom)


EVIDENCE_APART = 1.0  # of the log-evidences; more, and one run has missed a mode
MEANS_APART = 0.5  # standard deviations between the means of a parameter


@dataclass(frozen=True)
class RunAgreement:
    """Differences of two runs, and whether both reached their effective sample.

    Those of the means (d,) are in standard deviations of both runs together.
    """

    log_evidence: float
    means: Floats
    complete: bool

    @property
    def converged(self) -> bool:
        """Whether both runs are complete, and agree."""
        return (
            self.complete
            and self.log_evidence <= EVIDENCE_APART
            and bool((self.means <= MEANS_APART).all())
        )


def agreement(first: SamplingRun, second: SamplingRun) -> RunAgreement:
    """Compare two runs of different seeds on the same likelihood."""
    runs = first, second
    means = [run.weights @ run.points for run in runs]
    variances = [r.weights @ (r.points - m) ** 2 for r, m in zip(runs, means, strict=True)]
    apart = np.abs(means[0] - means[1])
    together = np.sqrt(np.mean(variances, axis=0) + apart**2 / 4)
    return RunAgreement(
        abs(first.state.log_evidence - second.state.log_evidence),
        apart / together,
        first.complete and second.complete,
    )
