"""Total variation between error densities."""

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.model_selection import GridSearchCV, LeaveOneOut
from sklearn.neighbors import KernelDensity

from fascicle.inference.abc import ErrorDensity, total_variation


def fitted(errors):
    return ErrorDensity.fit(np.asarray(errors))


def test_equal_sets_have_distance_zero_and_far_ones_one():
    """Also of equal beats, whose density is narrow."""
    rng = np.random.default_rng(0)
    far = fitted(5 + rng.random(10)), fitted(5000 + 100 * rng.random(10))
    for a, b in (far, (fitted(np.full(5, 2.0)), fitted(np.full(5, 2.1)))):
        assert total_variation(a, a) == 0.0
        assert total_variation(a, b) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("gap", [0.1, 2.5])
def test_two_normal_densities(gap):
    a = ErrorDensity(np.full(4, 9.0), 0.5)
    b = ErrorDensity(np.full(3, 9.0 + gap), 0.5)
    assert total_variation(a, b) == pytest.approx(2 * norm.cdf(gap) - 1, abs=1e-4)


def test_different_bandwidths():
    a, b = ErrorDensity(np.array([9.0, 9.0]), 0.01), ErrorDensity(np.array([9.0, 9.0]), 1.0)
    grid = np.linspace(0, 20, 4_000_001)
    gap = np.abs(norm.pdf(grid, 9, 0.01) - norm.pdf(grid, 9, 1.0))
    assert total_variation(a, b) == pytest.approx(0.5 * gap.sum() * grid[1], abs=1e-3)


def test_what_lies_below_zero_is_not_counted():
    a, b = ErrorDensity(np.array([0.0, 0.0]), 1.0), ErrorDensity(np.array([50.0, 50.0]), 1.0)
    assert total_variation(a, b) == pytest.approx(0.75, abs=1e-3)


def test_density_equals_scikit_learn():
    q = fitted(np.random.default_rng(2).gamma(2, 3, 40))
    grid = np.linspace(0, 30, 200)
    reference = KernelDensity(bandwidth=q.bandwidth).fit(q.errors[:, None])
    np.testing.assert_allclose(q(grid), np.exp(reference.score_samples(grid[:, None])), rtol=1e-9)


@pytest.mark.parametrize("n", [3, 20])
def test_bandwidth_equals_scikit_learn(n):
    errors = np.random.default_rng(n).gamma(2, 3, n)
    trials = errors.std(ddof=1) * np.geomspace(0.05, 2.0, 30)
    search = GridSearchCV(KernelDensity(), {"bandwidth": trials}, cv=LeaveOneOut())
    search.fit(errors[:, None])
    assert fitted(errors).bandwidth == pytest.approx(search.best_params_["bandwidth"])


@pytest.mark.parametrize("n", [2, 300])
def test_few_and_many_beats(n):
    rng = np.random.default_rng(n)
    q = fitted(5 + rng.standard_normal(n) * 0.3)
    nodes = q.nodes()
    assert np.trapezoid(q(nodes), nodes) == pytest.approx(1.0, abs=1e-6)
