"""Share of a tetrahedron that a front has passed, and the histogram made of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.kernels.deposit import deposit, passed

knot = st.floats(0.0, 30.0)
knots = st.lists(knot, min_size=4, max_size=4).map(sorted)
# multiples of 1/64 ms, so that 30 − t is exact
grid = st.integers(0, 30 * 64).map(lambda k: k / 64)


def uniform_points(rng, count):
    """Barycentric coordinates of points uniform in a tetrahedron."""
    return rng.dirichlet(np.ones(4), count)


@pytest.mark.parametrize(
    "t",
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
    ],
)
def test_share_passed_is_the_volume_fraction(t):
    """Coincident knots included: a formula with 0/0 in it shows up as NaN or a jump."""
    tau = uniform_points(np.random.default_rng(1), 400_000) @ np.array(t)
    for now in np.linspace(-0.5, 4.5, 21):
        sampled = np.mean(tau < now)
        assert abs(passed(now, *t) - sampled) < 4e-3, (now, t)  # 5 standard errors


@pytest.mark.parametrize("t", [(1.0, 1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0 + 1e-13)])
def test_all_knots_together_is_a_step(t):
    assert passed(1.0 - 1e-6, *t) == 0.0
    assert passed(1.0 + 1e-6, *t) == 1.0


def test_first_and_last_piece_have_their_closed_form():
    """Before t₁ the passed part is a small tetrahedron with edges (t − t₀)/(tᵢ − t₀)."""
    t0, t1, t2, t3 = 1.0, 3.0, 4.0, 6.0
    assert passed(2.0, t0, t1, t2, t3) == pytest.approx(1 / (2 * 3 * 5), rel=1e-13)
    assert passed(5.0, t0, t1, t2, t3) == pytest.approx(1 - 1 / (5 * 3 * 2), rel=1e-13)


@given(knots, knot, knot)
@settings(max_examples=300, deadline=None)
def test_share_passed_rises_from_0_to_1(t, first, second):
    early, late = sorted((first, second))
    before, after = passed(early, *t), passed(late, *t)
    assert 0.0 <= before <= after + 1e-12
    assert after <= 1.0 + 1e-12


@given(st.lists(grid, min_size=4, max_size=4).map(sorted), grid)
@settings(max_examples=200, deadline=None)
def test_share_passed_is_mirrored_with_time(t, now):
    """Reversing time exchanges passed and not yet passed; catches a wrong piece at one end."""
    if now in t:
        return
    mirrored = [30.0 - x for x in reversed(t)]
    assert passed(now, *t) + passed(30.0 - now, *mirrored) == pytest.approx(1.0, abs=1e-9)


@given(st.lists(knot, min_size=4, max_size=4), st.integers(0, 2**31))
@settings(max_examples=100, deadline=None)
def test_histogram_keeps_total_and_first_moment(t, seed):
    """Total is the element's strength; mean time is the mean of its four knots to a bin."""
    weights = np.random.default_rng(seed).normal(size=(1, 3, 4))
    width, bins = 0.25, 130
    histogram = deposit(np.array(t), np.array([[0, 1, 2, 3]]), weights, width, bins)
    strength = weights[0] @ t
    scale = 1e-12 + np.abs(weights).max() * 30
    np.testing.assert_allclose(histogram.sum(axis=0), strength, atol=1e-12 * scale)
    centre = (np.arange(bins) + 0.5) * width
    moment = centre @ histogram
    assert np.all(np.abs(moment - strength * np.mean(t)) <= 0.5 * width * np.abs(strength) + 1e-9)


def test_histogram_does_not_depend_on_corner_order():
    rng = np.random.default_rng(3)
    t, weights = rng.uniform(0, 20, 4), rng.normal(size=(1, 2, 4))
    reference = deposit(t, np.array([[0, 1, 2, 3]]), weights, 0.25, 90)
    for _ in range(24):
        order = rng.permutation(4)
        turned = deposit(t, order[None], weights[:, :, order], 0.25, 90)
        np.testing.assert_allclose(turned, reference, atol=1e-12)
