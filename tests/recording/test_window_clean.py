"""The QRS window of signals whose ends are known and that hold no noise but what a test adds."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.core.leads import lead_matrix
from fascicle.recording.window import qrs_window


def depolarisation(start, end, step, length):
    """(12, n) mV, smooth, nonzero from start to end (ms) only."""
    t = np.arange(0, length, step)
    phase = np.clip((t - start) / (end - start), 0, 1)
    turns = np.array([1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5])[:, None]
    rise = np.sin(np.pi * phase)
    return lead_matrix() @ (rise * np.sin(np.pi * turns * phase + turns))


@pytest.mark.parametrize("step", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("start", "end"), [(40, 120), (60, 240), (30, 200)])
def test_ends_of_a_clean_qrs(start, end, step):
    onset, offset = qrs_window(depolarisation(start, end, step, 400), step)
    # A kink at the true end is smoothed by a 4 ms Gaussian, so it is seen up to 2.5 widths early.
    assert onset * step == pytest.approx(start, abs=10)
    assert offset * step == pytest.approx(end, abs=10)
    assert onset * step <= start + 1
    assert offset * step >= end - 1


def test_qrs_that_fills_the_array():
    signal = depolarisation(0, 100, 1.0, 101)
    onset, offset = qrs_window(signal, 1.0)
    assert onset == 0
    assert offset == signal.shape[1] - 1


def test_window_does_not_depend_on_amplitude():
    signal = depolarisation(50, 150, 1.0, 300)
    assert qrs_window(signal, 1.0) == qrs_window(1e-6 * signal, 1.0)


def test_t_wave_stays_outside():
    signal = depolarisation(100, 200, 1.0, 700)
    t = np.arange(700)
    signal = signal + 0.3 * np.exp(-(((t - 450) / 60.0) ** 2))
    onset, offset = qrs_window(signal, 1.0)
    assert 90 <= onset <= 101
    assert 199 <= offset <= 211


def test_longer_activation_is_measured_longer():
    durations = []
    for end in (100, 130, 160, 190):
        onset, offset = qrs_window(depolarisation(20, end, 1.0, 400), 1.0)
        durations.append(offset - onset)
    assert np.diff(durations) == pytest.approx(30, abs=4)


def test_no_signal_is_an_error():
    with pytest.raises(ValueError, match="do not move"):
        qrs_window(np.zeros((12, 100)), 1.0)


def beat(start=150, end=250, length=700):
    """QRS with a P wave that ends 40 ms before it, and a T wave (12, n) mV, every 1 ms."""
    t = np.arange(length)
    p_wave = 0.12 * np.exp(-(((t - start + 85) / 20.0) ** 2))
    t_wave = 0.3 * np.exp(-(((t - end - 200) / 55.0) ** 2))
    return depolarisation(start, end, 1.0, length) + p_wave + t_wave


BEAT_WINDOW = qrs_window(beat(), 1.0)


def test_p_and_t_wave_stay_outside():
    assert BEAT_WINDOW[0] == pytest.approx(150, abs=10)
    assert BEAT_WINDOW[1] == pytest.approx(250, abs=10)


@pytest.mark.parametrize("lead", [0, 1, 7, 11])
def test_one_noisy_lead_decides_nothing(lead):
    signal = beat()
    signal[lead] += 0.3 * np.random.default_rng(lead).standard_normal(signal.shape[1])
    assert qrs_window(signal, 1.0) == pytest.approx(BEAT_WINDOW, abs=5)


@pytest.mark.parametrize("at", [110, 135, 270, 300])
def test_step_in_one_lead_decides_nothing(at):
    signal = beat()
    signal[8, at:] += 1.0
    assert qrs_window(signal, 1.0) == pytest.approx(BEAT_WINDOW, abs=5)


@pytest.mark.parametrize("frequency", [50, 60])
def test_hum_in_all_leads_is_taken_away(frequency):
    signal = beat()
    time = np.arange(signal.shape[1]) / 1000
    hum = 0.2 * np.sin(2 * np.pi * frequency * time + np.arange(12)[:, None])
    assert qrs_window(signal + hum, 1.0) == pytest.approx(BEAT_WINDOW, abs=5)


def test_leads_that_are_not_there_are_ignored():
    signal = beat()
    signal[[0, 3, 8, 9]] = np.nan
    assert qrs_window(signal, 1.0) == pytest.approx(BEAT_WINDOW, abs=5)
    signal[:] = np.nan
    with pytest.raises(ValueError, match="lead"):
        qrs_window(signal, 1.0)


def test_level_and_drift_do_not_matter():
    signal = beat()
    drift = np.linspace(-1, 1, 12)[:, None] * (2 + np.arange(signal.shape[1]) / 2000)
    assert qrs_window(signal + drift, 1.0) == pytest.approx(BEAT_WINDOW, abs=2)


def test_st_segment_that_slopes_stays_outside():
    signal = beat()
    after = np.clip(np.arange(signal.shape[1]) - 250, 0, 150)
    slopes = 1.5e-3 * np.cos(np.arange(12))[:, None]  # mV/ms
    onset, offset = qrs_window(signal + slopes * after, 1.0)
    assert onset == BEAT_WINDOW[0]
    assert offset == pytest.approx(250, abs=12)


@pytest.mark.parametrize("height", [0.05, 0.1, 0.15])
def test_short_pr_interval(height):
    """The P wave, of 75 ms, ends 5 ms before the QRS; what smoothing shows of both merges."""
    t = np.arange(700)
    phase = np.clip((t - 70) / 75.0, 0, 1)
    begin = np.clip((t - 150) / 20.0, 0, 1)
    signal = begin * depolarisation(150, 250, 1.0, 700)
    signal += height * np.cos(0.3 * np.arange(12))[:, None] * np.sin(np.pi * phase) ** 2
    onset, offset = qrs_window(signal, 1.0)
    assert onset == pytest.approx(150, abs=15)
    assert offset == pytest.approx(250, abs=10)


def test_slurred_upstroke_belongs_to_the_qrs():
    """A delta wave of 40 ms and 0.25 mV before the steep part."""
    t = np.arange(700)
    rise = np.clip((t - 150) / 40.0, 0, 1) ** 1.3 * np.clip((240 - t) / 40.0, 0, 1)
    signal = depolarisation(190, 270, 1.0, 700) + 0.25 * np.cos(np.arange(12))[:, None] * rise
    onset, offset = qrs_window(signal, 1.0)
    assert onset == pytest.approx(150, abs=10)
    assert offset == pytest.approx(270, abs=10)


def test_wide_fragmented_qrs():
    """A steep start, a slow middle with notches, a steeper end: 220 ms."""
    signal = depolarisation(150, 230, 1.0, 700)
    signal += 0.4 * depolarisation(200, 370, 1.0, 700)
    for notch in (240, 275, 310):
        signal += 0.1 * depolarisation(notch, notch + 20, 1.0, 700)
    onset, offset = qrs_window(signal, 1.0)
    assert onset == pytest.approx(150, abs=10)
    assert offset == pytest.approx(370, abs=10)


def test_nothing_before_the_end_of_a_spike_counts():
    signal = beat()
    signal[:, 140:144] += 5.0 * np.cos(np.arange(12))[:, None]
    free = qrs_window(signal, 1.0)
    onset, offset = qrs_window(signal, 1.0, not_before=146)
    assert free[0] < 140
    assert 146 <= onset == pytest.approx(150, abs=8)
    assert offset == BEAT_WINDOW[1]


def test_one_lead_that_moves_alone_is_no_qrs():
    signal = np.zeros((12, 300))
    signal[7, 100:] = 1.0
    with pytest.raises(ValueError, match="one of many alone"):
        qrs_window(signal, 1.0)
