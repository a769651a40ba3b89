"""The QRS window of signals that are exactly zero outside it."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.leads import lead_matrix
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
