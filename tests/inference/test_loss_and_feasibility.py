"""The surrogates in physical units, and the probability of a tree."""

import numpy as np
import pytest
from differences import central_differences

from fascicle.inference.gaussian_process import Hyperparameters
from fascicle.inference.surrogates import FeasibilityGP, LossGP, Observations

HYPER = Hyperparameters((1.0, 1.0), 1.0, 1e-4)


def observations(n=80, seed=0):
    points = np.random.default_rng(seed).random((n, 2))
    losses = 3 + 50 * ((points - 0.5) ** 2).sum(1)
    return Observations(points, np.where(points[:, 0] > 0.7, np.nan, losses))


def test_predictions_are_in_the_units_of_the_loss():
    known = observations()
    small = LossGP.condition(known, HYPER)
    large = LossGP.condition(Observations(known.points, 10 * known.losses + 7), HYPER)
    targets = np.random.default_rng(1).random((9, 2))
    (mean, variance), (mean10, variance10) = small.predict(targets), large.predict(targets)
    np.testing.assert_allclose(mean10, 10 * mean + 7, rtol=1e-9)
    np.testing.assert_allclose(variance10, 100 * variance, rtol=1e-9)
    np.testing.assert_allclose(small.mean_many(targets)[0], mean, rtol=1e-9)
    feasible = known.feasible
    assert np.abs(small.predict(known.points[feasible])[0] - known.losses[feasible]).max() < 0.02


def test_extended_by_observations_equals_conditioned_on_all():
    known, targets = observations(), np.random.default_rng(1).random((9, 2))
    for surrogate in (LossGP, FeasibilityGP):
        grown = surrogate.condition(known.first(50), HYPER).extended(known)
        anew = surrogate.condition(known, HYPER)
        assert grown.gp.predict(targets)[0] == pytest.approx(anew.gp.predict(targets)[0], rel=1e-8)
        assert grown.offset == anew.offset


def test_equal_losses_are_no_trouble():
    points = np.random.default_rng(0).random((10, 2))
    gp = LossGP.fit(Observations(points, np.full(10, 4.0)), None, 20)
    assert gp.predict(points)[0] == pytest.approx(np.full(10, 4.0))


def test_everything_feasible_has_probability_one():
    points = np.random.default_rng(0).random((10, 2))
    gp = FeasibilityGP.fit(Observations(points, points.sum(1)), None, 20)
    assert (gp.log_probability(points) == 0.0).all()
    assert gp.hyperparameters is None


def test_probability_of_feasibility_is_calibrated():
    rng = np.random.default_rng(2)
    normal = np.array([1.0, -0.5, 0.3, 0.0])
    points, targets = rng.random((200, 4)), rng.random((4000, 4))
    known = Observations(points, np.where(points @ normal > 0.5, np.nan, 1.0))
    probability = np.exp(FeasibilityGP.fit(known, None, 50).log_probability(targets))
    feasible = targets @ normal <= 0.5
    assert ((probability > 0.5) == feasible).mean() > 0.9
    assert feasible[probability > 0.9].mean() > 0.95
    assert feasible[probability < 0.1].mean() < 0.05
    assert (probability > 0.9).sum() > 500
    assert (probability < 0.1).sum() > 300


def test_gradient_of_the_probability():
    gp = FeasibilityGP.fit(observations(), None, 20)
    points = np.array([[0.2, 0.4], [0.69, 0.5], [0.95, 0.1]])
    values, gradients = gp.log_probability_and_gradient(points)
    np.testing.assert_allclose(values, gp.log_probability(points), rtol=1e-9)
    for point, gradient in zip(points, gradients, strict=True):
        slopes = central_differences(gp.log_probability, point)
        np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-7)
