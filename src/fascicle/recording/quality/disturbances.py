"""Noise, hum of the mains and wander of the baseline."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.recording.quality.finding import Check, Finding, Severity, leave_out, listed
from fascicle.recording.quality.lead_signals import UV_PER_MV, coarse, measured, smoothed
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import MAINS

NOISE = Check("noise above 37 Hz", "uV", 50.0)  # a band 3 mm wide on paper
LOST = 0.3  # mV; standard deviation at which the QRS drowns
TO_STANDARD_DEVIATION = 1.4826  # times the median absolute deviation, for a normal distribution
ENOUGH = 200_000  # samples that give the median

HUM = Check("mains hum", "uV", 25.0)  # amplitude, a quarter of a millimetre on paper
HARMONICS = (1, 2, 3)
SEGMENT = 4.0  # s
LINE_WIDTH = 0.75  # Hz each side, which allows for mains that are not quite on their frequency
NEIGHBOURS = 4.0  # Hz each side of the line, whose power is that of the ECG there

WANDER = Check("baseline wander", "mV", 1.0)  # 10 mm on paper; every beat is detrended anyway
HIGHEST_WANDER = 0.5  # Hz; below it there is no ECG (AHA/ACC/HRS, Circulation 115:1306, 2007)
RANGE = (1.0, 99.0)  # percentiles taken as lowest and highest


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
    lost = [lead for lead, figure in noise.items() if figure > LOST]
    if lost and len(lost) < len(noise):
        largest = UV_PER_MV * max(noise.values())
        message = (
            f"noise drowns {listed(lost)} (SD up to {largest:.0f} uV): electrode off? Go on "
            f"without: {leave_out(recording, lost)}"
        )
        return [NOISE.found(largest, message, Severity.FATAL)]
    message = "noise in {leads} (SD up to {largest:.0f} uV above 37 Hz); record again"
    return [NOISE.worst_lead(noise, message, UV_PER_MV)]


def _fast(values: Floats, rate: float) -> float:
    """Robust standard deviation (mV) of what a moving average takes off."""
    fast = values - smoothed(values, rate)
    fast = fast[:: max(len(fast) // ENOUGH, 1)]
    return TO_STANDARD_DEVIATION * float(np.median(np.abs(fast - np.median(fast))))


def check_mains(recording: Recording) -> list[Finding]:
    """Find hum at 50 or 60 Hz and its harmonics.

    Returns
    -------
    list of Finding
        The largest amplitude (uV) in a lead: the power of the lines less that of the spectrum
        beside them (mean over `SEGMENT` s pieces), as amplitude of one sine.
    """
    leads, rate = measured(recording), recording.sampling_rate
    hum = {
        mains: {lead: _amplitude(values, rate, mains) for lead, values in leads.items()}
        for mains in MAINS
    }
    worst = max(hum, key=lambda mains: max(hum[mains].values()))
    message = (
        f"hum at {worst:g} Hz in {{leads}} (up to {{largest:.0f}} uV); switch the recorder's mains "
        "filter on, or record again away from the mains"
    )
    return [HUM.worst_lead(hum[worst], message, UV_PER_MV)]


def _amplitude(values: Floats, rate: float, mains: float) -> float:
    """Amplitude (mV) of the hum of one lead."""
    n = min(len(values), round(SEGMENT * rate))
    pieces = values[: len(values) // n * n].reshape(-1, n)
    window = np.hanning(n)
    spectrum = np.zeros(n // 2 + 1)
    for piece in pieces:  # one at a time, to keep memory small
        spectrum += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2
    # of a sine of amplitude A, the power summed over its line is A^2 n sum(window^2) / 4
    spectrum *= 4 / (n * float((window**2).sum()) * len(pieces))
    frequency = np.fft.rfftfreq(n, 1 / rate)
    power = 0.0
    for harmonic in HARMONICS:
        distance = np.abs(frequency - harmonic * mains)
        line = distance <= LINE_WIDTH
        beside = (distance > LINE_WIDTH) & (distance <= NEIGHBOURS)
        if harmonic * mains + NEIGHBOURS < rate / 2:
            excess = spectrum[line].sum() - line.sum() * float(np.median(spectrum[beside]))
            power += max(excess, 0.0)
    return float(np.sqrt(power))


def check_wander(recording: Recording) -> list[Finding]:
    """Find leads whose baseline wanders.

    Returns
    -------
    list of Finding
        The largest peak-to-peak amplitude (mV) of a lead below 0.5 Hz.
    """
    rate = recording.sampling_rate
    wander = {lead: _slow_range(values, rate) for lead, values in measured(recording).items()}
    message = (
        "the baseline of {leads} wanders (up to {largest:.2f} mV peak to peak); look at the beats, "
        "or record again at rest"
    )
    return [WANDER.worst_lead(wander, message)]


def _slow_range(values: Floats, rate: float) -> float:
    """Peak-to-peak amplitude (mV) of one lead below `HIGHEST_WANDER`."""
    from scipy.signal import butter, sosfiltfilt

    x, coarse_rate = coarse(values, rate)
    low = butter(2, HIGHEST_WANDER, fs=coarse_rate, output="sos")
    pad = min(len(x) - 1, round(2 * coarse_rate / HIGHEST_WANDER))
    slow = sosfiltfilt(low, x - np.median(x), padtype="even", padlen=pad)
    below, above = np.percentile(slow, RANGE)
    return float(above - below)
