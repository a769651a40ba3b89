"""The Gaussian process against NumPy and against scikit-learn."""

import numpy as np
import pytest
from differences import central_differences
from scipy.spatial.distance import cdist
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from fascicle.inference import gaussian_process as exponential
from fascicle.inference.gaussian_process import ExponentialGP, Hyperparameters

HYPER = Hyperparameters((0.4, 1.3, 2.5), variance=1.7, noise=0.02)


@pytest.fixture
def data():
    rng = np.random.default_rng(3)
    points = rng.random((40, 3))
    return points, np.sin(5 * points[:, 0]) + points[:, 1] ** 2, rng.random((25, 3))


def numpy_prediction(points, outputs, targets, hyper):
    """Rasmussen & Williams, eqs 2.25 and 2.26, with a plain inverse."""
    scales = np.array(hyper.length_scales)

    def kernel(a, b):
        return hyper.variance * np.exp(-cdist(a / scales, b / scales))

    inverse = np.linalg.inv(kernel(points, points) + hyper.noise * np.eye(len(points)))
    cross = kernel(targets, points)
    variance = hyper.variance - np.einsum("ij,jk,ik->i", cross, inverse, cross)
    return cross @ inverse @ outputs, variance


def test_predictions_equal_numpy(data):
    """Also of points that came later, as outputs changed: they are standardised again."""
    points, outputs, targets = data
    targets = np.vstack([targets, points[:5]])
    grown = ExponentialGP.condition(points[:30], outputs[:30] - 1.0, HYPER)
    grown = grown.extended(points[30:33], outputs[:33]).extended(points[33:], outputs)
    expected = numpy_prediction(points, outputs, targets, HYPER)
    for gp in (ExponentialGP.condition(points, outputs, HYPER), grown):
        assert np.abs(np.subtract(gp.predict(targets), expected)).max() < 1e-8
    points, outputs, _ = data
    gp = ExponentialGP.condition(points, outputs, HYPER)
    many = np.random.default_rng(1).random((4321, 3))
    mean, nearness = gp.mean_many(many)
    scales = np.array(HYPER.length_scales)
    assert np.abs(mean - gp.predict(many)[0]).max() < 1e-11
    distance = cdist(many / scales, points / scales).min(1)
    assert np.abs(nearness - np.exp(-distance)).max() < 1e-11


def test_interpolates_without_noise(data):
    """Also where points are given twice."""
    points, outputs, targets = data
    gp = ExponentialGP.condition(points, outputs, Hyperparameters((1.0,) * 3, 1.0, 1e-6))
    for each in (gp, gp.extended(points[:20], np.append(outputs, outputs[:20]))):
        mean, variance = each.predict(points)
        assert np.abs(mean - outputs).max() < 1e-4
        assert (variance >= 0).all()
        assert variance.max() < 2e-6
    assert gp.predict(targets)[1].min() > 0.01


def scikit_learn_likelihood(points, outputs, hyper):
    """Log marginal likelihood and gradient with respect to the logarithms, by scikit-learn."""
    kernel = ConstantKernel(hyper.variance) * Matern(hyper.length_scales, nu=0.5)
    process = GaussianProcessRegressor(kernel + WhiteKernel(hyper.noise), alpha=0, optimizer=None)
    process.fit(points, outputs)
    logarithms = process.kernel_.theta  # variance, length scales, noise
    value, gradient = process.log_marginal_likelihood(logarithms, eval_gradient=True)
    return value, np.concatenate([gradient[1:-1], gradient[:1], gradient[-1:]])


def test_likelihood_and_gradient_equal_scikit_learn(data):
    points, outputs, _ = data
    value, gradient = exponential.log_marginal_likelihood(points, outputs, HYPER)
    expected_value, expected_gradient = scikit_learn_likelihood(points, outputs, HYPER)
    assert value == pytest.approx(expected_value, rel=1e-11)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-9)


def test_gradients_of_a_prediction(data):
    points, outputs, targets = data
    gp = ExponentialGP.condition(points, outputs, HYPER)
    *moments, by_mean, by_variance = gp.moments_and_gradients(targets[:5])
    np.testing.assert_allclose(moments, gp.predict(targets[:5]), rtol=1e-11)
    for row, target in enumerate(targets[:5]):
        for k, gradient in enumerate((by_mean[row], by_variance[row])):
            slopes = central_differences(lambda x, k=k: gp.predict(x)[k], target)
            np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-7)
    points, outputs, _ = data
    *_, by_mean, _ = gp.moments_and_gradients(points[:1])
    step = np.array([1e-6, -2e-6, 1e-6])
    ends = gp.predict(np.array([points[0] + step, points[0] - step]))[0]
    assert by_mean[0] @ (2 * step) == pytest.approx(ends[0] - ends[1], rel=1e-4)


def test_fit_recovers_length_scales():
    rng = np.random.default_rng(0)
    points = rng.random((300, 2))
    truth = Hyperparameters((0.3, 3.0), 1.0, 1e-3)
    scales = np.array(truth.length_scales)
    covariance = np.exp(-cdist(points / scales, points / scales)) + 1e-3 * np.eye(300)
    outputs = np.linalg.cholesky(covariance) @ rng.standard_normal(300)
    spread = outputs.std()
    outputs = (outputs - outputs.mean()) / spread
    fitted = exponential.fit(points, outputs, None, 100)
    assert fitted.length_scales[1] / fitted.length_scales[0] == pytest.approx(10, rel=0.5)
    # On the exponential kernel's ridge only variance / length is well determined.
    assert fitted.variance / fitted.length_scales[0] == pytest.approx(1 / 0.3 / spread**2, rel=0.25)
    assert fitted.noise < 0.02


def test_coincident_points_do_not_break_the_fit():
    rng = np.random.default_rng(0)
    points = rng.random((30, 4))
    points = np.vstack([points, points, points + 1e-13, points[:1].repeat(40, 0)])
    outputs = points.sum(1) - points.sum(1).mean()
    fitted = exponential.fit(points, outputs, None, 30)
    mean, variance = ExponentialGP.condition(points, outputs, fitted).predict(points)
    assert np.abs(mean - outputs).max() < 0.1
    assert (variance >= 0).all()


def test_singular_covariance_is_repaired():
    points = np.zeros((50, 2))
    gp = ExponentialGP.condition(points, np.ones(50), Hyperparameters((1.0, 1.0), 1.0, 1e-18))
    assert gp.predict(points[:1])[0][0] == pytest.approx(1.0, abs=1e-6)


def test_hyperparameters_survive_text_exactly():
    hyper = Hyperparameters((0.1 + 0.2, 1 / 3), np.pi, 1e-6 / 7)
    assert Hyperparameters.from_json(hyper.to_json()) == hyper
