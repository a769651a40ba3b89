"""Expected improvement against numerical integration, from likely to next to impossible."""

import numpy as np
import pytest
from differences import central_differences
from scipy.integrate import quad

from fascicle.inference.optimisation import (
    log_expected_improvement,
    log_expected_improvement_slopes,
    log_h,
)

REGIMES = (-1e6, -2e4, -1001.0, -999.0, -40.0, -5.0, -1.001, -0.999, 0.0, 2.0, 9.0)


def integrated_log_h(u):
    """h(u) = ∫₀^∞ t φ(t − u) dt."""
    if u > -1:
        h, _ = quad(lambda t: t * np.exp(-0.5 * (t - u) ** 2), 0, u + 40, points=[max(u, 0.5)])
        return np.log(h / np.sqrt(2 * np.pi))
    # φ(t − u) = φ(u) exp(ut − t²/2); with s = |u| t the rest is of order one
    rest, _ = quad(lambda s: s * np.exp(-s - 0.5 * (s / u) ** 2), 0, 60, epsabs=0, epsrel=1e-12)
    return -0.5 * u * u - 0.5 * np.log(2 * np.pi) + np.log(rest) - 2 * np.log(-u)


@pytest.mark.parametrize("u", REGIMES)
def test_log_h_equals_numerical_integration(u):
    assert float(log_h(u)) == pytest.approx(integrated_log_h(u), rel=1e-12, abs=2e-10)


@pytest.mark.parametrize("u", REGIMES)
def test_slopes_in_every_regime(u):
    """Far below zero differences lose their digits; there h ≈ φ/u² (1 − 3/u²) gives the slopes."""
    by_mean, by_variance = log_expected_improvement_slopes(0.0, 1.0, u)
    # h = φ + uΦ, so that φ/h + uΦ/h = 1
    assert 2 * by_variance - u * by_mean == pytest.approx(1, abs=1e-15 * u * u + 1e-12)
    if u > -100:
        step = 1e-5
        slope = (integrated_log_h(u + step) - integrated_log_h(u - step)) / (2 * step)
        assert -by_mean == pytest.approx(slope, rel=1e-6)
    else:
        assert 2 * by_variance == pytest.approx(u * u + 3, rel=1e-8)
        assert -by_mean == pytest.approx(-u - 2 / u, rel=1e-8)


@pytest.mark.parametrize("best", [2.0, 0.0, -1.0, -20.0])
def test_slopes_of_expected_improvement(best):
    def value(moments):
        return log_expected_improvement(*moments.T, best)

    slopes = central_differences(value, np.array([0.3, 0.6]))
    assert log_expected_improvement_slopes(0.3, 0.6, best) == pytest.approx(slopes, rel=1e-6)
    tenfold = log_expected_improvement(3.0, 60.0, 10 * best)
    assert tenfold == pytest.approx(log_expected_improvement(0.3, 0.6, best) + np.log(10))


def test_equals_botorch():
    reason = "BoTorch is not installed: pip install '.[reference]'"
    torch = pytest.importorskip("torch", reason=reason)
    acquisition = pytest.importorskip("botorch.acquisition", reason=reason)
    from types import SimpleNamespace

    from botorch.models.model import Model

    class Predictions(Model):
        num_outputs = 1

        def posterior(self, X, **_):
            """The input holds the mean and the variance."""
            return SimpleNamespace(mean=X[..., :1], variance=X[..., 1:])

    moments = np.array([[0.3, 0.6], [2.0, 0.1], [-1.0, 4.0], [50.0, 0.01], [1e3, 1e-4]])
    for best in (1.0, -3.0):
        points = torch.tensor(moments, requires_grad=True)
        reference = acquisition.LogExpectedImprovement(Predictions(), best, maximize=False)
        values = reference(points[:, None, :])
        (gradients,) = torch.autograd.grad(values.sum(), points)
        ours = log_expected_improvement(*moments.T, best)
        np.testing.assert_allclose(ours, values.detach().numpy(), rtol=1e-9)
        slopes = [log_expected_improvement_slopes(m, v, best) for m, v in moments]
        np.testing.assert_allclose(slopes, gradients.numpy(), rtol=1e-4)
