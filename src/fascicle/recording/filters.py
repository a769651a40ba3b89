"""Filters of recorders and users, which simulated ECGs pass too; the sampling rate of targets.

A filter is described by its gain alone. Its delay does not matter: a simulation is shifted
to where it fits best. High-passes are left out, since beats are detrended and shorter than what a
high-pass below 1 Hz changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction

import numpy as np

from fascicle.core.arrays import Floats

SAMPLING_STEP = 1.0  # ms; targets and simulated ECGs share it
TARGET_RATE = 1000.0 / SAMPLING_STEP  # Hz
MAINS = (50.0, 60.0)  # Hz
DECIBELS = 10 / math.log(10)  # dB in one neper of power


class FilterKind(Enum):
    """Kind of a filter, by the frequencies that it removes."""

    LOW_PASS = "low-pass"
    NOTCH = "notch"

    @property
    def shape_name(self) -> str:
        """Name of the shape of such a filter: the order of a low-pass, the quality of a notch."""
        return "order" if self is FilterKind.LOW_PASS else "quality"

    @property
    def usual_shape(self) -> float:
        """Shape of a filter of this kind if none is stated.

        Electrocardiographs state where they are 3 dB down (ANSI/AAMI EC11, IEC 60601-2-25), not how
        steeply they fall from there; an analogue stage of second order is usual. The quality of a
        notch is its frequency over its width: 50 Hz +- 0.8 Hz.
        """
        return 2.0 if self is FilterKind.LOW_PASS else 30.0


class FilterOrigin(Enum):
    """Evidence that a recording has passed a filter."""

    FILE = "the recorder's, as the file says"
    STATED = "the recorder's, as the user says"
    ESTIMATED = "estimated from the spectrum of the recording"
    APPLIED = "applied by this program"


@dataclass(frozen=True)
class Filter:
    """A filter that a recording has passed."""

    kind: FilterKind
    frequency: float  # Hz; cut-off of a low-pass, middle of a notch
    origin: FilterOrigin  # how it is known
    shape: float  # order of a low-pass, which is a Butterworth filter; quality factor of a notch
    # Hz, at which a digital filter was run forward and backward; None: run once, as analogue
    sampling_rate: float | None = None

    def __post_init__(self) -> None:
        rate = self.sampling_rate
        digital_lowpass = rate is not None and self.kind is FilterKind.LOW_PASS
        if (
            not (0 < self.frequency < math.inf and 0 < self.shape < math.inf)
            or (rate is not None and not 2 * self.frequency < rate < math.inf)
            or (digital_lowpass and self.shape not in range(1, 11))
        ):
            raise ValueError(f"{self} at a sampling rate of {rate} Hz is impossible")

    def gain(self, frequency: Floats) -> Floats:
        """Factor (0 to 1) by which amplitudes at frequencies (k,), in Hz, are multiplied."""
        if (rate := self.sampling_rate) is not None:
            from scipy.signal import butter, freqz, freqz_sos, iirnotch

            if self.kind is FilterKind.LOW_PASS:
                sections = butter(round(self.shape), self.frequency, fs=rate, output="sos")
                response = freqz_sos(sections, worN=frequency, fs=rate)[1]
            else:
                coefficients = iirnotch(self.frequency, self.shape, fs=rate)
                response = freqz(*coefficients, worN=frequency, fs=rate)[1]
            return np.asarray(np.abs(response) ** 2)  # forward and backward
        ratio = np.asarray(frequency, dtype=np.float64) / self.frequency
        if self.kind is FilterKind.LOW_PASS:
            return np.asarray(np.exp(-attenuation(ratio, self.shape) / (2 * DECIBELS)))
        passed = np.abs(1 - ratio**2)
        return np.asarray(passed / np.hypot(passed, ratio / self.shape))

    def apply(self, signal: Floats) -> Floats:
        """Signal (n_leads, n) after this digital filter, without delay; NaN leads stay NaN."""
        from scipy.signal import butter, filtfilt, iirnotch, sosfiltfilt

        rate = self.sampling_rate
        if self.kind is FilterKind.LOW_PASS:
            sections = butter(round(self.shape), self.frequency, fs=rate, output="sos")
            return np.asarray(sosfiltfilt(sections, signal, axis=-1))
        return np.asarray(filtfilt(*iirnotch(self.frequency, self.shape, fs=rate), signal))

    def __str__(self) -> str:
        """Description, such as ``low-pass 40 Hz (order 2), applied by this program``."""
        shape = f"{self.kind.shape_name} {self.shape:.3g}"
        return f"{self.kind.value} {self.frequency:.3g} Hz ({shape}), {self.origin.value}"


def attenuation(ratio: Floats, order: float) -> Floats:
    """Attenuation (dB) by a Butterworth low-pass at frequencies of `ratio` times its cut-off.

    The formula is 10 log₁₀(1 + ratio²ⁿ), where the order n need not be whole.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(DECIBELS * np.logaddexp(0.0, 2 * order * np.log(ratio)))


def applied_filters(lowpass: float | None, mains: float | None) -> tuple[Filter, ...]:
    """Digital filters that the user asks for, at the sampling rate of targets.

    `lowpass` is the cut-off (Hz) of a low-pass, where it halves amplitudes, and `mains` the
    frequency (Hz) of the power-line interference that a notch removes.
    """
    # a low-pass of order 2, run forward and backward, has an order of 4 in effect
    frequencies = ((FilterKind.LOW_PASS, lowpass), (FilterKind.NOTCH, mains))
    return tuple(
        Filter(kind, frequency, FilterOrigin.APPLIED, kind.usual_shape, TARGET_RATE)
        for kind, frequency in frequencies
        if frequency is not None
    )


def resample(signal: Floats, sampling_rate: float) -> Floats:
    """Resample a signal (n_leads, n) from a rate (Hz) to one sample every `SAMPLING_STEP`.

    A polyphase filter does it; leads that are NaN throughout stay NaN.
    """
    from scipy.signal import resample_poly

    exact = Fraction(TARGET_RATE / sampling_rate)
    ratio = exact.limit_denominator(1000)
    if abs(ratio - exact) * signal.shape[1] * SAMPLING_STEP > 0.5:  # ms, at the last sample
        ratio = exact.limit_denominator(20_000)
    if ratio == 1:
        return signal.copy()
    return np.asarray(resample_poly(signal, *ratio.as_integer_ratio(), axis=-1, padtype="line"))


def coarse(signal: Floats, rate: float) -> tuple[Floats, float]:
    """Block means (mV) of a signal (..., n), and their rate (Hz), not below 250 Hz."""
    factor = max(int(rate / 250.0), 1)
    return block_means(signal, factor), rate / factor


def block_means(signal: Floats, factor: int) -> Floats:
    """Means of each `factor` successive samples, (..., n) to (..., n // factor)."""
    length = signal.shape[-1] // factor * factor
    return np.asarray(signal[..., :length].reshape(*signal.shape[:-1], -1, factor).mean(axis=-1))
