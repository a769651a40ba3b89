"""Rejection sampling from the informed prior against the same done by brute force."""

import math

import numpy as np
import pytest

from fascicle.posterior import prior as prior_module
from fascicle.posterior.prior import InformedPrior, draw_candidates
from fascicle.surrogate.exponential import Hyperparameters
from fascicle.surrogate.feasibility import FeasibilityGP
from fascicle.surrogate.loss_gp import LossGP
from fascicle.surrogate.observations import Observations

DRAWS = 30_000


@pytest.fixture
def prior():
    rng = np.random.default_rng(0)
    points = rng.random((60, 2))
    losses = 1 + 40 * ((points - [0.3, 0.6]) ** 2).sum(1)
    losses[points[:, 0] > 0.8] = np.nan
    known = Observations(points, losses)
    hyper = Hyperparameters((3.0, 2.0), 1.5, 1e-3)
    best = points[np.nanargmin(losses)]
    return InformedPrior.at(
        LossGP.condition(known, hyper), FeasibilityGP.condition(known, hyper), best
    )


def brute_force(prior, chunk):
    """Every variance of every draw, with the same random numbers."""
    rng = np.random.default_rng(11)
    pairs = [(rng.random((chunk, 2)), rng.random(chunk)) for _ in range(DRAWS // chunk)]
    points = np.concatenate([p for p, _ in pairs])
    r = np.concatenate([q for _, q in pairs])
    mean, variance = prior.loss.predict(points)
    s2 = variance + prior.variance_min
    density = np.exp(-((mean - prior.y_min) ** 2) / (2 * s2)) / np.sqrt(2 * math.pi * s2)
    density = density * prior.feasibility.probability(points)
    p_max = 1 / math.sqrt(2 * math.pi * (variance.min() + prior.variance_min))
    passed = density > r * p_max
    return points[passed], density[passed], variance.min()


@pytest.mark.parametrize("chunk", [1000, 10_000])
def test_accepts_exactly_what_brute_force_accepts(prior, chunk, monkeypatch):
    monkeypatch.setattr(prior_module, "DRAW_CHUNK", chunk)
    monkeypatch.setattr(prior_module, "NEAR_PER_CHUNK", 50)
    points, density, least = brute_force(prior, chunk)
    assert 300 < len(points) < DRAWS / 4
    found = draw_candidates(np.random.default_rng(11), prior, DRAWS)
    assert found.minimum_variance == pytest.approx(least, rel=1e-9)
    assert found.accepted == len(points)
    np.testing.assert_array_equal(found.points, points)
    np.testing.assert_allclose(found.density, density, rtol=1e-8)


def test_most_variances_are_never_computed(prior, monkeypatch):
    asked = []
    predict = LossGP.predict
    monkeypatch.setattr(LossGP, "predict", lambda gp, x: asked.append(len(x)) or predict(gp, x))
    draw_candidates(np.random.default_rng(11), prior, 100_000)
    assert sum(asked) < 40_000


def test_bound_is_the_largest_density_over_all_variances(prior):
    mean = np.array([prior.y_min + 2.0])
    variance = np.linspace(0.01, 50, 200_000) - prior.variance_min
    density = prior.density(np.repeat(mean, len(variance)), variance, np.ones(len(variance)))
    assert density.max() == pytest.approx(prior.bound(mean)[0], rel=1e-6)


def test_order_and_limit(prior):
    drawn = draw_candidates(np.random.default_rng(11), prior, DRAWS)
    ranked = draw_candidates(np.random.default_rng(11), prior, DRAWS, "density", limit=20)
    assert ranked.points.shape == (20, 2)
    assert ranked.accepted == drawn.accepted
    np.testing.assert_array_equal(ranked.density, np.sort(drawn.density)[::-1][:20])
    # The paper's order keeps to the mode; draws in random order spread like the prior itself.
    assert ranked.points.std(0).max() < 0.5 * drawn.points.std(0).max()


def test_progress_is_told(prior, monkeypatch):
    monkeypatch.setattr(prior_module, "DRAW_CHUNK", 400)
    told = []
    draw_candidates(
        np.random.default_rng(0),
        prior,
        1000,
        progress=lambda done, total: told.append((done, total)),
    )
    assert told == [(400, 1000), (800, 1000), (1000, 1000)]
