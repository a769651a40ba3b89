"""Pacing spikes: where they are, and the signal without them."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from fascicle.core.arrays import Floats, Integers

HALF_WIDTH = 0.005  # s; a pacing pulse, smeared by the recorder, has ended this long after its top
AROUND = 0.05  # s each side in which a spike must stand out
STANDING_OUT = 6.0  # times the root mean square prominence around, all leads together
FAINT = 3.0  # the same for a spike that has the pattern over the leads of one that stands out
ALIKE = 0.95  # correlation of two such patterns
NOTICEABLE = 3.0  # times the same of one lead, for the lead to count
LEAST, LEAST_OF_BEST = 0.05, 0.2  # mV; prominence of a spike in a lead, and in the best one
STILLNESS = 2.5  # by which a spike rises above how far the signal moves next to it
SLOPE_SHARE = 1 / 8  # of the difference between both sides that counts as movement, against steps
SHARE = 3  # one in this many leads shows a spike, at least two
TRACE = 0.03  # mV; what is left of a spike where it begins and ends


def find_spikes(signal: Floats, sampling_rate: float) -> Integers:
    r"""Pacing spikes of a recording.

    The prominence of a sample in one lead is how far it lies above (or below) both the samples
    `HALF_WIDTH` before and after it, whichever is nearer; steps of an electrode have none. A spike
    is a sample that is prominent in several leads at once, more than anything around it, between
    stretches that are still: a narrow R wave is prominent too, but it goes on falling on both
    sides, a spike ends. Where noise hides some of the spikes, the others show what to look for.
    That pulses can be found in software, by their steepness and short
    duration in several leads, is shown by Helfenbein et al. (J. Electrocardiol. 35 Suppl:95,
    2002); the rule used here is simpler.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV) as it was recorded; NaN where a lead was not.
    sampling_rate : float
        Samples per second (Hz), at least 250. Filters of the recorder, which are stronger at low
        rates, make spikes smaller and wider.

    Returns
    -------
    (k, 2) array
        First sample of each spike and the one after its last, increasing.
    """
    width = round(AROUND * sampling_rate)
    reach = max(math.ceil(HALF_WIDTH * sampling_rate), 2)
    n = signal.shape[1]
    there, prominent = np.zeros((2, n), dtype=np.int64)
    best, prominence, movement = np.zeros((3, n))
    for lead in signal:
        finite = np.flatnonzero(np.isfinite(lead))
        if len(finite) == 0:
            continue
        at = slice(int(finite[0]), int(finite[-1]) + 1)
        height = _prominence(lead[at], reach)
        there[at] += 1
        surroundings = _around(height**2, reach, width)
        prominent[at] += height > np.maximum(NOTICEABLE * np.sqrt(surroundings), LEAST)
        best[at] = np.maximum(best[at], height)
        prominence[at] += height**2
        movement[at] += _movement(lead[at], reach) ** 2
    enough = prominent >= np.maximum(there / SHARE, 2)
    surroundings = _around(prominence, reach, width)
    spike = (best > LEAST_OF_BEST) & (prominence > STILLNESS**2 * movement)
    spike &= prominence > FAINT**2 * surroundings
    prominence = np.where(spike, prominence, 0)
    # Next to a spike the other side of its slope is prominent, too, but less.
    tops = find_peaks(np.pad(prominence, 1), distance=2 * reach + 1)[0] - 1
    without_best = prominence[tops] - best[tops] ** 2  # nothing is left of one lead's artefact
    clear = enough[tops] & (without_best > STANDING_OUT**2 * surroundings[tops])
    patterns = _pattern(signal, tops, reach)
    alike = (np.abs(patterns.T @ patterns[:, clear]) > ALIKE).any(axis=1)  # of either sign
    tops = tops[clear | alike]
    return _extents(signal, tops, reach)


def remove_spikes(signal: Floats, spikes: Integers) -> Floats:
    """Signal (12, n) with a straight line across each spike (k, 2), in every lead."""
    without = signal.copy()
    last = signal.shape[1] - 1
    for first, stop in spikes:
        before, after = max(int(first) - 1, 0), min(int(stop), last)
        share = np.linspace(0, 1, after - before + 1)
        ends = without[:, [before, after]]
        without[:, before : after + 1] = ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])
    return without


def _shifted(lead: Floats, by: int) -> Floats:
    """Value `by` samples later; the ends of the recording go on for ever."""
    return np.asarray(lead[np.clip(np.arange(len(lead)) + by, 0, len(lead) - 1)])


def _prominence(lead: Floats, reach: int) -> Floats:
    """How far each sample lies beyond both samples `reach` away, on one side of them (mV)."""
    before, after = lead - _shifted(lead, -reach), lead - _shifted(lead, reach)
    same_side = before * after > 0
    return np.where(same_side, np.minimum(np.abs(before), np.abs(after)), 0.0)


def _movement(lead: Floats, reach: int) -> Floats:
    """How far the signal moves next to each sample, from `reach` to two or three times that (mV).

    The less of both: the other distance may meet the spike of another chamber. A step counts too.
    """
    step = SLOPE_SHARE * np.abs(_shifted(lead, reach) - _shifted(lead, -reach))
    near, far, farther = (
        (_shifted(lead, -k * reach) + _shifted(lead, k * reach)) / 2 for k in (1, 2, 3)
    )
    return np.maximum(np.minimum(np.abs(near - far), np.abs(near - farther)), step)


def _around(power: Floats, reach: int, width: int) -> Floats:
    """Mean within `width` samples of each sample, the nearest two `reach` left out (mV²)."""
    outer, inner = 2 * width + 1, 4 * reach + 1
    wide, own = (uniform_filter1d(power, size, mode="nearest") * size for size in (outer, inner))
    return np.asarray(np.maximum(wide - own, 0) / (outer - inner))


def _pattern(signal: Floats, tops: Integers, reach: int) -> Floats:
    """Height of each lead at samples above the mean `reach` away, as unit vectors (12, k)."""
    before, after = np.clip([tops - reach, tops + reach], 0, signal.shape[1] - 1)
    height = np.nan_to_num(signal[:, tops] - (signal[:, before] + signal[:, after]) / 2)
    return np.asarray(height / np.maximum(np.linalg.norm(height, axis=0), np.finfo(float).tiny))


def _extents(signal: Floats, tops: Integers, reach: int) -> Integers:
    """First sample and the one after the last of each spike, from where any lead leaves a line."""
    spikes = []
    for top in tops:
        before, after = max(int(top) - reach, 0), min(int(top) + reach, signal.shape[1] - 1)
        piece = signal[:, before : after + 1]
        share = np.linspace(0, 1, after - before + 1)
        away = np.abs(piece - piece[:, :1] - share * (piece[:, -1:] - piece[:, :1]))
        inside = np.flatnonzero((away > TRACE).any(axis=0))
        spikes.append((before + int(inside[0]), before + int(inside[-1]) + 1))
    return np.array(spikes, dtype=np.int64).reshape(-1, 2)
