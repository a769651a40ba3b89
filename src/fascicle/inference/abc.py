"""Approximate Bayesian computation of the paper: informed prior, distance, rejection."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.progress import StageProgress, no_progress
from fascicle.inference.evaluation import Evaluation, Objective
from fascicle.inference.surrogates import LossGP

# Progress callback of the sampling: accepted, evaluated, round (from 1).
RoundProgress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class InformedPrior:
    """Prior density that favours a low and certain predicted loss.

    With s² = σ²(θ) + σ²_min (eq. "prior" of the paper)::

        p(θ) = exp(−(μ(θ) − y_min)² / 2s²) / √(2πs²)

    `loss` gives μ (mV²) and σ² (mV⁴); y_min and σ²_min are those of the best point.
    """

    loss: LossGP
    y_min: float
    variance_min: float

    @classmethod
    def at(cls, loss: LossGP, best: Floats) -> InformedPrior:
        """Make the prior whose reference is θ_min, the best point (d,) of the optimisation."""
        mean, variance = loss.predict(best[None, :])
        return cls(loss, mean.item(), variance.item())

    def density(self, mean: Floats, variance: Floats) -> Floats:
        """Density p(θ) (1/mV²) of points with predictions μ (mV²) and σ² (mV⁴), (m,) each."""
        s2 = variance + self.variance_min
        return np.asarray(np.exp(-0.5 * (mean - self.y_min) ** 2 / s2) / np.sqrt(2 * math.pi * s2))

    def bound(self, mean: Floats, variance_limit: Floats) -> Floats:
        """Bound p(θ) (1/mV²) for all variances up to `variance_limit` (m,), shape (m,).

        As a function of s² a normal density rises up to s² = gap², gap = μ − y_min, and falls
        beyond; so it is at most the density at the smaller of gap² and the limit. Where gap² is
        the smaller this is 1 / (√(2πe) |gap|).
        """
        gap2 = (mean - self.y_min) ** 2
        s2 = np.minimum(variance_limit + self.variance_min, gap2)
        s2 = np.maximum(s2, np.finfo(np.float64).tiny)
        # the bound and the density are computed by different sums: 1e-9 for rounding
        return np.asarray((1 + 1e-9) * np.exp(-0.5 * gap2 / s2) / np.sqrt(2 * math.pi * s2))

    def maximum(self, minimum_variance: float) -> float:
        """p_max of the paper: the density (1/mV²) at μ = y_min and the least variance."""
        return 1.0 / math.sqrt(2 * math.pi * (minimum_variance + self.variance_min))


def draw_candidates(
    rng: np.random.Generator,
    prior: InformedPrior,
    draws: int,
    limit: int | None = None,
    progress: StageProgress = no_progress,
    chunk: int = 100_000,
) -> tuple[Floats, Floats]:
    """Rejection sampling from the informed prior, the densest points first, as in the paper.

    Of `draws` uniform points (`chunk` at a time) those with p(θ) > r·p_max pass, r ~ U(0, 1). A
    variance, the costly part, is computed only where r·p_max is below `InformedPrior.bound`;
    elsewhere the point is rejected whatever its variance is, so the accepted set is exactly that of
    the full computation.

    p_max needs the least variance of all draws. It is taken over every point whose variance is
    computed: those that survive the bound, and in each chunk the 1000 nearest to the data in the
    metric of the kernel, where the variance is small. From chunk to chunk p_max only grows, so a
    point rejected against an earlier one would be rejected against the final one, too. Were the
    true minimum missed, p_max would be a little too small: the paper makes that compromise as well.

    Returns
    -------
    points : (m, d) array
        In the unit cube, by falling p(θ), at most `limit`. The first few are modes, not draws from
        the prior.
    density : (m,) array
        p(θ) (1/mV²).
    """
    least = math.inf
    kept: list[tuple[Floats, ...]] = []
    for start in range(0, draws, chunk):
        count = min(chunk, draws - start)
        points = rng.random((count, len(prior.loss.gp.centre)))
        r = rng.random(count)
        least, part = _screen(prior, points, r, least)
        kept.append(part)
        progress(start + count, draws)
    points, density, r = map(np.concatenate, zip(*kept, strict=True))
    passed = density > r * prior.maximum(least)
    points, density = points[passed], density[passed]
    rank = np.argsort(-density, kind="stable")[:limit]
    return points[rank], density[rank]


def _screen(
    prior: InformedPrior, points: Floats, r: Floats, least: float
) -> tuple[float, tuple[Floats, ...]]:
    """Update the least variance; give the points of a chunk that can still pass, density and r."""
    mean, nearness = prior.loss.mean_many(points)
    limit = prior.loss.variance_limit(nearness)
    count = min(1000, len(points))
    near = np.argpartition(-nearness, count - 1)[:count]
    _, variance_near = prior.loss.predict(points[near])
    least = min(least, float(variance_near.min()))

    alive = np.flatnonzero(r * prior.maximum(least) < prior.bound(mean, limit))
    if alive.size:
        exact_mean, variance = prior.loss.predict(points[alive])
        least = min(least, float(variance.min()))
        density = prior.density(exact_mean, variance)
        passed = density > r[alive] * prior.maximum(least)
        alive, density = alive[passed], density[passed]
    else:
        density = np.empty(0)
    return least, (points[alive], density, r[alive])


@dataclass(frozen=True)
class ErrorDensity:
    """Kernel density estimate q(e; θ) of the errors of θ over the recorded beats.

    q(e) = Σₖ exp(−(e − eₖ)² / 2h²) / (n h √(2π)), with eₖ the mismatch with each beat, `errors`
    (n,), and h the `bandwidth` (mV²): the Gaussian `KernelDensity` of scikit-learn, which the tests
    compare with.
    """

    errors: Floats
    bandwidth: float

    @classmethod
    def fit(cls, errors: Floats) -> ErrorDensity:
        """Choose the bandwidth by leave-one-out cross-validation over n beats, 2 or more."""
        e = np.asarray(errors, dtype=np.float64)
        spread = float(e.std(ddof=1))
        scale = max(float(np.abs(e).max()), 1e-12)
        if spread <= 1e-9 * scale:  # equal beats: any narrow kernel will do
            return cls(e, 1e-6 * scale)
        trials = spread * np.geomspace(0.05, 2.0, 30)
        scores = [_left_out(e, h) for h in trials]
        return cls(e, float(trials[int(np.argmax(scores))]))

    def __call__(self, e: Floats) -> Floats:
        """Density (1/mV²) at errors `e` (m,), shape (m,)."""
        z = (e[:, None] - self.errors[None, :]) / self.bandwidth
        norm = len(self.errors) * self.bandwidth * math.sqrt(2 * math.pi)
        return np.asarray(np.exp(-0.5 * z * z).sum(1) / norm)

    def nodes(self) -> Floats:
        """Errors e ≥ 0 that resolve the density, ascending."""
        margin = 8 * self.bandwidth  # beyond, the kernel is below 1e-14 of its peak
        low, high = max(0.0, self.errors.min() - margin), max(0.0, self.errors.max() + margin)
        count = math.ceil((high - low) / self.bandwidth * 16) + 2
        return np.linspace(low, high, count)


def total_variation(a: ErrorDensity, b: ErrorDensity) -> float:
    """Distance D = ½ ∫₀^∞ |q_a(e) − q_b(e)| de, from 0 (equal) to 1 (disjoint).

    Trapezoidal rule on the union of two grids, each fine against its own bandwidth (eq. "TV" of
    the paper). What a kernel spreads below e = 0 is not counted.
    """
    nodes = np.unique(np.concatenate([a.nodes(), b.nodes()]))
    return 0.5 * float(np.trapezoid(np.abs(a(nodes) - b(nodes)), nodes))


def _left_out(errors: Floats, bandwidth: float) -> float:
    """Mean log-likelihood of each error under the kernels of all the others (constants dropped)."""
    z = (errors[:, None] - errors[None, :]) / bandwidth
    exponent = -0.5 * z * z
    np.fill_diagonal(exponent, -np.inf)
    top = exponent.max(1)
    total = np.exp(exponent - top[:, None]).sum(1)
    return float((top + np.log(total)).mean()) - math.log(bandwidth)


@dataclass(frozen=True)
class Accepted:
    """Reference θ_min, accepted evaluations, and the total variation of each from it (n,)."""

    reference: Evaluation
    evaluations: tuple[Evaluation, ...]
    distances: Floats


def sample(
    reference: Evaluation,
    propose: Callable[[int], Floats],
    objective: Objective,
    *,
    samples: int = 30,
    tolerance: float = 0.9,
    refit_after: int = 50,
    rounds: int = 20,
    workers: int = 1,
    progress: RoundProgress = lambda accepted, evaluated, number: None,
) -> Accepted:
    """Try candidates in turn until enough are accepted.

    A candidate is accepted if the total variation between the densities of its per-beat errors
    and of those of θ_min is below the tolerance. `refit_after` rejections in a row, or want of
    candidates, end a round. A candidate that is better than θ_min, and too far from it, is rejected
    like any other.

    Parameters
    ----------
    reference : Evaluation
        θ_min, the best point of the optimisation.
    propose : callable
        Gives the candidates of a round, shape (m, d), in the order in which to try them.
    objective : Objective
        Evaluates them, `workers` at a time; numbers and tolerance are those of
        `fascicle.FitSettings`.
    progress : RoundProgress
    """
    density = ErrorDensity.fit(reference.beat_errors)
    accepted: list[Evaluation] = []
    distances: list[float] = []
    evaluated = 0
    for number in range(rounds):
        rejected = 0  # successive rejections
        candidates = propose(number)
        for start in range(0, len(candidates), workers):
            for evaluation in objective(list(candidates[start : start + workers])):
                evaluated += 1
                if len(accepted) == samples:
                    continue
                distance = 1.0  # without a tree
                if evaluation.feasible:
                    errors = ErrorDensity.fit(evaluation.beat_errors)
                    distance = total_variation(errors, density)
                if distance < tolerance:
                    accepted.append(evaluation)
                    distances.append(distance)
                    rejected = 0
                else:
                    rejected += 1
            progress(len(accepted), evaluated, number + 1)
            if len(accepted) == samples or rejected >= refit_after:
                break
        if len(accepted) == samples:
            break
    return Accepted(reference, tuple(accepted), np.array(distances))
