"""Noise of each lead between the beats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.finding import Finding, Severity
from fascicle.recording.quality.stretches import SMOOTH_WIDTH, measured
from fascicle.recording.quality.wording import leave_out, listed
from fascicle.recording.recording import Recording

NOISY = 0.05  # mV; standard deviation, a band 3 mm wide on paper
LOST = 0.3  # mV; standard deviation at which the QRS drowns
TO_STANDARD_DEVIATION = 1.4826  # times the median absolute deviation, for a normal distribution
ENOUGH = 200_000  # samples that give the median


def check_noise(recording: Recording) -> list[Finding]:
    """Find noisy leads, and leads that are nothing but noise.

    Returns
    -------
    list of Finding
        The largest standard deviation (uV) of a lead above 37 Hz, by the median absolute deviation:
        the QRS takes too little of the time to count.
    """
    rate = recording.sampling_rate
    noise = {lead: _fast(values, rate) for lead, values in measured(recording).items()}
    noisy = [lead for lead, figure in noise.items() if figure > NOISY]
    lost = [lead for lead, figure in noise.items() if figure > LOST]
    largest = 1e3 * max(noise.values())
    severity, message = Severity.FINE, ""
    if lost and len(lost) < len(noise):
        severity = Severity.FATAL
        message = (
            f"noise drowns {listed(lost)} (SD up to {largest:.0f} uV): electrode off? Go on "
            f"without: {leave_out(recording, lost)}"
        )
    elif noisy:
        severity = Severity.WARNING
        message = f"noise in {listed(noisy)} (SD up to {largest:.0f} uV above 37 Hz); record again"
    return [Finding("noise above 37 Hz", largest, "uV", 1e3 * NOISY, severity, message)]


def _fast(values: NDArray[np.float64], rate: float) -> float:
    """Robust standard deviation (mV) of what a moving average takes off."""
    from scipy.ndimage import uniform_filter1d

    width = max(round(SMOOTH_WIDTH * rate), 1)
    fast = values - uniform_filter1d(values, width, mode="nearest")
    fast = fast[:: max(len(fast) // ENOUGH, 1)]
    return TO_STANDARD_DEVIATION * float(np.median(np.abs(fast - np.median(fast))))
