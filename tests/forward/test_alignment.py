"""Alignment by FFT against shifts tried one by one in closed form; the gain against a minimiser."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from fascicle.forward.loss import Alignment, align, mismatch, placed

seeds = st.integers(0, 2**31)
LENGTH = 120  # samples of a simulation


class Waves:
    """Leads of a few bell-shaped waves: known at any time, silent at both ends."""

    def __init__(self, seed, leads=12, waves=3):
        rng = np.random.default_rng(seed)
        self.height = rng.normal(size=(leads, waves))
        self.centre = rng.uniform(40.0, 80.0, waves)
        self.width = rng.uniform(3.0, 6.0, waves)

    def __call__(self, time):
        bells = np.exp(-(((time - self.centre[:, None]) / self.width[:, None]) ** 2) / 2)
        return self.height @ bells

    def sampled(self, first=0.0, length=LENGTH):
        return self(first + np.arange(float(length)))


def loss_at(waves, recorded, shift, gain=1.0):
    """Loss (mV²) at one shift: the window, and all that lies outside it."""
    length = recorded.shape[1]
    around = 4 * LENGTH  # where they correlate nowhere, the best shift is one far away
    time = shift + np.arange(-around, length + around)
    everywhere = np.zeros((len(recorded), len(time)))
    everywhere[:, around : around + length] = recorded
    return ((everywhere - gain * waves(time)) ** 2).sum() / length


@given(seeds, st.integers(20, 100), st.sampled_from([1e-3, 1.0, 1e3]))
@example(120, 98, 1e3)  # which correlate nowhere
@settings(max_examples=10, deadline=None)
def test_alignment_is_the_best_of_all_shifts(seed, n_recorded, scale):
    """Shifts of a tenth of a sample; the one found lies between them."""
    waves = Waves(seed)
    waves.height *= scale
    recorded = Waves(seed + 1).sampled(20.0, n_recorded)
    found = align(waves.sampled(), recorded)
    tried = [loss_at(waves, recorded, s) for s in np.arange(-n_recorded, LENGTH, 0.1)]
    assert found.gain == 1.0
    assert found.loss == pytest.approx(loss_at(waves, recorded, found.shift), rel=1e-6)
    assert found.loss <= min(tried) * (1 + 1e-9)


@given(seeds)
@settings(max_examples=8, deadline=None)
def test_free_gain_is_the_best_of_all_gains_and_shifts(seed):
    waves, recorded = Waves(seed), Waves(seed + 1).sampled(20.0, 80)
    found = align(waves.sampled(), recorded, free_gain=True)
    assert found.gain >= 0
    assert found.loss == pytest.approx(loss_at(waves, recorded, found.shift, found.gain), rel=1e-6)
    for shift in np.arange(-40.0, 100.0, 2.5):
        best = minimize_scalar(
            lambda gain, shift=shift: loss_at(waves, recorded, shift, gain),
            bounds=(0, 100),
            method="bounded",
        )
        assert found.loss <= best.fun * (1 + 1e-6)


@pytest.mark.parametrize("delay", [-17.0, -0.5, 0.0, 0.25, 0.5, 25.3])
def test_a_delay_costs_nothing(delay):
    """Also one of a part of a sample. The recording begins at sample `delay` of the simulation."""
    waves = Waves(3)
    found = align(waves.sampled(), waves.sampled(delay))
    assert found.shift == pytest.approx(delay, abs=1e-6)
    assert found.loss < 1e-10


def test_loss_is_continuous_in_amplitude_and_grows_away_from_one():
    waves = Waves(4)
    flat = (waves.sampled() ** 2).sum() / LENGTH
    factors = np.linspace(0.0, 3.0, 301)
    losses = np.array([align(f * waves.sampled(), waves.sampled()).loss for f in factors])
    np.testing.assert_allclose(losses, (factors - 1) ** 2 * flat, atol=1e-10 * flat)


def test_a_simulation_cannot_leave_the_window():
    """One that has nothing to do with the recording is worse than none at all."""
    waves = Waves(5)
    recorded = np.zeros((12, LENGTH))
    recorded[0, 60] = 1e-3
    flat = (recorded**2).sum() / LENGTH
    found = align(waves.sampled(), recorded)
    assert found.loss > 0.99 * (waves.sampled() ** 2).sum() / LENGTH > 1000 * flat


def test_what_lies_outside_the_window_counts():
    """Two equal waves, of which the recording's window holds one."""
    one = Waves(6, waves=1)
    one.centre[:] = 40.0
    alone = one.sampled()
    twice = alone + one.sampled(-60.0)  # again 60 samples later
    found = align(twice, alone[:, 15:65])
    assert found.outside == pytest.approx((alone**2).sum() / 50, rel=1e-4)
    assert found.loss == pytest.approx(found.outside, rel=1e-4)


def test_free_gain_does_not_blow_up_a_faint_tail():
    """The recording is a scaled copy of a faint part that holds 1 % of the simulation's energy."""
    one = Waves(8, waves=1)
    one.centre[:], one.width[:] = 30.0, 4.0
    simulated = one.sampled() + 0.1 * one.sampled(-60.0)
    found = align(simulated, 30.0 * simulated[:, 70:110], free_gain=True)
    assert found.shift == pytest.approx(10.0, abs=0.1)
    assert found.gain == pytest.approx(3.0, rel=0.02)


def test_inverted_ecg_is_not_mended_by_a_negative_gain():
    """An inverted polarity must stay a large loss, whatever the gain."""
    waves = Waves(5)
    waves.height = np.abs(waves.height)
    recorded = -waves.sampled()
    found = align(waves.sampled(), recorded, free_gain=True)
    assert found.gain == pytest.approx(0.0, abs=1e-9)
    assert found.loss == pytest.approx((recorded**2).sum() / LENGTH)


def test_loss_is_the_sum_over_leads_and_the_mean_over_time():
    """Twelve leads 0.1 mV apart: 12·0.01 = 0.12 mV², whatever the duration; for each beat."""
    for length in (30, 90):
        under = np.full((12, length), 0.5)
        beats = np.stack([under + 0.1, under - 0.2])
        found = mismatch(beats, Alignment(0.0, 0.0, 1.0, under, 0.01))
        np.testing.assert_allclose(found, [0.13, 0.49], rtol=1e-12)


@given(seeds, st.integers(1, 300), st.floats(-150, 150))
@settings(max_examples=60, deadline=None)
def test_placed_is_the_simulation_in_its_place_and_zero_beyond(seed, length, shift):
    waves = Waves(seed)
    found = placed(waves.sampled(), shift, length)
    np.testing.assert_allclose(found, waves.sampled(shift, length), atol=1e-6)


def test_both_sides_pass_the_same_filter():
    def response(frequency):
        return 1.0 / (1.0 + (frequency / 0.04) ** 4)

    waves = Waves(9)
    recorded = placed(waves.sampled(), -150.0, 420, response)
    assert align(waves.sampled(), recorded).loss > 1e-3
    found = align(waves.sampled(), recorded, response=response)
    assert found.shift == pytest.approx(-150.0, abs=1e-4)
    assert found.loss < 1e-12
    np.testing.assert_allclose(found.under, recorded, atol=1e-6)


def test_silent_simulation_has_the_energy_of_the_recording_as_loss():
    recorded = Waves(6).sampled(30.0, 30)
    for free_gain in (False, True):
        found = align(np.zeros((12, 20)), recorded, free_gain=free_gain)
        assert found.loss == pytest.approx((recorded**2).sum() / 30)
