"""Hum of the mains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.quality.finding import Finding, warning_if
from fascicle.recording.quality.stretches import measured
from fascicle.recording.quality.wording import listed
from fascicle.recording.recording import Recording
from fascicle.recording.resampling import MAINS

HARMONICS = (1, 2, 3)
LARGEST_HUM = 0.025  # mV; amplitude, a quarter of a millimetre on paper
SEGMENT = 4.0  # s
LINE_WIDTH = 0.75  # Hz each side, which allows for mains that are not quite on their frequency
NEIGHBOURS = 4.0  # Hz each side of the line, whose power is that of the ECG there


def check_mains(recording: Recording) -> list[Finding]:
    """Find hum at 50 or 60 Hz and its harmonics.

    Returns
    -------
    list of Finding
        The largest amplitude (uV) in a lead: the power of the lines less that of the spectrum
        beside them (mean over `SEGMENT` s pieces), as amplitude of one sine.
    """
    hum = {
        (lead, mains): _amplitude(values, recording.sampling_rate, mains)
        for lead, values in measured(recording).items()
        for mains in MAINS
    }
    worst = max(hum, key=lambda key: hum[key])
    largest = hum[worst]
    humming = [lead for (lead, f), size in hum.items() if f == worst[1] and size > LARGEST_HUM]
    message = ""
    if humming:
        message = (
            f"hum at {worst[1]:g} Hz in {listed(humming)} (up to {1e3 * largest:.0f} uV); switch "
            "the recorder's mains filter on, or record again away from the mains"
        )
    return [warning_if(message, "mains hum", 1e3 * largest, "uV", 1e3 * LARGEST_HUM)]


def _amplitude(values: NDArray[np.float64], rate: float, mains: float) -> float:
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
