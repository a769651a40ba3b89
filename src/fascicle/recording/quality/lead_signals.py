"""Leads over the time in which they were recorded."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import block_means

UV_PER_MV = 1e3
COARSE_RATE = 250.0  # Hz; enough to see the QRS
BASELINE_WIDTH = 0.5  # s; moving average, applied twice, that is taken as baseline
SMOOTH_WIDTH = 0.012  # s; moving average against noise, -3 dB at 37 Hz


def measured(recording: Recording) -> dict[str, Floats]:
    """Samples (mV) of each lead over its own time; computed leads are left out."""
    spans = recording.spans
    return {
        lead: recording.signal[LEADS.index(lead), slice(*spans[LEADS.index(lead)])]
        for lead in recording.measured_leads
    }


def coarse(signal: Floats, rate: float) -> tuple[Floats, float]:
    """Block means (mV) of a signal (..., n), and their rate (Hz), not below `COARSE_RATE`."""
    factor = max(int(rate / COARSE_RATE), 1)
    return block_means(signal, factor), rate / factor


def smoothed(signal: Floats, rate: float) -> Floats:
    """Signal (..., n) with less noise: its moving average over `SMOOTH_WIDTH`."""
    width = max(round(SMOOTH_WIDTH * rate), 1)
    return np.asarray(uniform_filter1d(signal, width, axis=-1, mode="nearest"))


def steady(signal: Floats, rate: float) -> Floats:
    """Signal (..., n), mV, without baseline and with less noise, about 0.6 to 37 Hz.

    Moving averages cost the same at any width, so that half an hour takes a moment; they are
    linear, so that whatever holds between leads still holds.
    """
    width = max(round(BASELINE_WIDTH * rate), 1)
    baseline = uniform_filter1d(signal, width, axis=-1, mode="nearest")
    baseline = uniform_filter1d(baseline, width, axis=-1, mode="nearest")
    return smoothed(signal - baseline, rate)
