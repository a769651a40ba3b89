"""Priors: the map from the unit cube against SciPy's distributions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.core.errors import ValueRefusedError
from fascicle.core.parameters import (
    NETWORK_SPACE,
    Parameter,
    ParameterSpace,
    free,
    network_space,
    ordered_fascicles,
)

SHARES = np.linspace(0.0, 1.0, 41)


def truncated(distribution, lower, upper):
    """Quantile function of a distribution within a range."""
    low, high = distribution.cdf([lower, upper])
    return lambda share: np.clip(distribution.ppf(low + share * (high - low)), lower, upper)


@pytest.mark.parametrize(
    ("parameter", "distribution"),
    [
        (Parameter("cv", "", 2.0, 4.0), scipy.stats.uniform(2, 2)),
        (Parameter("cv", "", 2.0, 4.0, "normal", 2.5, 0.4), scipy.stats.norm(2.5, 0.4)),
        (Parameter("g", "", 0.2, 5.0, "log-uniform"), scipy.stats.loguniform(0.2, 5.0)),
        (
            Parameter("a", "", 0.04, 0.12, "log-normal", 0.07, 0.3),
            scipy.stats.lognorm(0.3, scale=0.07),
        ),
    ],
    ids=lambda value: getattr(value, "prior", ""),
)
def test_quantiles_and_density(parameter, distribution):
    quantiles = truncated(distribution, parameter.lower, parameter.upper)
    values = parameter.from_unit(SHARES)
    np.testing.assert_allclose(values, quantiles(SHARES), rtol=1e-9)
    np.testing.assert_allclose(parameter.to_unit(values), SHARES, atol=1e-9)
    assert values[0] == pytest.approx(parameter.lower)
    assert values[-1] == pytest.approx(parameter.upper)
    mass = np.ptp(distribution.cdf([parameter.lower, parameter.upper]))
    inside = values[1:-1]
    np.testing.assert_allclose(
        parameter.density(inside), distribution.pdf(inside) / mass, rtol=1e-4
    )


@given(st.lists(st.floats(0, 1), min_size=12, max_size=12))
@settings(deadline=None)
def test_a_point_of_the_cube_and_back(point):
    values = NETWORK_SPACE.from_unit(np.array(point))
    np.testing.assert_allclose(NETWORK_SPACE.to_unit(values), point, atol=1e-12)


THREE = ordered_fascicles(network_space(lv=3))


@given(st.lists(st.floats(0.01, 0.99), min_size=14, max_size=14))
@settings(deadline=None)
def test_fascicles_in_order(point):
    values = THREE.from_unit(np.array(point))
    angles = [values[f"lv_fascicle_angle_{k}"] for k in (1, 2, 3)]
    assert angles == sorted(angles)
    np.testing.assert_allclose(THREE.to_unit(values), point, atol=1e-9)


def test_order_statistics_of_the_prior():
    drawn = [THREE.from_unit(p) for p in np.random.default_rng(0).random((4000, len(THREE)))]
    plain = network_space(lv=3).parameters
    for parameter, unordered in zip(THREE.parameters, plain, strict=True):
        values = np.array([each[parameter.name] for each in drawn])
        assert scipy.stats.kstest(parameter.to_unit(values), "uniform").pvalue > 0.001
        np.testing.assert_allclose(parameter.to_unit(parameter.from_unit(SHARES)), SHARES)
        if parameter.order:
            k, n = parameter.order
            share = unordered.to_unit(values).mean()
            assert share == pytest.approx(k / (n + 1), abs=0.02)


def test_fascicles_that_differ_have_no_order():
    space = network_space()
    for name in ("lv_fascicle_length_2", "lv_fascicle_angle_1"):
        changed = ParameterSpace(
            tuple(replace(p, lower=p.lower + 1) if p.name == name else p for p in space.parameters)
        )
        fixed = ParameterSpace(tuple(p for p in space.parameters if p.name != name))
        for one in (changed, fixed):
            ordered = {p.name for p in ordered_fascicles(one).parameters if p.order}
            assert ordered == {"rv_fascicle_angle_1", "rv_fascicle_angle_2"}


@pytest.mark.parametrize(
    ("name", "prior", "word"),
    [
        ("cv", {"lower": 3.0, "upper": 2.5}, "3 to 2.5"),
        ("cv", {"lower": float("nan")}, "nan"),
        ("cv", {"upper": 1e9}, "0.1 to 20"),
        ("cv", {"prior": "normal"}, "needs median and sd"),
        ("cv", {"prior": "normal", "median": 3.0}, "needs median and sd"),
        ("cv", {"median": 3.0, "sd": 0.1}, "has no median and sd"),
        ("cv", {"prior": "normal", "median": 9.0, "sd": 0.1}, "median 9"),
        ("cv", {"prior": "log-normal", "median": 3.0, "sd": -0.1}, "sd -0.1"),
        ("anterograde_delay", {"prior": "log-uniform"}, "above 0"),
        ("generations", {}, "fixed, not learnt"),
    ],
)
def test_impossible_priors_are_refused(name, prior, word):
    with pytest.raises(ValueRefusedError, match=word):
        free(name, **prior)
