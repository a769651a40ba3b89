"""The Gaussian process against NumPy and against GPyTorch."""

import gpytorch
import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from fascicle.inference.surrogate import exponential
from fascicle.inference.surrogate.exponential import ExponentialGP, Hyperparameters

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


def test_prediction_equals_numpy(data):
    points, outputs, targets = data
    targets = np.vstack([targets, points[:5]])
    mean, variance = ExponentialGP.condition(points, outputs, HYPER).predict(targets)
    expected_mean, expected_variance = numpy_prediction(points, outputs, targets, HYPER)
    assert np.abs(mean - expected_mean).max() < 1e-8
    assert np.abs(variance - expected_variance).max() < 1e-8


def test_interpolates_without_noise(data):
    points, outputs, targets = data
    gp = ExponentialGP.condition(points, outputs, Hyperparameters((1.0,) * 3, 1.0, 1e-6))
    mean, variance = gp.predict(points)
    assert np.abs(mean - outputs).max() < 1e-4
    assert variance.max() < 2e-6
    assert gp.predict(targets)[1].min() > 0.01


def test_fast_mean_equals_mean(data):
    points, outputs, _ = data
    gp = ExponentialGP.condition(points, outputs, HYPER)
    many = np.random.default_rng(1).random((4321, 3))
    mean, nearness = gp.mean_many(many)
    scales = np.array(HYPER.length_scales)
    assert np.abs(mean - gp.predict(many)[0]).max() < 1e-11
    distance = cdist(many / scales, points / scales).min(1)
    assert np.abs(nearness - np.exp(-distance)).max() < 1e-11


def gpytorch_likelihood(points, outputs, hyper):
    """Log marginal likelihood and gradient with respect to the logarithms, by GPyTorch."""
    x, y = torch.tensor(points), torch.tensor(outputs)
    matern = gpytorch.kernels.MaternKernel(nu=0.5, ard_num_dims=x.shape[1])
    logs = torch.tensor(hyper.to_logarithms(), requires_grad=True)
    scaled = x / logs[:-2].exp()
    matern.lengthscale = torch.ones(1, x.shape[1], dtype=torch.float64)
    covariance = logs[-2].exp() * matern(scaled).to_dense()
    covariance = covariance + logs[-1].exp() * torch.eye(len(x), dtype=torch.float64)
    normal = gpytorch.distributions.MultivariateNormal(torch.zeros_like(y), covariance)
    value = normal.log_prob(y)
    value.backward()
    return value.item(), logs.grad.numpy()


def test_likelihood_and_gradient_equal_gpytorch(data):
    points, outputs, _ = data
    value, gradient = exponential.log_marginal_likelihood(
        torch.tensor(points), torch.tensor(outputs), HYPER
    )
    expected_value, expected_gradient = gpytorch_likelihood(points, outputs, HYPER)
    # GPyTorch expands squared distances, so its kernel is good to about 1e-8.
    assert value == pytest.approx(expected_value, abs=1e-6)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-6, atol=1e-7)


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
