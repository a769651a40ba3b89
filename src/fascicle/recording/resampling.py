"""Recordings at the sampling rate of targets, and zero-phase filters that a user may ask for."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.recording.filters import applied_filters, apply

SAMPLING_STEP = 1.0  # ms; targets and simulated ECGs share it
TARGET_RATE = 1000.0 / SAMPLING_STEP  # Hz
SIMPLE, FINEST = 1000, 20_000  # largest denominators of the ratio of the two rates
LARGEST_DRIFT = 0.5  # ms by which the last sample may be off, before the finer ratio is taken
MAINS = (50.0, 60.0)  # Hz


def resample(signal: Floats, sampling_rate: float) -> Floats:
    """Signal (n_leads, n) at a rate (Hz), to one sample every `SAMPLING_STEP`.

    By a polyphase filter; leads that are NaN throughout stay so.
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
    return apply(applied_filters(lowpass_cutoff, mains, TARGET_RATE), signal)
