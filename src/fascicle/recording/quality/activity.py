"""When leads beat, each on its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS
from fascicle.recording.quality.lead_signals import coarse, measured, steady
from fascicle.recording.recording import Recording

QRS_WIDTH = 0.06  # s; moving average of the slope
REFRACTORY = 0.3  # s between two beats
STRONG = 0.5  # of the highest activity: a beat
HIGHEST = 99.0  # percentile taken as the highest activity
LARGEST_WEIGHT = 30.0  # times its median that the activity of one lead counts in a group


@dataclass(frozen=True)
class Activity:
    """How much each lead moves.

    Attributes
    ----------
    wave : (12, n) array
        Potential (mV) without baseline; NaN for leads that are absent, computed or flat, and
        outside the time in which it was recorded.
    speed : (12, n) array
        Mean absolute slope over the time that a QRS takes, over its median, so that 1 is usual
        between beats; NaN where `wave` is.
    rate : float
        Samples per second (Hz).
    """

    wave: Floats
    speed: Floats
    rate: float


def activity(recording: Recording) -> Activity:
    """How much each lead of a recording moves."""
    from scipy.ndimage import uniform_filter1d

    empty, rate = coarse(np.zeros(recording.signal.shape[1]), recording.sampling_rate)
    shape = (len(LEADS), len(empty))
    found = Activity(np.full(shape, np.nan), np.full(shape, np.nan), rate)
    factor, spans = recording.sampling_rate / rate, recording.spans
    for lead, values in measured(recording).items():
        row = LEADS.index(lead)
        x, _ = coarse(values, recording.sampling_rate)
        wave = steady(x, rate)
        slope = np.abs(np.gradient(wave))
        speed = uniform_filter1d(slope, round(QRS_WIDTH * rate), mode="nearest")
        usual = float(np.median(speed))
        if usual > 0:
            start = round(int(spans[row, 0]) / factor)
            stop = min(start + len(speed), len(empty))
            found.speed[row, start:stop] = speed[: stop - start] / usual
            found.wave[row, start:stop] = wave[: stop - start]
    return found


def mean_activity(speed: Floats) -> Floats:
    """Mean over leads of their activity (m, n), NaN where none is recorded."""
    there = np.isfinite(speed)
    total = np.where(there, np.minimum(speed, LARGEST_WEIGHT), 0.0).sum(axis=0)
    return np.where(there.any(axis=0), total / np.maximum(there.sum(axis=0), 1), np.nan)


def beats_of(speed: Floats, rate: float) -> tuple[Integers, float]:
    """Samples at which one activity (n,) is strong, and how far above the usual it is there."""
    from scipy.signal import find_peaks

    there = speed[np.isfinite(speed)]
    if not there.size:
        return np.zeros(0, dtype=np.int64), 0.0
    filled = np.where(np.isfinite(speed), speed, 0.0)
    strong = STRONG * float(np.percentile(there, HIGHEST))
    found, _ = find_peaks(filled, height=strong, distance=max(round(REFRACTORY * rate), 1))
    if not len(found):
        return np.zeros(0, dtype=np.int64), 0.0
    return np.asarray(found, dtype=np.int64), float(np.median(speed[found]) / np.median(there))
