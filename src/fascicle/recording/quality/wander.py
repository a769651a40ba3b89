"""Wander of the baseline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.finding import Finding, warning_if
from fascicle.recording.quality.stretches import coarse, measured
from fascicle.recording.quality.wording import listed
from fascicle.recording.recording import Recording

LARGEST_WANDER = 1.0  # mV peak to peak, 10 mm on paper; every beat is levelled by itself anyway
HIGHEST = 0.5  # Hz; below it there is no ECG (AHA/ACC/HRS, Circulation 115:1306, 2007)
RANGE = (1.0, 99.0)  # percentiles taken as lowest and highest


def check_wander(recording: Recording) -> list[Finding]:
    """Find leads whose baseline wanders.

    Returns
    -------
    list of Finding
        The largest peak-to-peak amplitude (mV) of a lead below 0.5 Hz.
    """
    rate = recording.sampling_rate
    wander = {lead: _slow_range(values, rate) for lead, values in measured(recording).items()}
    wandering = [lead for lead, figure in wander.items() if figure > LARGEST_WANDER]
    largest = max(wander.values())
    message = ""
    if wandering:
        message = (
            f"the baseline of {listed(wandering)} wanders (up to {largest:.2f} mV peak to peak); "
            "look at the beats, or record again at rest"
        )
    return [warning_if(message, "baseline wander", largest, "mV", LARGEST_WANDER)]


def _slow_range(values: NDArray[np.float64], rate: float) -> float:
    """Peak-to-peak amplitude (mV) of one lead below `HIGHEST`."""
    from scipy.signal import butter, sosfiltfilt

    x, coarse_rate = coarse(values, rate)
    low = butter(2, HIGHEST, fs=coarse_rate, output="sos")
    pad = min(len(x) - 1, round(2 * coarse_rate / HIGHEST))
    slow = sosfiltfilt(low, x - np.median(x), padtype="even", padlen=pad)
    below, above = np.percentile(slow, RANGE)
    return float(above - below)
