"""The QRS window of simulated ECGs behind steep low-passes, which ring before and after the QRS."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin, combined_gain
from fascicle.recording.window import SMOOTHING, qrs_window, smoothing_against_ringing


def lowpass(cutoff, order):
    return Filter(FilterKind.LOW_PASS, cutoff, FilterOrigin.STATED, order)


@pytest.mark.parametrize(("cutoff", "order"), [(35.0, 20.0), (40.0, 20.0), (40.0, 10.0)])
def test_ringing_is_no_qrs(default_model, cutoff, order):
    leads = default_model.simulate(EXAMPLE_PARAMETERS).leads
    sharp = np.pad(leads, ((0, 0), (250, 250)))
    size = sharp.shape[1]
    filters = (lowpass(cutoff, order),)
    gain = combined_gain(filters, np.fft.rfftfreq(size, 1e-3))
    blurred = np.fft.irfft(gain * np.fft.rfft(sharp), size)
    onset, offset = qrs_window(sharp, 1.0)
    counted = qrs_window(blurred, 1.0)
    assert (counted[1] - counted[0]) - (offset - onset) > 20
    found = qrs_window(blurred, 1.0, smoothing=smoothing_against_ringing(filters))
    assert found == (pytest.approx(onset, abs=5), pytest.approx(offset, abs=5))


def test_gentle_and_fast_filters_need_no_smoothing():
    notch = Filter(FilterKind.NOTCH, 50.0, FilterOrigin.FILE, 30.0)
    assert smoothing_against_ringing(()) == SMOOTHING
    assert smoothing_against_ringing((lowpass(40.0, 2.0), lowpass(150.0, 20.0), notch)) == SMOOTHING
    assert smoothing_against_ringing((lowpass(100.0, 20.0), lowpass(40.0, 20.0))) == 10.0
