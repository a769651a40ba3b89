"""Bayesian optimisation on functions whose minimum is known."""

from dataclasses import replace

import numpy as np
import pytest
from differences import central_differences

from fascicle.inference.optimisation import (
    FeasibleLogImprovement,
    Surrogates,
    first_apart,
    latin_hypercube,
    perturbed,
    step,
)
from fascicle.inference.surrogates import Observations


def loss(points):
    """Curved valley, minimum 0 at 0.35 + 0.1·(−1)ⁱ, no tree where x₀ + x₁ > 1.1."""
    d = points.shape[1]
    centre = 0.35 + 0.1 * (-1.0) ** np.arange(d)
    shifted = points - centre
    value = (shifted**2 @ np.linspace(2, 0.5, d)) + (shifted[:, 0] * shifted[:, 1]) ** 2
    return np.where(points[:, 0] + points[:, 1] > 1.1, np.nan, value)


def design(dimension=3, count=30):
    points = latin_hypercube(np.random.default_rng(7), count, dimension)
    return Observations(points, loss(points))


def optimise(dimension, initial, steps, refit_every):
    known = design(dimension, initial)
    surrogates = Surrogates.learn(known)
    for k in range(steps):
        new = step(np.random.default_rng([7, k]), surrogates)
        assert new.shape == (dimension,)
        assert (new >= 0).all()
        assert (new <= 1).all()
        assert np.abs(known.points - new).max(1).min() > 1e-4
        known = with_loss(known, new)
        surrogates = surrogates.updated(known, refit_every)
    return known


def with_loss(known, new):
    losses = np.append(known.losses, loss(new[None]))
    return Observations(np.vstack([known.points, new]), losses)


def test_latin_hypercube_has_one_point_per_interval():
    points = latin_hypercube(np.random.default_rng(0), 50, 3)
    for column in points.T:
        assert sorted(np.floor(column * 50).astype(int)) == list(range(50))


@pytest.mark.parametrize(
    ("dimension", "initial", "steps", "refit_every"), [(2, 15, 20, 1), (6, 40, 30, 10)]
)
def test_beats_the_latin_hypercube(dimension, initial, steps, refit_every):
    found = optimise(dimension, initial, steps, refit_every)
    rivals = [
        np.nanmin(loss(latin_hypercube(np.random.default_rng(k), initial + steps, dimension)))
        for k in range(10)
    ]
    assert np.nanmin(found.losses) < 0.35 * np.median(rivals)
    # The infeasible share of the cube is 0.405; the proposals keep out of it.
    assert np.isnan(found.losses[initial:]).mean() < 0.15


def test_step_depends_on_nothing_but_its_arguments():
    surrogates = Surrogates.learn(design())
    first = step(np.random.default_rng(1), surrogates)
    np.random.random()  # noqa: NPY002 - the global generator must not matter
    assert step(np.random.default_rng(1), surrogates).tobytes() == first.tobytes()
    assert not np.array_equal(first, step(np.random.default_rng(2), surrogates))


def test_surrogates_learn_when_it_is_time():
    known = design(count=40)
    surrogates = Surrogates.learn(known.first(30))
    kept = surrogates.updated(known.first(39), 10)
    assert (kept.loss.gp.hyperparameters, kept.learnt_from) == (
        surrogates.loss.gp.hyperparameters, 30,
    )  # fmt: skip
    assert len(kept.loss.gp.scaled) == known.first(39).feasible.sum()
    learnt = kept.updated(known, 10)
    assert learnt.learnt_from == 40
    assert learnt.loss.gp.hyperparameters != surrogates.loss.gp.hyperparameters


def test_the_first_failure_is_learnt_at_once():
    points = np.linspace([0.1, 0.1, 0.1], [0.9, 0.9, 0.9], 12)
    losses = np.append(points[:11].sum(1), np.nan)
    known = Observations(points, losses)
    surrogates = Surrogates.learn(known.first(11))
    assert surrogates.feasibility.log_probability(points[-1:])[0] == 0.0
    updated = surrogates.updated(known, 100)
    assert updated.feasibility.log_probability(points[-1:])[0] < np.log(0.5)


def test_surrogates_survive_text_to_the_last_bit():
    known = design(count=40)
    uninterrupted = Surrogates.learn(known.first(30))
    for count in (32, 33, 37):
        uninterrupted = uninterrupted.updated(known.first(count), 10)
    again = Surrogates.from_json(uninterrupted.to_json(), known)
    for name in ("scaled", "whitener", "alpha"):
        for surrogate in ("loss", "feasibility"):
            one, two = (getattr(s, surrogate).gp for s in (uninterrupted, again))
            assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
    assert (again.learnt_from, len(again.observations)) == (30, 37)


@pytest.fixture
def acquisition():
    surrogates = Surrogates.learn(design())
    return FeasibleLogImprovement(surrogates.loss.gp, surrogates.feasibility, best=0.1)


TARGETS = np.random.default_rng(5).random((6, 3))


def test_acquisition_equals_monte_carlo(acquisition):
    mean, variance = acquisition.gp.predict(TARGETS)
    draws = mean + np.sqrt(variance) * np.random.default_rng(0).standard_normal((400_000, 6))
    improvement = np.maximum(acquisition.best - draws, 0).mean(0)
    expected = improvement * np.exp(acquisition.feasibility.log_probability(TARGETS))
    np.testing.assert_allclose(np.exp(acquisition(TARGETS)), expected, rtol=0.02, atol=1e-5)


@pytest.mark.parametrize("best", [3.0, 0.1, -5.0, -3000.0])
def test_gradient_of_the_acquisition(acquisition, best):
    """With improvement certain, likely, unlikely and out of the question."""
    acquisition = replace(acquisition, best=best)
    values, gradients = acquisition.with_gradients(TARGETS)
    np.testing.assert_allclose(values, acquisition(TARGETS), rtol=1e-9)
    for target, gradient in zip(TARGETS, gradients, strict=True):
        slopes = central_differences(acquisition, target)
        np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6)


def test_candidates_are_apart_from_what_is_known_and_in_the_cube():
    known = np.array([[0.2, 0.2], [0.7, 0.7]])
    near, far = known[1] + [9e-5, 0.0], known[1] + [0.0, -1.1e-4]
    candidates = np.array([near, known[0], far, [0.5, 0.5]])
    np.testing.assert_array_equal(first_apart(candidates, known), far)
    centres = np.array([[0.0, 0.5, 1.0]])
    points = perturbed(np.random.default_rng(0), centres, 500)
    assert points.min() == 0.0
    assert points.max() == 1.0
    assert (points != centres).any(1).mean() > 0.7
    assert (points == centres).mean() > 0.2
