"""The informed prior p(θ) of the paper, and exact rejection sampling from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.progress import StageProgress, no_progress
from fascicle.inference.surrogate.surrogates import LossGP

DRAW_CHUNK = 100_000
ROUNDING = 1 + 1e-9  # the bound and the density are computed by different sums
NEAR_PER_CHUNK = 1000  # draws nearest to the data whose variance is always computed


@dataclass(frozen=True)
class InformedPrior:
    """Prior density that favours a low and certain predicted loss.

    With s² = σ²(θ) + σ²_min (eq. "prior" of the paper)::

        p(θ) = exp(−(μ(θ) − y_min)² / 2s²) / √(2πs²)

    Attributes
    ----------
    loss : LossGP
        Gives μ (mV²) and σ² (mV⁴).
    y_min, variance_min : float
        Mean (mV²) and variance (mV⁴) predicted at the best point.
    """

    loss: LossGP
    y_min: float
    variance_min: float

    @classmethod
    def at(cls, loss: LossGP, best: Floats) -> InformedPrior:
        """Make the prior whose reference is a known point.

        Parameters
        ----------
        loss : LossGP
            Surrogate of the loss.
        best : (d,) array
            θ_min, the best point of the optimisation, in the unit cube.
        """
        mean, variance = loss.predict(best[None, :])
        return cls(loss, float(mean[0]), float(variance[0]))

    def density(self, mean: Floats, variance: Floats) -> Floats:
        """Density p(θ) of points whose predictions are known.

        Parameters
        ----------
        mean, variance : (m,) arrays
            μ (mV²) and σ² (mV⁴) of the surrogate.

        Returns
        -------
        (m,) array
            p(θ) (1/mV²).
        """
        s2 = variance + self.variance_min
        density = np.exp(-0.5 * (mean - self.y_min) ** 2 / s2) / np.sqrt(2 * math.pi * s2)
        return np.asarray(density)

    def bound(self, mean: Floats, variance_limit: Floats) -> Floats:
        """Bound p(θ) (1/mV²) for all variances up to `variance_limit` (m,), shape (m,).

        As a function of s² a normal density rises up to s² = gap², gap = μ − y_min, and falls
        beyond; so it is at most the density at the smaller of gap² and the limit. Where gap² is
        the smaller this is 1 / (√(2πe) |gap|).
        """
        gap2 = (mean - self.y_min) ** 2
        s2 = np.minimum(variance_limit + self.variance_min, gap2)
        s2 = np.maximum(s2, np.finfo(np.float64).tiny)
        return np.asarray(ROUNDING * np.exp(-0.5 * gap2 / s2) / np.sqrt(2 * math.pi * s2))

    def maximum(self, minimum_variance: float) -> float:
        """p_max of the paper: the density (1/mV²) at μ = y_min and the least variance."""
        return 1.0 / math.sqrt(2 * math.pi * (minimum_variance + self.variance_min))


def draw_candidates(
    rng: np.random.Generator,
    prior: InformedPrior,
    draws: int,
    limit: int | None = None,
    progress: StageProgress = no_progress,
) -> tuple[Floats, Floats]:
    """Rejection sampling from the informed prior, the densest points first, as in the paper.

    Of `draws` uniform points those with p(θ) > r·p_max pass, r ~ U(0, 1). A variance, the costly
    part, is computed only where r·p_max is below `InformedPrior.bound`; elsewhere the point is
    rejected whatever its variance is, so the accepted set is exactly that of the full computation.

    p_max needs the least variance of all draws. It is taken over every point whose variance is
    computed: those that survive the bound, and in each chunk of 100,000 the 1000 nearest to the
    data in the metric of the kernel, where the variance is small. As the minimum falls from chunk
    to chunk, p_max only grows; so a point let go against an earlier p_max would be rejected
    against the final one too, and the kept ones are judged against the final one at the end.
    Were the true minimum missed, p_max would be a little too small: the compromise that the paper
    makes as well.

    Parameters
    ----------
    rng : Generator
        The only source of randomness.
    prior : InformedPrior
        The density.
    draws : int
        Number of uniform draws.
    limit : int, optional
        Return at most so many.
    progress : callable
        Called with the draws done and their total.

    Returns
    -------
    points : (m, d) array
        In the unit cube, by falling p(θ). The first few are modes, not draws from the prior.
    density : (m,) array
        p(θ) (1/mV²).
    """
    least = math.inf
    kept: list[tuple[Floats, ...]] = []
    for start in range(0, draws, DRAW_CHUNK):
        count = min(DRAW_CHUNK, draws - start)
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
    """Update the least variance; keep points, density and r of what of a chunk can still pass."""
    mean, nearness = prior.loss.mean_many(points)
    limit = prior.loss.variance_limit(nearness)
    count = min(NEAR_PER_CHUNK, len(points))
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
