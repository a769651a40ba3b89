"""Alignment by FFT against every shift tried; the gain against a minimiser."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from fascicle.forward.loss import LEAST_SHARE, align, placed

seeds, lengths = st.integers(0, 2**31), st.integers(1, 60)


def signals(seed, n_simulated, n_recorded, scale=1.0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(12, n_simulated)) * scale, rng.normal(size=(12, n_recorded))


def under(simulated, shift, length):
    """The simulation as it lies under the recording, written with a loop over samples."""
    result = np.zeros((12, length))
    for i in range(length):
        if 0 <= i + shift < simulated.shape[1]:
            result[:, i] = simulated[:, i + shift]
    return result


def every_shift(simulated, recorded):
    """Loss (mV²) at every shift with an overlap."""
    length = recorded.shape[1]
    return {
        shift: ((recorded - under(simulated, shift, length)) ** 2).sum() / length
        for shift in range(-(length - 1), simulated.shape[1])
    }


@given(seeds, lengths, lengths, st.sampled_from([1e-3, 1.0, 1e3]))
@example(0, 1, 40, 1.0)
@example(0, 40, 1, 1.0)
@settings(max_examples=150, deadline=None)
def test_alignment_is_the_best_of_all_shifts(seed, n_simulated, n_recorded, scale):
    simulated, recorded = signals(seed, n_simulated, n_recorded, scale)
    tried = every_shift(simulated, recorded)
    found = align(simulated, recorded)
    assert found.gain == 1.0
    assert found.loss == pytest.approx(tried[found.shift], rel=1e-12)
    assert found.loss <= min(tried.values()) * (1 + 1e-9)


@given(seeds, lengths, lengths)
@settings(max_examples=60, deadline=None)
def test_free_gain_is_the_best_of_all_gains_and_allowed_shifts(seed, n_simulated, n_recorded):
    """The closed form ⟨V̂, V⟩/‖V‖², not below 0, against a scalar minimiser at every shift."""
    simulated, recorded = signals(seed, n_simulated, n_recorded)
    length = recorded.shape[1]
    shifts = range(-(length - 1), n_simulated)
    windows = {shift: under(simulated, shift, length) for shift in shifts}
    most = max((window**2).sum() for window in windows.values())
    found = align(simulated, recorded, free_gain=True)
    assert found.gain >= 0
    assert (windows[found.shift] ** 2).sum() >= LEAST_SHARE * most * (1 - 1e-9) or found.gain == 0

    def loss(gain, window):
        return ((recorded - gain * window) ** 2).sum() / length

    assert found.loss == pytest.approx(loss(found.gain, windows[found.shift]), rel=1e-12)
    for window in windows.values():
        if (window**2).sum() >= LEAST_SHARE * most * (1 + 1e-9):
            best = minimize_scalar(loss, args=(window,), bounds=(0, 10), method="bounded")
            assert found.loss <= best.fun + 1e-9


def test_free_gain_does_not_blow_up_a_faint_tail():
    """The recording is a scaled copy of a faint part that holds 1 % of the simulation's energy."""
    simulated, _ = signals(8, 80, 1)
    simulated[:, 50:] *= 0.1
    found = align(simulated, 30.0 * simulated[:, 52:80], free_gain=True)
    assert found.shift < 50
    assert found.gain < 10.0


@pytest.mark.parametrize("shift", [-17, 0, 25])
def test_a_hidden_copy_is_found_where_it_lies(shift):
    """Sign of the shift: the recording begins at sample `shift` of the simulation."""
    simulated, _ = signals(3, 60, 1)
    found = align(simulated, under(simulated, shift, 50))
    assert found.shift == shift
    assert found.loss < 1e-20


def test_scaled_copy_gives_its_gain():
    simulated, _ = signals(4, 60, 1)
    found = align(simulated, 0.37 * simulated[:, 10:45], free_gain=True)
    assert (found.shift, found.gain) == (10, pytest.approx(0.37, rel=1e-12))
    assert found.loss < 1e-20


def test_inverted_ecg_is_not_mended_by_a_negative_gain():
    """An inverted polarity must stay a large loss, whatever the gain."""
    simulated = np.abs(signals(5, 40, 1)[0])
    found = align(simulated, -simulated, free_gain=True)
    assert found.gain == 0.0
    assert found.loss == pytest.approx((simulated**2).sum() / 40)


def test_loss_is_the_sum_over_leads_and_the_mean_over_time():
    """Twelve leads 0.1 mV apart: 12·0.01 = 0.12 mV², whatever the duration."""
    for length in (30, 90):
        simulated = np.full((12, length), 0.5)
        found = align(simulated, simulated + 0.1)
        assert found.loss == pytest.approx(0.12, rel=1e-9)


@given(seeds, lengths, lengths, st.integers(-80, 80), st.floats(0.0, 3.0))
@settings(max_examples=100, deadline=None)
def test_placed_is_zero_beyond_the_ends(seed, n_simulated, n_recorded, shift, gain):
    simulated, _ = signals(seed, n_simulated, 1)
    found = placed(simulated, shift, gain, n_recorded)
    np.testing.assert_array_equal(found, gain * under(simulated, shift, n_recorded))


def test_silent_simulation_has_the_energy_of_the_recording_as_loss():
    recorded = signals(6, 1, 30)[1]
    for free_gain in (False, True):
        found = align(np.zeros((12, 20)), recorded, free_gain=free_gain)
        assert found.loss == pytest.approx((recorded**2).sum() / 30)
