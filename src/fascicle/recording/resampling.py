"""Recordings at the sampling rate of targets, and zero-phase filters that a user may ask for."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.recording.target import SAMPLING_STEP

TARGET_RATE = 1000.0 / SAMPLING_STEP  # Hz
SIMPLE, FINEST = 1000, 20_000  # largest denominators of the ratio of the two rates
LARGEST_DRIFT = 0.5  # ms by which the last sample may be off, before the finer ratio is taken
MAINS = (50.0, 60.0)  # Hz
FILTER_ORDER = 2  # run forward and backward: 4 in effect, without a shift in time
NOTCH_QUALITY = 30.0  # of the notch filter: 50 Hz +- 0.8 Hz


def resample(signal: Floats, sampling_rate: float) -> Floats:
    """Signal at `sampling_rate` Hz to one sample every `SAMPLING_STEP`, by a polyphase filter.

    Parameters
    ----------
    signal : (n_leads, n) array
        Potential (mV); leads that are NaN throughout stay so.
    sampling_rate : float
        Samples per second (Hz).
    """
    from scipy.signal import resample_poly

    exact = Fraction(TARGET_RATE / sampling_rate)
    ratio = exact.limit_denominator(SIMPLE)
    if abs(ratio - exact) * signal.shape[1] * SAMPLING_STEP > LARGEST_DRIFT:
        ratio = exact.limit_denominator(FINEST)
    if ratio == 1:
        return signal.copy()
    up, down = ratio.numerator, ratio.denominator
    return np.asarray(resample_poly(signal, up, down, axis=-1, padtype="line"))


def block_means(signal: Floats, factor: int) -> Floats:
    """Means of each `factor` successive samples, (..., n) to (..., n // factor)."""
    whole = signal.shape[-1] // factor * factor
    return np.asarray(signal[..., :whole].reshape(*signal.shape[:-1], -1, factor).mean(axis=-1))


def filtered(signal: Floats, lowpass_cutoff: float | None, mains: float | None) -> Floats:
    """Signal with the filters that a user may ask for, without delay.

    Parameters
    ----------
    signal : (n_leads, n) array
        Potential (mV) every `SAMPLING_STEP`; leads that are NaN throughout stay so.
    lowpass_cutoff : float, optional
        Frequency (Hz) at which a low-pass halves amplitudes.
    mains : float, optional
        Frequency (Hz) of the hum that a notch filter removes.
    """
    if lowpass_cutoff is not None:
        signal = _lowpass(signal, lowpass_cutoff)
    return signal if mains is None else _notch(signal, mains)


def _lowpass(signal: Floats, cutoff: float) -> Floats:
    """Butterworth low-pass, forward and backward."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(FILTER_ORDER, cutoff, fs=TARGET_RATE, output="sos")
    return np.asarray(sosfiltfilt(sections, signal, axis=-1))


def _notch(signal: Floats, frequency: float) -> Floats:
    from scipy.signal import filtfilt, iirnotch

    b, a = iirnotch(frequency, NOTCH_QUALITY, fs=TARGET_RATE)
    return np.asarray(filtfilt(b, a, signal, axis=-1))
