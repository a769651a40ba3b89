"""Tempered sequential Monte Carlo: equally weighted draws from the posterior, and the evidence.

Particles are drawn from the prior and moved to the posterior through prior · likelihood^T, with T
rising from 0 to 1 (Del Moral et al.). A stage raises T as far as the weights leave half of the
particles effective (Jasra et al.), resamples, and moves every particle by Metropolis steps until it
is hardly correlated with its start. The evidence is the product of the stages' mean weights.

Particles are in normal scores, in which the prior is a standard normal. Preconditioned
Crank-Nicolson steps (of Neal, named by Cotter et al.) leave the prior invariant; those used here
leave a Student's t distribution fitted to the particles invariant (Grumitt et al.). So they suit
broad and narrow directions of the posterior, and may be as long as independent draws where the
posterior is close to that distribution.

References
----------
P. Del Moral, A. Doucet and A. Jasra, "Sequential Monte Carlo samplers", J. R. Stat. Soc. B 68(3),
2006; A. Jasra, D. A. Stephens, A. Doucet and T. Tsagaris, "Inference for Lévy-driven stochastic
volatility models via adaptive sequential Monte Carlo", Scand. J. Stat. 38(1), 2011; R. M. Neal,
"Regression and classification using Gaussian process priors", Bayesian Statistics 6, 1999; S. L.
Cotter, G. O. Roberts, A. M. Stuart and D. White, "MCMC methods for functions", Stat. Sci. 28(3),
2013; R. D. P. Grumitt, M. Karamanis and U. Seljak, "Flow annealed Kalman inversion for gradient-
free inference in Bayesian inverse problems", Phys. Sci. Forum 9(1), 2023; A. Lee and N. Whiteley,
"Variance estimation in the particle filter", Biometrika 105(3), 2018.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr, ndtri

from fascicle.core.arrays import Floats, Integers
from fascicle.core.threads import one_thread

FORGOTTEN = 0.3  # correlation of a score with its beginning, at most, after the moves of a stage

# Log-likelihoods (m,) of points (m, d) of the unit cube; -inf where there is none.
LogLikelihoods = Callable[[Floats], Floats]


@dataclass(frozen=True)
class State:
    """State of a run; at the end, the temperature is 1."""

    temperature: float
    log_evidence: float
    evaluations: int


@dataclass(frozen=True)
class SamplingRun:
    """Outcome of a run.

    Attributes
    ----------
    points : (n, d) array
        Equally weighted points of the unit cube.
    log_likelihoods : (n,) array
        Log-likelihoods of the points.
    log_evidence : float
        Log-evidence under the whole prior, the part without a likelihood included.
    evaluations : int
        Number of evaluations of the likelihood.
    effective : float
        Independent draws that would give means as exact as those of the points (see `_effective`).
    """

    points: Floats
    log_likelihoods: Floats
    log_evidence: float
    evaluations: int
    effective: float


@dataclass
class _Particles:
    """Normal scores (n, d), log-likelihoods (n,) and how far Crank-Nicolson steps go, up to 1."""

    scores: Floats
    values: Floats
    length: float = 0.9


@one_thread
def temper(
    log_likelihoods: LogLikelihoods,
    dimension: int,
    rng: np.random.Generator,
    particles: int = 1000,
    progress: Callable[[State], None] = lambda state: None,
    edges: Floats | None = None,
) -> SamplingRun:
    """Sample the posterior under a uniform prior on the unit cube.

    Parameters
    ----------
    log_likelihoods : callable
        Log-likelihoods (m,) of points (m, d); -inf where there is none.
    progress : callable
        Called after every stage.
    edges : (k + 1,) array, optional
        Ends of the intervals of the last coordinate that stand for k categories. Particles then
        change their category by steps of their own, since neighbours have nothing in common.

    Raises
    ------
    ValueError
        If too few draws from the prior have a likelihood.
    """
    evaluations = 0

    def of_scores(scores: Floats) -> Floats:
        nonlocal evaluations
        evaluations += len(scores)
        return log_likelihoods(_points(scores))

    population, log_evidence = _from_prior(of_scores, dimension, rng, particles)
    temperature, remembered, families = 0.0, 0.0, np.arange(particles)
    while temperature < 1:
        rise = _rise(population.values, 1 - temperature)
        temperature = 1.0 if rise == 1 - temperature else temperature + rise
        weights = rise * population.values
        log_evidence += float(logsumexp(weights) - np.log(particles))
        chosen = _resampled(np.exp(weights - weights.max()), rng)
        population.scores, population.values = population.scores[chosen], population.values[chosen]
        if remembered < FORGOTTEN:  # kin have become independent
            families = np.arange(particles)
        families = families[chosen]
        remembered = _move(population, of_scores, temperature, rng, edges)
        progress(State(temperature, log_evidence, evaluations))
    points = _points(population.scores)
    return SamplingRun(
        points, population.values, log_evidence, evaluations, _effective(points, families)
    )


def _points(scores: Floats) -> Floats:
    """Points of the open unit cube, on whose edge quantiles of a prior may be infinite."""
    edge = 1e-9
    return np.asarray(np.clip(ndtr(scores), edge, 1 - edge))


def _from_prior(
    of_scores: LogLikelihoods, dimension: int, rng: np.random.Generator, particles: int
) -> tuple[_Particles, float]:
    """Particles with a likelihood, and the logarithm of the share of the prior that has one."""
    scores, values = np.empty((0, dimension)), np.empty(0)
    for batch in range(1, 101):
        drawn = rng.standard_normal((particles, dimension))
        logs = of_scores(drawn)
        possible = np.isfinite(logs)
        scores, values = np.vstack([scores, drawn[possible]]), np.append(values, logs[possible])
        if len(values) >= particles:
            share = len(values) / (batch * particles)
            return _Particles(scores[:particles], values[:particles]), float(np.log(share))
    raise ValueError(
        f"only {len(values)} of {batch * particles} draws from the prior have a likelihood: "
        "check the ranges of the parameters"
    )


def _rise(values: Floats, most: float) -> float:
    """Rise of the temperature, at most `most`, that leaves half of the particles effective."""

    def beyond(rise: float) -> float:
        return effective_size(rise * (values - values.max())) - len(values) / 2

    return most if beyond(most) >= 0 else float(brentq(beyond, 0.0, most, xtol=1e-15))


def effective_size(log_weights: Floats) -> float:
    """Effective sample size of weights (n,), of which the largest is 1."""
    weights = np.exp(log_weights)
    return float(weights.sum() ** 2 / (weights**2).sum())


def _resampled(weights: Floats, rng: np.random.Generator) -> Integers:
    """Indices (n,) of particles drawn in proportion to their weights (systematic resampling)."""
    ends = np.cumsum(weights)
    positions = (np.arange(len(weights)) + rng.random()) / len(weights) * ends[-1]
    return np.asarray(np.minimum(np.searchsorted(ends, positions), len(weights) - 1))


def _effective(points: Floats, families: Integers) -> float:
    """Effective sample size of the parameter with the smallest, at most n.

    Resampled copies move on their own, but remain alike. So the variance of a mean is estimated
    from the sums over families (n,), the descendants of a particle (Lee and Whiteley).
    """
    sizes = np.bincount(families)
    if sizes.max() == len(points):
        return 1.0
    apart = points - points.mean(axis=0)
    sums = np.array([np.bincount(families, column) for column in apart.T])
    unbiased = 1 - ((sizes / len(points)) ** 2).sum()  # the mean is taken from the same families
    by_parameter = len(points) ** 2 * unbiased * apart.var(axis=0) / (sums**2).sum(axis=1)
    return float(min(by_parameter.min(), len(points)))


def _move(
    population: _Particles,
    of_scores: LogLikelihoods,
    temperature: float,
    rng: np.random.Generator,
    edges: Floats | None = None,
) -> float:
    """Move the particles until they are hardly correlated with their start, or a ceiling is met.

    Proposals for one half of the particles are fitted to the other half: fitted to the particles
    that they move, they would contract these, and the log-evidence in 45 dimensions would be too
    low by 0.3. Resampling keeps the order, so that copies of a particle, and its relatives, are in
    the same half.

    Returns the largest correlation of any score between the beginning and the end.
    """
    # not less than 0.2, since of 20 scores of 600 independent particles the largest correlation is
    # 0.1 by chance
    forgotten, fewest = (0.2, 10) if temperature == 1 else (FORGOTTEN, 5)
    ceiling = 100  # with less, batches of narrow posteriors are hardly worth a few draws
    start = population.scores.copy()
    middle = len(start) // 2
    halves = slice(middle), slice(middle, None)
    moved = slice(None) if edges is None else slice(start.shape[1] - 1)
    fits = [_Fit.to(start[other, moved]) for other in reversed(halves)]
    jumps = []
    if edges is not None:
        jumps = [_Jump.to(start[other, -1], edges) for other in reversed(halves)]
    remembered = 1.0
    for step in range(ceiling):
        if jumps:
            _jump(population, of_scores, temperature, rng, zip(halves, jumps, strict=True))
        pairs = zip(halves, fits, strict=True)
        proposals = [
            fit.proposals(population.scores[half, moved], population.length, rng)
            for half, fit in pairs
        ]
        proposed, log_ratio = (np.concatenate(parts) for parts in zip(*proposals, strict=True))
        if jumps:
            proposed = np.column_stack([proposed, population.scores[:, -1]])
        values = of_scores(proposed)
        log_ratio += temperature * (values - population.values)
        log_ratio += 0.5 * ((population.scores**2).sum(axis=1) - (proposed**2).sum(axis=1))
        accepted = np.log(rng.random(len(values))) < log_ratio
        population.scores[accepted], population.values[accepted] = (
            proposed[accepted],
            values[accepted],
        )
        # the step length is adapted to a share of 0.3 of accepted proposals
        population.length = float(min(1.0, population.length * np.exp(accepted.mean() - 0.3)))
        a, b = ((x - x.mean(axis=0)) / x.std(axis=0) for x in (start, population.scores))
        remembered = float(np.clip((a * b).mean(axis=0).max(), 0, 1))
        if step + 1 >= fewest and remembered < forgotten:
            break
    return remembered


def _jump(
    population: _Particles,
    of_scores: LogLikelihoods,
    temperature: float,
    rng: np.random.Generator,
    halves: Iterable[tuple[slice, _Jump]],
) -> None:
    """Propose another category for every particle, the other coordinates unchanged."""
    proposed, log_ratio = population.scores.copy(), np.empty(len(population.values))
    for half, jump in halves:
        proposed[half, -1], log_ratio[half] = jump.proposals(population.scores[half, -1], rng)
        edges = jump.edges  # of both halves
    before, after = (_categories(s[:, -1], edges) for s in (population.scores, proposed))
    values, changed = population.values.copy(), before != after
    values[changed] = of_scores(proposed[changed])
    log_ratio += temperature * (values - population.values)
    accepted = np.log(rng.random(len(values))) < log_ratio
    population.scores[accepted], population.values[accepted] = proposed[accepted], values[accepted]


@dataclass(frozen=True)
class _Jump:
    """Probabilities (k,) of proposed categories, and the ends (k + 1,) of their intervals."""

    probabilities: Floats
    edges: Floats

    @classmethod
    def to(cls, scores: Floats, edges: Floats) -> _Jump:
        """Proposals that are as frequent as among particles, or, one in four, in the prior."""
        counts = np.bincount(_categories(scores, edges), minlength=len(edges) - 1)
        return cls(0.75 * counts / counts.sum() + 0.25 * np.diff(edges), edges)

    def proposals(self, scores: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Proposed scores (n,) of the category's coordinate, and log q(x)/q(x')."""
        new = rng.choice(len(self.probabilities), len(scores), p=self.probabilities)
        width = np.diff(self.edges)
        inside = rng.uniform(1e-6, 1 - 1e-6, len(scores))  # not on an edge
        log_density = np.log(self.probabilities) - np.log(width)
        old = _categories(scores, self.edges)
        return ndtri(self.edges[new] + inside * width[new]), log_density[old] - log_density[new]


def _categories(scores: Floats, edges: Floats) -> Integers:
    """Category (n,) of scores of the last coordinate."""
    return np.asarray(np.searchsorted(edges[1:-1], ndtr(scores), side="right"))


@dataclass(frozen=True)
class _Fit:
    """Mean m of particles and Cholesky factor L of their covariance."""

    mean: Floats
    factor: Floats

    @classmethod
    def to(cls, scores: Floats) -> _Fit:
        """Fit to particles."""
        covariance = np.atleast_2d(np.cov(scores, rowvar=False)) + 1e-9 * np.eye(scores.shape[1])
        return cls(scores.mean(axis=0), np.asarray(np.linalg.cholesky(covariance)))

    def proposals(
        self, scores: Floats, length: float, rng: np.random.Generator
    ) -> tuple[Floats, Floats]:
        """Proposals x', and log q(x)/q(x') of the t density q, invariant if all are accepted.

        x' = m + √(1 - l²)(x - m) + l√z Lξ with ξ standard normal and z inverse gamma given x: of
        a t, the scale of the normal that x comes from.
        """
        freedom = 8  # tails that are heavier than the posterior's
        size, dimension = scores.shape

        def distance(x: Floats) -> Floats:
            whitened = solve_triangular(self.factor, (x - self.mean).T, lower=True)
            return np.asarray((whitened**2).sum(axis=0))

        before = distance(scores)
        z = 0.5 * (freedom + before) / rng.gamma(0.5 * (freedom + dimension), size=size)
        noise = np.sqrt(z)[:, None] * (rng.standard_normal((size, dimension)) @ self.factor.T)
        proposed = self.mean + np.sqrt(1 - length**2) * (scores - self.mean) + length * noise
        farther = np.log((freedom + distance(proposed)) / (freedom + before))
        return proposed, 0.5 * (freedom + dimension) * farther


def pooled(batches: Sequence[SamplingRun]) -> SamplingRun:
    """Pool independent runs, each with the weight of its evidence.

    The result has as many equally weighted points as one run, drawn from all. With these weights
    integrals over the unnormalised posterior are unbiased, however few particles each run has.
    """
    logs = np.array([run.log_evidence for run in batches])
    log_sum, count = float(logsumexp(logs)), len(batches[0].points)
    weights = np.exp(logs - log_sum)
    # positions so far apart that no point is taken twice
    ends = np.cumsum(np.repeat(weights / count, count))
    chosen = np.searchsorted(ends, (np.arange(count) + 0.5) / count * ends[-1])
    effective = 1 / float((weights**2 / [run.effective for run in batches]).sum())
    return SamplingRun(
        np.concatenate([run.points for run in batches])[chosen],
        np.concatenate([run.log_likelihoods for run in batches])[chosen],
        log_sum - float(np.log(len(batches))),
        sum(run.evaluations for run in batches),
        effective,
    )


EVIDENCE_APART = 1.0  # between log-evidences; above that, one run has missed a mode
MEANS_APART = 0.5  # standard deviations between the means of a parameter


@dataclass(frozen=True)
class RunAgreement:
    """Differences of two runs; of the means (d,) in pooled standard deviations."""

    log_evidence: float
    means: Floats

    def within(self, share: float = 1.0) -> bool:
        """True if the differences, scaled by `share`, are small enough for the runs to agree."""
        means = bool((share * self.means <= MEANS_APART).all())
        return share * self.log_evidence <= EVIDENCE_APART and means


def agreement(first: SamplingRun, second: SamplingRun) -> RunAgreement:
    """Compare two runs of different seeds on the same likelihood."""
    means = means_apart(first.points, second.points)
    return RunAgreement(abs(first.log_evidence - second.log_evidence), means)


def means_apart(first: Floats, second: Floats) -> Floats:
    """Differences of the means of draws (n, ...), in pooled standard deviations."""
    apart = np.abs(first.mean(axis=0) - second.mean(axis=0))
    variance = np.mean([first.var(axis=0), second.var(axis=0)], axis=0)
    return np.asarray(apart / np.sqrt(variance + apart**2 / 4))
