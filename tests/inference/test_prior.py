"""Rejection sampling from the informed prior against the same done by brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fascicle.inference.abc import InformedPrior, draw_candidates
from fascicle.inference.gaussian_process import Hyperparameters
from fascicle.inference.surrogates import LossGP, Observations

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
    return InformedPrior.at(LossGP.condition(known, hyper), best)


def brute_force(prior, chunk):
    """Every variance of every draw, with the same random numbers."""
    rng = np.random.default_rng(11)
    pairs = [(rng.random((chunk, 2)), rng.random(chunk)) for _ in range(DRAWS // chunk)]
    points = np.concatenate([p for p, _ in pairs])
    r = np.concatenate([q for _, q in pairs])
    mean, variance = prior.loss.predict(points)
    s2 = variance + prior.variance_min
    density = np.exp(-((mean - prior.y_min) ** 2) / (2 * s2)) / np.sqrt(2 * math.pi * s2)
    p_max = 1 / math.sqrt(2 * math.pi * (variance.min() + prior.variance_min))
    passed = density > r * p_max
    points, density = points[passed], density[passed]
    densest = np.argsort(-density, kind="stable")
    return points[densest], density[densest]


@pytest.mark.parametrize("chunk", [5000, 10_000])
def test_accepts_exactly_what_brute_force_accepts(prior, chunk):
    points, density = brute_force(prior, chunk)
    assert 300 < len(points) < DRAWS / 4
    found, found_density = draw_candidates(np.random.default_rng(11), prior, DRAWS, chunk=chunk)
    np.testing.assert_array_equal(found, points)
    np.testing.assert_allclose(found_density, density, rtol=1e-8)


def test_most_variances_are_never_computed(prior, monkeypatch):
    asked = []
    predict = LossGP.predict
    monkeypatch.setattr(LossGP, "predict", lambda gp, x: asked.append(len(x)) or predict(gp, x))
    draw_candidates(np.random.default_rng(11), prior, 100_000)
    assert sum(asked) < 40_000


@pytest.mark.parametrize("limit", [0.5, 2.0, 4.0, 30.0])
def test_bound_is_the_largest_density_up_to_the_variance_limit(prior, limit):
    mean = np.full(200_000, prior.y_min + 2.0)
    variance = np.linspace(1e-4, limit, len(mean))
    density = prior.density(mean, variance)
    bound = prior.bound(mean[:1], np.array([limit]))[0]
    assert density.max() == pytest.approx(bound, rel=1e-6)
    assert density.max() <= bound
    if limit > 4:
        assert bound == pytest.approx(1 / (math.sqrt(2 * math.pi * math.e) * 2.0), rel=1e-6)


def test_variance_limit_holds(prior):
    points = np.random.default_rng(4).random((5000, 2))
    _, nearness = prior.loss.mean_many(points)
    _, variance = prior.loss.predict(points)
    ratio = variance / prior.loss.variance_limit(nearness)
    assert 0.5 < ratio.max() <= 1.0


def test_draws_have_the_moments_of_the_density(prior):
    """Against the integral of p(θ) on a grid: rejection sampling is unbiased."""
    axis = (np.arange(300) + 0.5) / 300
    grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    weight = prior.density(*prior.loss.predict(grid))
    weight = weight / weight.sum()
    expected = weight @ grid
    spread = np.sqrt(weight @ (grid - expected) ** 2)
    drawn, _ = draw_candidates(np.random.default_rng(8), prior, 400_000)
    assert len(drawn) > 4000
    error = (drawn.mean(0) - expected) / (spread / np.sqrt(len(drawn)))
    assert np.abs(error).max() < 3.5
    np.testing.assert_allclose(drawn.std(0), spread, rtol=0.04)


def test_the_limit_keeps_the_densest(prior):
    every, density = draw_candidates(np.random.default_rng(11), prior, DRAWS)
    few, few_density = draw_candidates(np.random.default_rng(11), prior, DRAWS, limit=20)
    assert (np.diff(density) <= 0).all()
    np.testing.assert_array_equal(few, every[:20])
    np.testing.assert_array_equal(few_density, density[:20])
    # The first few keep to the mode; all of them spread like the prior itself.
    assert few.std(0).max() < 0.5 * every.std(0).max()


def test_progress_is_reported(prior):
    """Where nothing passes, too: a minimum far below all that is predicted."""
    hopeless, rng, seen = replace(prior, y_min=-1e6), np.random.default_rng(0), []
    found, _ = draw_candidates(
        rng, hopeless, 1000, chunk=400, progress=lambda *shares: seen.append(shares)
    )
    assert seen == [(400, 1000), (800, 1000), (1000, 1000)]
    assert found.shape == (0, 2)
