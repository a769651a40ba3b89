"""Pacing spikes: where they are, and the signal without them."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from fascicle.core.arrays import Floats, Integers


def find_spikes(signal: Floats, sampling_rate: float) -> Integers:
    r"""Pacing spikes of a recording.

    The prominence of a sample in one lead is how far it lies above (or below) both the samples 5 ms
    before and after it; steps of an electrode have none. A spike is a sample that is prominent in
    several leads at once, more than anything around it, between stretches that do not move: a
    narrow R wave goes on falling on both sides. Where noise hides some of the spikes, the others
    show what to look for. A simpler rule than that of Helfenbein et al. (J. Electrocardiol. 35
    Suppl:95, 2002).

    Of a signal (12, n), mV, at a rate of at least 250 Hz, NaN where a lead was not recorded: first
    sample of each spike and the one after its last, (k, 2), increasing.
    """
    width = round(0.05 * sampling_rate)  # s each side in which a spike must stand out
    reach = max(math.ceil(0.005 * sampling_rate), 2)  # s; a smeared pulse has ended by then
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
        prominent[at] += height > np.maximum(3.0 * np.sqrt(surroundings), 0.05)  # mV
        best[at] = np.maximum(best[at], height)
        prominence[at] += height**2
        movement[at] += _movement(lead[at], reach) ** 2
    enough = prominent >= np.maximum(there / 3, 2)  # leads
    surroundings = _around(prominence, reach, width)
    spike = (best > 0.2) & (prominence > 2.5**2 * movement)  # mV
    spike &= prominence > 3.0**2 * surroundings
    prominence = np.where(spike, prominence, 0)
    # Next to a spike the other side of its slope is prominent, too, but less.
    tops = find_peaks(np.pad(prominence, 1), distance=2 * reach + 1)[0] - 1
    without_best = prominence[tops] - best[tops] ** 2  # nothing is left of one lead's artefact
    clear = enough[tops] & (without_best > 6.0**2 * surroundings[tops])
    # Faint spikes have the pattern over the leads of a clear one, of either sign.
    patterns = _pattern(signal, tops, reach)
    alike = (np.abs(patterns.T @ patterns[:, clear]) > 0.95).any(axis=1)
    return _extents(signal, tops[clear | alike], reach)


def remove_spikes(signal: Floats, spikes: Integers) -> Floats:
    """Signal (12, n) with a straight line across each spike (k, 2), in every lead there."""
    without = signal.copy()
    last = signal.shape[1] - 1
    for first, stop in spikes:
        before, after = max(int(first) - 1, 0), min(int(stop), last)
        share = np.linspace(0, 1, after - before + 1)
        ends = without[:, [before, after]]
        line = ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])
        piece = without[:, before : after + 1]
        piece[:] = np.where(np.isfinite(line), line, piece)
    return without


def _offset(lead: Floats, by: int) -> Floats:
    """Value `by` samples later; the ends of the recording go on for ever."""
    return np.asarray(lead[np.clip(np.arange(len(lead)) + by, 0, len(lead) - 1)])


def _prominence(lead: Floats, reach: int) -> Floats:
    """How far each sample lies beyond both samples `reach` away, on one side of them (mV)."""
    before, after = lead - _offset(lead, -reach), lead - _offset(lead, reach)
    same_side = before * after > 0
    return np.where(same_side, np.minimum(np.abs(before), np.abs(after)), 0.0)


def _movement(lead: Floats, reach: int) -> Floats:
    """How far the signal moves next to each sample, from `reach` to two or three times that (mV).

    The less of both: the other distance may meet the spike of another chamber. A step counts too.
    """
    step = 1 / 8 * np.abs(_offset(lead, reach) - _offset(lead, -reach))
    near, far, farther = (
        (_offset(lead, -k * reach) + _offset(lead, k * reach)) / 2 for k in (1, 2, 3)
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
        inside = np.flatnonzero((away > 0.03).any(axis=0))  # mV
        spikes.append((before + int(inside[0]), before + int(inside[-1]) + 1))
    return np.array(spikes, dtype=np.int64).reshape(-1, 2)
