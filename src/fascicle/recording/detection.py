"""Detection of R peaks from the slopes of all leads, robust to T waves as high as a QRS."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS, LIMB_LEADS
from fascicle.recording.filters import block_means


def magnitude(signal: Floats) -> Floats:
    """Root mean square over the independent leads that were recorded, (12, n) mV to (n,) mV."""
    return np.asarray(np.sqrt(np.mean(signal[complete_leads(signal)] ** 2, axis=0)))


def complete_leads(signal: Floats) -> list[int]:
    """Rows to average over: the independent leads, or all when I or II is missing.

    Without I or II no two of the other limb leads see the whole frontal plane equally, so a mean
    takes them all; `fascicle.core.leads.independent_rows` never takes more than two. Leads of the
    signal (12, n) that hold a NaN count as missing; ValueError when all do. Rows after the twelfth,
    of additional leads, are ignored.
    """
    complete = [row for row in range(len(LEADS)) if bool(np.isfinite(signal[row]).all())]
    if not complete:
        raise ValueError("no lead is complete; cut the signal to where leads were recorded")
    if {0, 1} <= set(complete) or not set(complete) & set(range(len(LIMB_LEADS))):
        return [row for row in complete if row in INDEPENDENT_ROWS]
    return complete


def r_peaks(signal: Floats, sampling_rate: float) -> Integers:
    r"""R peaks of a recording.

    As Pan and Tompkins (IEEE Trans. Biomed. Eng. 32:230, 1985) do for one lead: a band-pass, the
    slope, its mean over about a QRS, and a threshold a fifth of the way from the level between
    the beats to that of the beats; T waves above it are recognised by their slope and what follows.
    Here the slopes of the leads, each in units of its usual QRS and limited, are averaged, weighted
    by how well they agree with the others, without the quarter that is steepest at that instant: a
    bad electrode neither adds nor hides beats. The highest slope within the refractory period
    decides, and both levels are medians over the whole recording. Each beat then moves to the top
    of the smoothed root mean square of the leads that agree.

    The signal (12, n), mV, has no pacing spikes and a rate of at least 250 Hz; rows with NaN are
    left out. Returned is the sample of each R peak, to within 2 ms, (n_beats,), increasing.
    """
    from scipy.signal import butter, sosfiltfilt

    factor = max(round(sampling_rate / 250.0), 1)  # Hz; enough for a band that ends at 15 Hz
    rate = sampling_rate / factor
    leads = np.stack([block_means(signal[row], factor) for row in complete_leads(signal)])
    # steepness of each lead in units of its usual QRS, at most 2; zero for flat leads
    band = butter(1, (5.0, 15.0), "bandpass", fs=rate, output="sos")  # Hz; Pan and Tompkins
    steep = np.abs(np.gradient(sosfiltfilt(band, leads, axis=-1), axis=-1))
    usual = _usual_height(steep, rate)
    slopes = np.minimum(steep / np.where(usual > 0, usual, np.inf)[:, None], 2.0)
    moving = slopes.any(axis=1)
    if not moving.any():
        return np.empty(0, dtype=np.int64)
    weights = _agreement(slopes[moving], rate)
    weighted = weights[:, None] * slopes[moving]
    kept = len(weighted) - int(0.25 * len(weighted))
    slope = np.partition(weighted, kept - 1, axis=0)[:kept].mean(axis=0)
    level = leads[moving][weights >= 0.5 * weights.max()]
    marks = _beats(slope, level, rate)
    baseline = gaussian_filter1d(level, 0.2 * rate, axis=-1, mode="nearest")  # s
    height = np.sqrt(np.mean((level - baseline) ** 2, axis=0))
    smooth = gaussian_filter1d(height, 0.012 * rate)  # merges the notches of one QRS
    reach = round(0.1 * rate)
    tops = [
        start + int(np.argmax(smooth[start : mark + reach]))
        for start, mark in zip(np.maximum(marks - reach, 0), marks, strict=True)
    ]
    return np.unique(np.array(tops, dtype=np.int64)) * factor + factor // 2


def _usual_height(x: Floats, rate: float) -> Floats:
    """Median over stretches of 2 s, which nearly always hold a beat, of the largest x (..., n)."""
    width = min(round(2.0 * rate), x.shape[-1])
    starts = range(0, x.shape[-1] - width + 1, max(width // 2, 1))
    largest = [x[..., start : start + width].max(axis=-1) for start in starts]
    return np.asarray(np.median(largest, axis=0))


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
    """Slopes (..., n) smoothed so that one QRS has one maximum."""
    return np.asarray(gaussian_filter1d(slopes, 0.035 * rate, axis=-1, mode="constant"))


def _beats(slope: Floats, leads: Floats, rate: float) -> Integers:
    """Samples around which the leads are steep, except those of T waves."""
    from scipy.signal import find_peaks

    merged = _merged(slope, rate)
    # Padded, since a beat at the very end has its top there. No two beats are nearer to each other.
    humps = find_peaks(np.pad(merged, 1), distance=0.24 * rate)[0] - 1
    usual = float(_usual_height(merged, rate)) / 2
    beats = _high(merged, humps, usual)
    # T waves among the beats lower the threshold, so it settles again without them.
    return _high(merged, np.setdiff1d(humps, _t_waves(beats, leads, rate)), usual)


def _high(merged: Floats, humps: Integers, usual: float) -> Integers:
    """Humps above a threshold, a fifth of the way from the level between beats to that of beats."""
    height = merged[humps]
    between = np.median(merged)
    beat = height > usual
    for _ in range(5):  # the threshold settles; slow ectopic beats need it low
        beat = height > between + 0.2 * (np.median(height[beat]) - between)
    return np.asarray(humps[beat])


def _t_waves(beats: Integers, leads: Floats, rate: float) -> Integers:
    """Beats (samples), of those in `beats` (n_beats,), that are the T wave of the beat before.

    A T wave comes soon after a beat and is less steep (Pan and Tompkins); that it is slow for its
    height and followed by no wave keeps early ectopic beats, which have a T wave of their own.
    """
    slope = gaussian_filter1d(leads, 0.005 * rate, axis=-1, order=1)
    slope = np.sqrt(np.mean(slope**2, axis=0))
    reach = round(0.08 * rate)
    steepness = [float(slope[max(beat - reach, 0) : beat + reach + 1].max()) for beat in beats]
    wave = gaussian_filter1d(leads, 0.02 * rate, axis=-1)
    nexts = [*(beats[1:] - 0.1 * rate), leads.shape[1]]
    t_waves = []
    before = 0
    for k in range(1, len(beats)):
        height = _height(wave, beats[k] - 0.1 * rate, beats[k] + 0.1 * rate)
        following = beats[k] + 0.14 * rate, min(beats[k] + 0.4 * rate, nexts[k])  # its own T wave
        if (
            beats[k] - beats[before] < 0.36 * rate
            and steepness[k] < 0.7 * steepness[before]
            # height over steepness (s): up to 0.048 of few ectopic beats
            and height > 0.046 * rate * steepness[k]
            and following[1] - following[0] >= 0.06 * rate  # less is too short to judge
            # a P wave is lower, the T wave of most beats higher
            and _height(wave, *following) < 0.25 * height
        ):
            t_waves.append(beats[k])
        else:
            before = k
    return np.array(t_waves, dtype=np.int64)


def _height(wave: Floats, start: float, stop: float) -> float:
    """Root mean square over the leads of the peak-to-peak potential between two samples (mV)."""
    spans = np.ptp(wave[:, max(round(start), 0) : round(stop) + 1], axis=1)
    return float(np.sqrt(np.mean(spans**2)))
