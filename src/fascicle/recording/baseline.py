"""The isoelectric level, read in the still PR segment of every beat."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.recording.window import spatial_velocity

KNOT = 20  # samples; one period of 50 Hz mains, so that hum averages out
EARLIEST = 60  # samples before the QRS; further back is the P wave
LATEST = 5  # samples before the QRS; nearer, its first slope is smoothed in
FARTHEST = 2500  # samples; between isoelectric points farther apart, drift is no straight line


def quiet_start(mean: Floats, onset: int, step: float) -> int:
    """First sample of the stillest `KNOT` samples just before the QRS.

    Parameters
    ----------
    mean : (12, n) array
        Mean beat (mV).
    onset : int
        First sample of the QRS.
    step : float
        Sampling step (ms).
    """
    earliest = max(onset - EARLIEST, 0)
    velocity = spatial_velocity(mean, step)[earliest : max(onset - LATEST, earliest + KNOT)]
    speed = np.convolve(velocity, np.full(KNOT, 1 / KNOT), mode="valid")
    return int(earliest + np.argmin(speed))


def subtract_drift(signal: Floats, knots: Integers, peaks: Integers, before: int, n: int) -> Floats:
    """Beats with a straight line removed from each lead.

    The line of a beat runs through the isoelectric level before its QRS and that before the QRS of
    its nearest neighbour; both points are of one kind, and neither T nor U waves enter. Where no
    neighbour is near, as for a single beat, the level alone is removed.

    Parameters
    ----------
    signal : (12, n_samples) array
        Potential (mV).
    knots : (n_beats,) array
        First sample of the isoelectric stretch of each beat, increasing.
    peaks : (n_beats,) array
        R peaks.
    before, n : int
        Samples before the peak, and in all, of the window.

    Returns
    -------
    (n_beats, 12, n) array
        Potential (mV), zero on average over each isoelectric stretch.
    """
    level = np.stack([signal[:, max(k, 0) : k + KNOT].mean(axis=1) for k in knots])
    beats = np.empty((len(peaks), signal.shape[0], n))
    for i, (peak, knot) in enumerate(zip(peaks, knots, strict=True)):
        start = peak - before
        since = np.arange(start, start + n) - (knot + (KNOT - 1) / 2)
        slope = _slope(level, knots, i)
        beats[i] = signal[:, start : start + n] - level[i][:, None] - slope[:, None] * since
    return beats


def _slope(level: Floats, knots: Integers, beat: int) -> Floats:
    """Drift (mV per sample) of each lead from a beat to its nearest neighbour."""
    neighbours = [k for k in (beat + 1, beat - 1) if 0 <= k < len(knots)]
    near = min(neighbours, key=lambda k: abs(int(knots[k] - knots[beat])), default=beat)
    distance = int(knots[near] - knots[beat])
    if not 0 < abs(distance) <= FARTHEST:
        return np.zeros(level.shape[1])
    return np.asarray((level[near] - level[beat]) / distance)
