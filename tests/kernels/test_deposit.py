"""The histogram of an element's front: the share of its volume that each bin sees."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from fascicle.kernels.deposit import KNOT_GAP, deposit, respond
from fascicle.kernels.jit import CHANNELS

ORIGIN, WIDTH, BINS = -1.0, 0.5, 80
PEAKS = ORIGIN + np.arange(BINS) * WIDTH
CORNERS = np.array([[0, 1, 2, 3]])
knots = st.lists(st.floats(0.0, 30.0), min_size=4, max_size=4)


def histogram_of(times, weights, corners=CORNERS):
    return deposit(np.asarray(times, float), corners, weights, ORIGIN, WIDTH, BINS)


def shares(times):
    """What each bin gets of an element of strength 1."""
    times = np.asarray(times, float)
    weights = np.zeros((1, 3, CHANNELS))
    differs = int(np.argmax(np.abs(times[1:] - times[0])))
    weights[0, differs, 0] = 1 / (times[1 + differs] - times[0])
    return histogram_of(times, weights)[:, 0]


def hat(time, peak):
    return np.maximum(0.0, 1 - np.abs(time - peak) / WIDTH)


def sampled_shares(times, count=400_000):
    """The same by points uniform in the tetrahedron; standard error at most 8e-4."""
    tau = np.random.default_rng(1).dirichlet(np.ones(4), count) @ np.asarray(times, float)
    near = np.flatnonzero((min(times) - WIDTH < PEAKS) & (max(times) + WIDTH > PEAKS))
    expected = np.zeros(BINS)
    expected[near] = [hat(tau, PEAKS[i]).mean() for i in near]
    return expected


def integrated_shares(times):
    """The same by the B-spline density of scipy, integrated exactly piece by piece."""
    times = np.sort(times)
    density = BSpline.basis_element(times)
    breaks = np.unique(np.concatenate([times, PEAKS[(times[0] < PEAKS) & (times[3] > PEAKS)]]))
    node, weight = np.polynomial.legendre.leggauss(3)
    middle, half = (breaks[1:] + breaks[:-1]) / 2, np.diff(breaks) / 2
    x = (middle[:, None] + half[:, None] * node).ravel()
    mass = (half[:, None] * weight).ravel() * density(x) * 3 / (times[3] - times[0])
    return hat(x, PEAKS[:, None]) @ mass


@pytest.mark.parametrize(
    "times",
    [
        (0.0, 1.0, 2.5, 4.0),
        (0.0, 0.0, 2.0, 4.0),
        (0.0, 2.0, 2.0, 4.0),
        (0.0, 1.0, 4.0, 4.0),
        (0.0, 0.0, 4.0, 4.0),
        (0.0, 0.0, 0.0, 4.0),
        (0.0, 4.0, 4.0, 4.0),
        (0.0, 1e-9, 2e-9, 4.0),
        (0.0, 1.0, 1.0 + 1e-12, 4.0),
        (0.1, 0.2, 0.25, 0.4),
    ],
)
def test_bins_share_the_volume(times):
    """Coincident times included: a formula with 0/0 in it shows up as NaN or a jump."""
    assert np.abs(shares(times) - sampled_shares(times)).max() < 4e-3  # 5 standard errors


def test_an_element_that_fires_at_once_is_in_one_place():
    """All four times together, to less than `KNOT_GAP` of a bin: the hats at that time."""
    for spread in (1e-13, 1e-6, 0.01):
        at = 5.2
        found = shares([at, at + spread, at, at - spread])
        assert np.abs(found - hat(at, PEAKS)).max() < KNOT_GAP


@given(knots)
@settings(max_examples=200, deadline=None)
def test_bins_are_the_integrals_of_the_b_spline(times):
    if np.diff(np.sort(times)).min() < 2 * KNOT_GAP * WIDTH:
        return
    np.testing.assert_allclose(shares(times), integrated_shares(times), atol=1e-8)


@given(knots, st.integers(0, 2**31))
@settings(max_examples=200, deadline=None)
def test_total_and_mean_time_are_kept(times, seed):
    """Whatever coincides, total and first moment stay and nothing drifts after the front."""
    weights = np.random.default_rng(seed).normal(size=(1, 3, CHANNELS))
    histogram = histogram_of(times, weights)
    strength = np.diff(times).cumsum() @ weights[0]
    scale = np.abs(strength).max() + 1e-9
    np.testing.assert_allclose(histogram.sum(axis=0), strength, atol=1e-6 * scale)
    np.testing.assert_allclose(PEAKS @ histogram, strength * np.mean(times), atol=2e-5 * scale)
    after = max(times) + 2 * WIDTH < PEAKS
    assert np.abs(histogram[after]).max() < 1e-7 * scale
    assert (histogram * np.sign(strength)).min() > -1e-7 * scale


def test_histogram_does_not_depend_on_corner_order():
    rng = np.random.default_rng(3)
    times = rng.uniform(0, 20, 4)
    to_each = rng.normal(size=(4, CHANNELS))
    to_each -= to_each.mean(axis=0)  # a constant time is no front
    reference = histogram_of(times, to_each[None, 1:])
    for _ in range(24):
        order = rng.permutation(4)
        turned = histogram_of(times, to_each[order][None, 1:], order[None])
        np.testing.assert_allclose(turned, reference, atol=1e-11)


def test_elements_add_up_and_one_with_a_vertex_never_reached_is_left_out():
    """Shared vertices; an infinite time beside finite ones gives no NaN and no part of a front."""
    rng = np.random.default_rng(4)
    times = np.append(rng.uniform(0, 20, 6), np.inf)
    corners = np.array([[0, 1, 2, 3], [1, 2, 3, 4], [6, 3, 4, 5], [3, 4, 5, 0], [2, 6, 0, 1]])
    weights = rng.normal(size=(5, 3, CHANNELS))
    one_by_one = [histogram_of(times, weights[[e]], corners[[e]]) for e in (0, 1, 3)]
    together = histogram_of(times, weights, corners)
    np.testing.assert_allclose(together, sum(one_by_one), atol=1e-11)
    assert not histogram_of(times, weights[[2]], corners[[2]]).any()


def test_response_is_the_convolution_at_every_second_bin():
    rng = np.random.default_rng(5)
    histogram, kernel = rng.normal(size=(31, CHANNELS)), rng.normal(size=8)
    found = respond(histogram, kernel, 2, 12)
    for channel, curve in zip(histogram.T, found, strict=True):
        expected = np.convolve(channel, kernel, mode="valid")[::2]
        np.testing.assert_allclose(curve, expected, atol=1e-12)
