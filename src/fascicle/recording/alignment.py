"""Beats cut out of a recording, laid on top of each other, and the odd ones left out."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.target import SAMPLING_STEP

TARGET_RATE = 1000.0 / SAMPLING_STEP  # Hz
HALF_WIDTH = 100  # samples each side of R that are compared
LARGEST_SHIFT = 20  # samples
ROUNDS = 3
SIMILAR = 0.9  # correlation with the template
SPREADS = 3.0  # robust standard deviations below the median correlation
AMPLITUDE_RANGE = (0.6, 1.6)  # of the median amplitude


def resample(signal: NDArray[np.float64], sampling_rate: float) -> NDArray[np.float64]:
    """Signal (12, n) at `sampling_rate` Hz to one sample every `SAMPLING_STEP`."""
    from scipy.signal import resample_poly

    ratio = Fraction(TARGET_RATE / sampling_rate).limit_denominator(1000)
    if ratio == 1:
        return signal
    up, down = ratio.numerator, ratio.denominator
    return np.asarray(resample_poly(signal, up, down, axis=-1, padtype="line"))


def cut(
    signal: NDArray[np.float64], peaks: NDArray[np.int64], before: int, after: int
) -> NDArray[np.float64]:
    """Windows of `before` to `after` samples around each peak, shape (n_beats, 12, n_time)."""
    return np.stack([signal[:, peak - before : peak + after + 1] for peak in peaks])


def complete(
    peaks: NDArray[np.int64], n_samples: int, before: int, after: int
) -> NDArray[np.int64]:
    """Keep the peaks around which the whole window is recorded."""
    return peaks[(peaks >= before) & (peaks + after < n_samples)]


def correlations(beats: NDArray[np.float64], template: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlation of each beat (n_beats, 12, n_time), all leads together, with one (12, n_time)."""
    x = _centred(beats).reshape(len(beats), -1)
    y = _centred(template).ravel()
    scale = np.linalg.norm(x, axis=1) * np.linalg.norm(y)
    return np.asarray(x @ y / np.maximum(scale, np.finfo(float).tiny))


def align(signal: NDArray[np.float64], peaks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Move each peak to where its beat correlates best with the typical beat.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV) every `SAMPLING_STEP`.
    peaks : (n_beats,) array
        First guess, each at least ``HALF_WIDTH + LARGEST_SHIFT`` samples from the ends.

    Returns
    -------
    (n_beats,) array
        Each within `LARGEST_SHIFT` samples of the first guess.
    """
    margin = HALF_WIDTH + LARGEST_SHIFT
    wide = cut(signal, peaks, margin, margin)
    tries = np.lib.stride_tricks.sliding_window_view(wide, 2 * HALF_WIDTH + 1, axis=-1)
    shift = np.zeros(len(peaks), dtype=np.int64)
    for _ in range(ROUNDS):
        current = cut(signal, peaks + shift, HALF_WIDTH, HALF_WIDTH)
        template = _centred(typical_beat(current))
        score = np.einsum("bcst,ct->bs", tries, template)
        shift = np.argmax(score, axis=1) - LARGEST_SHIFT
    return np.asarray(peaks + shift)


def typical_beat(beats: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median (12, n_time) of the beats that resemble the most central one.

    The central beat is the one whose correlations with the others have the highest median, so that
    ectopic beats do not enter while they are fewer than half.
    """
    x = _centred(beats).reshape(len(beats), -1)
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), np.finfo(float).tiny)
    central = x @ x[int(np.argmax(np.median(x @ x.T, axis=1)))]
    alike = central >= min(SIMILAR, float(np.median(central)))
    return np.asarray(np.median(beats[alike], axis=0))


def regular(beats: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which beats, shape (n_beats, 12, n_time), have the typical shape and height."""
    template = typical_beat(beats)
    similarity = correlations(beats, template)
    middle = float(np.median(similarity))
    spread = 1.4826 * float(np.median(np.abs(similarity - middle)))
    height = _centred(beats).std(axis=(1, 2)) / np.maximum(_centred(template).std(), 1e-12)
    low, high = AMPLITUDE_RANGE
    alike = similarity >= min(SIMILAR, middle - SPREADS * spread)
    return np.asarray(alike & (height > low) & (height < high))


def _centred(beats: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(beats - np.median(beats, axis=-1, keepdims=True))
