"""R peaks, from the slopes of all leads together."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS, LIMB_LEADS
from fascicle.recording.resampling import block_means
from fascicle.recording.t_waves import t_waves

BASELINE_WIDTH = 0.2  # s; standard deviation of the Gaussian that is taken as baseline

WORKING_RATE = 250.0  # Hz; enough for a band that ends at 15 Hz
BAND = (5.0, 15.0)  # Hz; of Pan and Tompkins
STRETCH = 2.0  # s; nearly always holds a beat
LARGEST_SLOPE = 2.0  # of the lead's usual QRS; what is steeper counts no more
TRIMMED = 0.25  # share of the leads, the most excited at each instant, that are left out
MERGING = 0.035  # s; standard deviation of the Gaussian that makes one hump of one QRS
REFRACTORY = 0.24  # s; no two beats follow each other faster
# Of the way from the level between beats to that of beats; slow ectopic beats need it low.
THRESHOLD = 0.2
ROUNDS = 5  # in which the threshold settles
DISAGREEING = 0.5  # of the best lead's agreement with the others; below it a lead is not used
REACH = 0.1  # s; from the steepest part of a QRS to its R peak
NOTCH = 0.012  # s; smoothing that merges the notches of one QRS


def magnitude(signal: Floats) -> Floats:
    """Root mean square over the independent leads that are there, (12, n) mV to (n,) mV."""
    return np.asarray(np.sqrt(np.mean(signal[complete_leads(signal)] ** 2, axis=0)))


def complete_leads(signal: Floats) -> list[int]:
    """Rows to average over: the independent leads, or all when I or II is not there.

    Without I or II no two of the other limb leads see the whole frontal plane equally, so a mean
    takes them all; `fascicle.core.leads.independent_rows` never takes more than two. Leads of the
    signal (12, n) that hold a NaN are not there.

    Raises
    ------
    ValueError
        When every lead holds a NaN.
    """
    there = [row for row in range(len(LEADS)) if bool(np.isfinite(signal[row]).all())]
    if not there:
        raise ValueError("no lead is complete; cut the signal to where leads were recorded")
    if {0, 1} <= set(there) or not set(there) & set(range(len(LIMB_LEADS))):
        return [row for row in there if row in INDEPENDENT_ROWS]
    return there


def r_peaks(signal: Floats, sampling_rate: float) -> Integers:
    r"""R peaks of a recording.

    As Pan and Tompkins (IEEE Trans. Biomed. Eng. 32:230, 1985) do for one lead: a band-pass, the
    slope, its mean over about a QRS, and a threshold a fifth of the way from the level between
    the beats to that of the beats; T waves above it are told by their steepness and what follows
    (`fascicle.recording.t_waves`). Three things differ, because all leads and all beats are there
    from the beginning. The slopes of the leads, each in units of its usual QRS and limited, are
    averaged, weighted by how well they agree with the other leads, without the quarter of the leads
    that moves most at that instant: a bad electrode neither makes beats nor hides them. The highest
    slope within the refractory period decides, not the first. And both levels are medians over the
    whole recording. Each beat then moves to the top of the smoothed root mean square of the leads
    that agree, which is the same point of every beat of one shape to within a few ms.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV), without pacing spikes; rows with NaN are left out.
    sampling_rate : float
        Samples per second (Hz), at least 250.

    Returns
    -------
    (n_beats,) array
        Sample of each R peak, to within 2 ms, increasing; empty when there is none.

    Raises
    ------
    ValueError
        When every lead holds a NaN.
    """
    factor = max(round(sampling_rate / WORKING_RATE), 1)
    rate = sampling_rate / factor
    leads = np.stack([block_means(signal[row], factor) for row in complete_leads(signal)])
    slopes = _usual_slopes(leads, rate)
    moving = slopes.any(axis=1)
    if not moving.any():
        return np.empty(0, dtype=np.int64)
    weights = _agreement(slopes[moving], rate)
    weighted = weights[:, None] * slopes[moving]
    kept = len(weighted) - int(TRIMMED * len(weighted))
    slope = np.partition(weighted, kept - 1, axis=0)[:kept].mean(axis=0)
    level = leads[moving][weights >= DISAGREEING * weights.max()]
    marks = _beats(slope, level, rate)
    level = level - gaussian_filter1d(level, BASELINE_WIDTH * rate, axis=-1, mode="nearest")
    peaks = _tops(np.sqrt(np.mean(level**2, axis=0)), marks, rate)
    return np.asarray(peaks * factor + factor // 2, dtype=np.int64)


def _usual_slopes(leads: Floats, rate: float) -> Floats:
    """Steepness of each lead in units of its usual QRS, limited; zero for flat leads."""
    from scipy.signal import butter, sosfiltfilt

    band = butter(1, BAND, "bandpass", fs=rate, output="sos")
    steep = np.abs(np.gradient(sosfiltfilt(band, leads, axis=-1), axis=-1))
    usual = _usual_height(steep, rate)
    scale = np.where(usual > 0, usual, np.inf)[:, None]
    return np.asarray(np.minimum(steep / scale, LARGEST_SLOPE))


def _usual_height(x: Floats, rate: float) -> Floats:
    """Median over stretches, each long enough for a beat, of the largest value of x (..., n)."""
    width = min(round(STRETCH * rate), x.shape[-1])
    starts = range(0, x.shape[-1] - width + 1, max(width // 2, 1))
    return np.asarray(
        np.median([x[..., start : start + width].max(axis=-1) for start in starts], axis=0)
    )


def _agreement(slopes: Floats, rate: float) -> Floats:
    """Squared correlation of each lead's slope with the median over the leads, (k,)."""
    if len(slopes) < 3:
        return np.ones(len(slopes))
    merged = _merged(slopes, rate)
    centred = merged - merged.mean(axis=1, keepdims=True)
    typical = np.median(merged, axis=0)
    typical -= typical.mean()
    scale = np.linalg.norm(centred, axis=1) * np.linalg.norm(typical)
    correlation = centred @ typical / np.maximum(scale, np.finfo(float).tiny)
    return np.asarray(np.maximum(correlation, 0) ** 2)


def _merged(slopes: Floats, rate: float) -> Floats:
    return np.asarray(gaussian_filter1d(slopes, MERGING * rate, axis=-1, mode="constant"))


def _beats(slope: Floats, leads: Floats, rate: float) -> Integers:
    """Samples about which all leads are steep, without those of T waves."""
    from scipy.signal import find_peaks

    merged = _merged(slope, rate)
    # A beat at the very end of the recording has its top there.
    found = find_peaks(np.pad(merged, 1), distance=REFRACTORY * rate)[0] - 1
    usual = float(_usual_height(merged, rate)) / 2
    beats = _high(merged, found, usual)
    # T waves among the beats lower the threshold, so it settles again without them.
    return _high(merged, np.setdiff1d(found, t_waves(beats, leads, rate)), usual)


def _high(merged: Floats, found: Integers, usual: float) -> Integers:
    """Those of the humps that pass the threshold between the levels between beats and of beats."""
    height = merged[found]
    between = np.median(merged)
    beat = height > usual
    for _ in range(ROUNDS):
        beat = height > between + THRESHOLD * (np.median(height[beat]) - between)
    return np.asarray(found[beat])


def _tops(height: Floats, marks: Integers, rate: float) -> Integers:
    """Sample at which the smoothed height is largest around each mark."""
    smooth = gaussian_filter1d(height, NOTCH * rate)
    reach = round(REACH * rate)
    first = np.maximum(marks - reach, 0)
    tops = [
        start + int(np.argmax(smooth[start : mark + reach]))
        for start, mark in zip(first, marks, strict=True)
    ]
    return np.unique(np.array(tops, dtype=np.int64))
