"""Filters that a recording has passed, so that a simulated ECG can pass them, too.

Only what they do to amplitudes is here. Their delay does not matter: a simulation is shifted to
where it fits best. High-passes are left out, since beats are detrended and shorter than what a
high-pass below 1 Hz changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from fascicle.core.arrays import Floats

APPLIED_ORDER = 2  # of a low-pass that is run forward and backward: 4 in effect
NOTCH_QUALITY = 30.0  # of a notch filter: 50 Hz +- 0.8 Hz
# Electrocardiographs state where they are 3 dB down (ANSI/AAMI EC11, IEC 60601-2-25), not how
# steeply they fall from there; an analogue stage of second order is usual.
RECORDER_ORDER = 2.0
DIGITAL_ORDERS = range(1, 11)  # of a digital low-pass, as designed
DECIBELS = 10 / math.log(10)  # in one neper of power


class FilterKind(Enum):
    """What a filter takes away."""

    LOW_PASS = "low-pass"
    NOTCH = "notch"


class FilterOrigin(Enum):
    """How it is known that a recording has passed a filter."""

    FILE = "the recorder's, as the file says"
    STATED = "the recorder's, as the user says"
    ESTIMATED = "estimated from the spectrum of the recording"
    APPLIED = "applied by this program"


@dataclass(frozen=True)
class Filter:
    """One filter.

    Attributes
    ----------
    kind : FilterKind
        Low-pass or notch.
    frequency : float
        Cut-off of a low-pass, middle of a notch (Hz).
    origin : FilterOrigin
        How it is known.
    shape : float
        Order of a low-pass, which is a Butterworth filter; quality factor of a notch.
    sampling_rate : float, optional
        Samples per second (Hz) at which a digital filter was run forward and backward; None for
        one that was run once, and is taken as analogue.

    Raises
    ------
    ValueError
        When there is no such filter.
    """

    kind: FilterKind
    frequency: float
    origin: FilterOrigin
    shape: float
    sampling_rate: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.frequency) and self.frequency > 0):
            raise ValueError(f"{self.kind.value} at {self.frequency} Hz")
        if not (math.isfinite(self.shape) and self.shape > 0):
            raise ValueError(f"{self.kind.value} of order or quality {self.shape}")
        if self.sampling_rate is None:
            return
        if not 2 * self.frequency < self.sampling_rate < math.inf:
            raise ValueError(f"{self.frequency} Hz in a signal of {self.sampling_rate} Hz")
        if self.kind is FilterKind.LOW_PASS and self.shape not in DIGITAL_ORDERS:
            raise ValueError(f"digital low-pass of order {self.shape}")

    def gain(self, frequency: Floats) -> Floats:
        """Factor by which amplitudes are multiplied.

        Parameters
        ----------
        frequency : (k,) array
            In Hz; of a digital filter at most half of its sampling rate.

        Returns
        -------
        (k,) array
            0 to 1.
        """
        if self.sampling_rate is not None:
            return self._digital_gain(frequency, self.sampling_rate)
        ratio = np.asarray(frequency, dtype=np.float64) / self.frequency
        if self.kind is FilterKind.LOW_PASS:
            return np.asarray(np.exp(-attenuation(ratio, self.shape) / (2 * DECIBELS)))
        passed = np.abs(1 - ratio**2)
        return np.asarray(passed / np.hypot(passed, ratio / self.shape))

    def _digital_gain(self, frequency: Floats, rate: float) -> Floats:
        from scipy.signal import freqz, freqz_sos

        if self.kind is FilterKind.LOW_PASS:
            sections = lowpass_sections(self.frequency, round(self.shape), rate)
            response = freqz_sos(sections, worN=frequency, fs=rate)[1]
        else:
            coefficients = notch_coefficients(self.frequency, self.shape, rate)
            response = freqz(*coefficients, worN=frequency, fs=rate)[1]
        return np.asarray(np.abs(response) ** 2)  # forward and backward

    def __str__(self) -> str:
        """Such as ``low-pass 40 Hz (order 2), applied by this program``."""
        name = "order" if self.kind is FilterKind.LOW_PASS else "quality"
        return (
            f"{self.kind.value} {self.frequency:.3g} Hz ({name} {self.shape:.3g}), "
            f"{self.origin.value}"
        )


def attenuation(ratio: Floats, order: float) -> Floats:
    """What a Butterworth low-pass takes away (dB) at frequencies of `ratio` times its cut-off.

    It is 10 log₁₀(1 + ratio²ⁿ), n the order, which need not be whole.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(DECIBELS * np.logaddexp(0.0, 2 * order * np.log(ratio)))


def lowpass_sections(cutoff: float, order: int, sampling_rate: float) -> Floats:
    """Second-order sections of a digital Butterworth low-pass, for one run of it.

    Parameters
    ----------
    cutoff, sampling_rate : float
        In Hz.
    order : int
        Of the filter.
    """
    from scipy.signal import butter

    return np.asarray(butter(order, cutoff, fs=sampling_rate, output="sos"))


def notch_coefficients(mains: float, quality: float, sampling_rate: float) -> tuple[Floats, Floats]:
    """Numerator and denominator of a digital notch filter, for one run of it.

    Parameters
    ----------
    mains, sampling_rate : float
        In Hz.
    quality : float
        `mains` over the width of the notch.
    """
    from scipy.signal import iirnotch

    numerator, denominator = iirnotch(mains, quality, fs=sampling_rate)
    return np.asarray(numerator), np.asarray(denominator)


def applied_filters(
    lowpass: float | None, mains: float | None, sampling_rate: float
) -> tuple[Filter, ...]:
    """The filters that a user may ask for, those that are wanted of them.

    Parameters
    ----------
    lowpass : float, optional
        Cut-off of the low-pass (Hz), where it halves amplitudes.
    mains : float, optional
        Frequency (Hz) of the hum that the notch removes.
    sampling_rate : float
        Samples per second (Hz) of what is filtered.
    """
    wanted = (
        (FilterKind.LOW_PASS, lowpass, float(APPLIED_ORDER)),
        (FilterKind.NOTCH, mains, NOTCH_QUALITY),
    )
    return tuple(
        Filter(kind, frequency, FilterOrigin.APPLIED, shape, sampling_rate)
        for kind, frequency, shape in wanted
        if frequency is not None
    )


def apply(filters: Sequence[Filter], signal: Floats) -> Floats:
    """Signal (n_leads, n) after digital filters without delay; leads that are NaN stay so."""
    from scipy.signal import filtfilt, sosfiltfilt

    for one in filters:
        if one.sampling_rate is None:
            raise ValueError(f"{one}: not a digital filter")
        if one.kind is FilterKind.LOW_PASS:
            sections = lowpass_sections(one.frequency, round(one.shape), one.sampling_rate)
            signal = np.asarray(sosfiltfilt(sections, signal, axis=-1))
        else:
            coefficients = notch_coefficients(one.frequency, one.shape, one.sampling_rate)
            signal = np.asarray(filtfilt(*coefficients, signal))
    return signal


def combined_gain(filters: Sequence[Filter], frequency: Floats) -> Floats:
    """Product of the gains of filters at frequencies (k,), in Hz."""
    gain = np.ones(len(frequency))
    for one in filters:
        gain = gain * one.gain(frequency)
    return gain
