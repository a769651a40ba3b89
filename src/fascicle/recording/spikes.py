"""Detection of pacing spikes, and their removal from the signal."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.leads import LEADS


def find_spikes(signal: Floats, sampling_rate: float) -> Integers:
    r"""Pacing spikes of a recording.

    The prominence of a sample in one lead is how far it lies above (or below) both the samples 5 ms
    before and after it; steps of an electrode have none. A candidate is a sample that is prominent
    in several leads at once, more than any sample around it, between flat stretches: a narrow R
    wave, in contrast, goes on falling on both sides. Spikes that noise hides are found by the
    pattern of the others. The rule is simpler than that of Helfenbein et al. (J. Electrocardiol.
    35 Suppl:95, 2002).

    Candidates of one pattern over the leads are spikes if their timing is that of a pacemaker: at a
    fixed rate, or each before a similar beat. Power-line interference, muscle activity and the ends
    of a recording have no such timing.

    The signal (12, n), mV, has a rate of at least 250 Hz, and is NaN where a lead was not recorded.
    Returned are the first sample of each spike and the one after its last, (k, 2), increasing.
    """
    reach = max(math.ceil(0.005 * sampling_rate), 2)  # s; a smeared pulse has ended by then
    n = signal.shape[1]
    recorded, prominent = np.zeros((2, n), dtype=np.int64)
    best, prominence, movement = np.zeros((3, n))
    for lead in signal:
        finite = np.flatnonzero(np.isfinite(lead))
        if len(finite) == 0:
            continue
        # at the ends of a lead, the samples on one side are unknown
        at = slice(int(finite[0]), int(finite[-1]) + 1)
        before, after = (lead[at] - _offset(lead[at], by) for by in (-reach, reach))
        beyond_both = before * after > 0
        height = np.where(beyond_both, np.minimum(np.abs(before), np.abs(after)), 0.0)
        height[: 3 * reach] = height[-3 * reach :] = 0.0
        recorded[at] += 1
        surroundings = _around(height**2, reach)
        prominent[at] += height > np.maximum(3.0 * np.sqrt(surroundings), 0.05)  # mV
        best[at] = np.maximum(best[at], height)
        prominence[at] += height**2
        movement[at] += _movement(lead[at], reach) ** 2
    enough = prominent >= np.maximum(recorded / 3, 2)  # leads
    surroundings = _around(prominence, reach)
    spike = (best > 0.1) & (prominence > 2.5**2 * movement)  # mV
    spike &= prominence > 3.0**2 * surroundings
    prominence = np.where(spike, prominence, 0)
    # Next to a spike the other side of its slope is prominent, too, but less.
    tops = find_peaks(np.pad(prominence, 1), distance=2 * reach)[0] - 1
    without_best = prominence[tops] - best[tops] ** 2  # 0 for an artefact in a single lead
    clear = enough[tops] & (without_best > 5.0**2 * surroundings[tops])
    # Faint spikes have the pattern over the leads of a clear one, of either sign.
    patterns = _pattern(signal, tops, reach)
    alike = np.abs(patterns.T @ patterns[:, clear]) > 0.95
    kept = clear | alike.any(axis=1)
    tops, patterns = tops[kept], patterns[:, kept]
    spikes = _extents(signal, tops, reach)
    # spikes that are accepted even where there are only one or two
    striking = (best[tops] > 0.2) & (prominence[tops] > 10.0**2 * surroundings[tops])  # mV
    without = remove_spikes(signal, spikes, sampling_rate)
    return spikes[_given_by_a_pacemaker(without, tops, patterns, striking, reach)]


def remove_spikes(signal: Floats, spikes: Integers, sampling_rate: float) -> Floats:
    """Signal (12 + k, n) with a straight line across each spike (m, 2), in every recorded lead.

    What rings after it, or a second spike within 5 ms, is taken out with it.
    """
    without, reach = signal.copy(), max(math.ceil(0.005 * sampling_rate), 2)  # s
    bends = _bends(signal[: len(LEADS)])  # additional leads decide nothing
    for (first, end), following in pairwise([*spikes.tolist(), [signal.shape[1]] * 2]):
        stop = max(end, min(_end_of_ringing(bends, end, reach), following[0]))
        before, after = max(first - 1, 0), min(stop, signal.shape[1] - 1)
        share = np.linspace(0, 1, after - before + 1)
        ends = without[:, [before, after]]
        line = ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])
        piece = without[:, before : after + 1]
        piece[:] = np.where(np.isfinite(line), line, piece)
    return without


def spike_tail(beat: Floats, end: int) -> Floats:
    r"""Exponential decay, :math:`a_i e^{-t/\tau}`, of electrode and amplifier after a pacing spike.

    All leads have one time constant. The decay is fitted to the longest stretch after the spike, 60
    to 7 ms, that it fits to within 15 uV and 30 %; it never fits a QRS, which grows.

    `beat` is a mean beat (12, n), mV every ms, without its spike, which ends at the sample `end`.
    The tail (12, n), mV, is zero where no exponential fits, and before the spike's end.
    """
    tail = np.zeros_like(beat)
    level = beat[:, max(end - 30, 0) : max(end - 10, 1)].mean(axis=1, keepdims=True)
    since = np.arange(beat.shape[1] - end, dtype=np.float64)
    for length in (60, 50, 40, 30, 24, 20, 16, 12, 9, 7):
        after = np.nan_to_num(beat[:, end : end + length] - level)
        fits = []
        for decay in np.geomspace(0.7, 40.0, 30):  # ms
            shape = np.exp(-since[: after.shape[1]] / decay)
            size = after @ shape / (shape @ shape)
            residual = after - np.outer(size, shape)
            fits.append((float((residual**2).sum()), size, decay, residual))
        misfit, size, decay, residual = min(fits, key=lambda fit: fit[0])
        small = np.abs(uniform_filter1d(residual, 3, axis=1)).max() < 0.015  # mV
        if small and misfit < 0.3**2 * (after**2).sum():
            tail[:, end:] = np.outer(size, np.exp(-since / decay))
            break
    return tail


def _offset(lead: Floats, by: int) -> Floats:
    """Value `by` samples later; beyond its ends the recording keeps its first or last value."""
    return np.asarray(lead[np.clip(np.arange(len(lead)) + by, 0, len(lead) - 1)])


def _movement(lead: Floats, reach: int) -> Floats:
    """Movement (mV) of the signal next to each sample, from `reach` to two or three times that.

    The lesser of both counts, since the other distance may meet the spike of another chamber; a
    step counts too.
    """
    step = 1 / 8 * np.abs(_offset(lead, reach) - _offset(lead, -reach))
    near, far, farther = (
        (_offset(lead, -k * reach) + _offset(lead, k * reach)) / 2 for k in (1, 2, 3)
    )
    return np.maximum(np.minimum(np.abs(near - far), np.abs(near - farther)), step)


def _around(power: Floats, reach: int) -> Floats:
    """Power (mV²) within 50 ms of each sample, the nearest 10 ms left out.

    The third highest of eight stretches of 10 ms, so that one other spike does not count.
    """
    mean = uniform_filter1d(power, 2 * reach, mode="nearest")
    distances = reach * np.array([-9, -7, -5, -3, 3, 5, 7, 9])
    third = np.partition([_offset(mean, by) for by in distances], 5, axis=0)[5]
    return np.asarray(np.maximum(third, 0.0))  # rounded below zero


def _pattern(signal: Floats, tops: Integers, reach: int) -> Floats:
    """Height of each lead at samples above the mean `reach` away, as unit vectors (12, k)."""
    before, after = np.clip([tops - reach, tops + reach], 0, signal.shape[1] - 1)
    height = np.nan_to_num(signal[:, tops] - (signal[:, before] + signal[:, after]) / 2)
    return np.asarray(height / np.maximum(np.linalg.norm(height, axis=0), np.finfo(float).tiny))


def _given_by_a_pacemaker(
    signal: Floats, tops: Integers, patterns: Floats, striking: Booleans, reach: int
) -> Booleans:
    """Whether candidates (k,) come at a fixed rate, or each before similar beats.

    Candidates of one pattern (12, k) are judged together: more than half of them decide. The
    signal (12, n) is without the candidates.
    """
    accepted = np.zeros(len(tops), dtype=bool)
    remaining = np.arange(len(tops))
    after = _after(signal, tops, reach)
    anywhere = _after(signal, np.linspace(0, signal.shape[1] - 1, 200).astype(np.int64), reach)
    usual = float(np.quantile((anywhere**2).sum(axis=(1, 2)), 0.8))
    while remaining.size:
        alike = np.abs(patterns[:, remaining].T @ patterns[:, remaining]) > 0.9
        members = remaining[alike[np.argmax(alike.sum(axis=1))]]
        remaining = np.setdiff1d(remaining, members)
        # first spikes of pairs
        first = np.diff(tops[members], prepend=-signal.shape[1]) > 20 * reach
        events = members[first]
        regular = _at_fixed_rate(tops[events], reach)
        if len(events) >= 6:  # three in each of two chambers
            for chamber in (slice(0, None, 2), slice(1, None, 2)):
                regular[chamber] |= _at_fixed_rate(tops[events][chamber], reach)
        paced = regular | _before_beats(after[events], usual, striking[events])
        # the potential after a spike near the end is not known
        judged = tops[events] + 62 * reach < signal.shape[1]
        accepted[members] = judged.any() and paced[judged].mean() > 0.5
    return accepted


def _at_fixed_rate(tops: Integers, reach: int) -> Booleans:
    """Whether each of three or more spikes comes at an interval of 0.25 to 2.5 s, or multiples."""
    intervals = np.diff(tops)
    usual = float(np.median(intervals)) if len(intervals) > 1 else 0.0
    if not 50 * reach <= usual <= 500 * reach:
        return np.zeros(len(tops), dtype=bool)
    beats = np.maximum(np.round(intervals / usual), 1)
    off = np.abs(intervals - beats * usual) > beats * reach
    # the first and the last have one neighbour alone
    return ~(np.pad(off, (1, 0), constant_values=True) & np.pad(off, (0, 1), constant_values=True))


def _after(signal: Floats, tops: Integers, reach: int) -> Floats:
    """Means (k, 12, 15) over 20 ms each, a period of 50 Hz mains, after spikes less that before."""
    width = 4 * reach
    starts = tops[:, None] + 2 * reach + width * np.array([-2, *range(15)])  # to 62 reaches
    starts = np.clip(starts, 0, signal.shape[1] - width)
    total = np.pad(np.cumsum(np.nan_to_num(signal), axis=1), ((0, 0), (1, 0)))
    means = (total[:, starts + width] - total[:, starts]) / width
    return np.asarray((means[..., 1:] - means[..., :1]).swapaxes(0, 1))


def _before_beats(after: Floats, usual: float, striking: Booleans) -> Booleans:
    """Whether each potential (k, 12, m) after spikes is as high as beats, and like the others.

    A quarter of the others must be alike, since several chambers may be paced with one pattern over
    the leads. Where there are only one or two spikes, it is enough that they are striking.
    """
    after = after.reshape(len(after), -1)
    some = after[:: max(len(after) // 200, 1)]
    energy, energies = (after**2).sum(axis=1), (some**2).sum(axis=1)
    apart = energy[:, None] + energies - 2 * after @ some.T
    alike = (apart < 0.3 * np.maximum(energy[:, None], energies)).sum(axis=1) - 1
    shared = (alike >= max(0.25 * (len(some) - 1), 1)) | (striking & (len(after) <= 2))
    return np.asarray((energy > 0.3 * usual) & shared)


def _bends(signal: Floats) -> Floats:
    """Largest second difference (mV) over the leads (12, n) at each sample but the outermost."""
    bends = np.abs(np.diff(signal, 2, axis=1))
    return np.pad(np.fmax.reduce(bends, axis=0, initial=0.0), 1)


def _end_of_ringing(bends: Floats, stop: int, reach: int) -> int:
    """Sample after `stop` up to which the leads bend more than a QRS, four reaches at most."""
    limit = 1.0 / reach**2  # 0.04 mV/ms²: ringing of 0.05 mV at 150 Hz
    for start in range(stop, stop + 4 * reach, reach):
        ringing = np.flatnonzero(bends[start : start + reach] > limit)
        if not ringing.size:
            break
        stop = start + int(ringing[-1]) + 1
    return stop


def _extents(signal: Floats, tops: Integers, reach: int) -> Integers:
    """First sample of each spike, where any lead leaves a line, and the one after its last.

    It rings until then, unless a second spike follows at once, of another chamber.
    """
    bends, spikes = _bends(signal), []
    for top in tops:
        before, after = max(int(top) - reach, 0), min(int(top) + reach, signal.shape[1] - 1)
        piece = signal[:, before : after + 1]
        share = np.linspace(0, 1, after - before + 1)
        away = np.abs(piece - piece[:, :1] - share * (piece[:, -1:] - piece[:, :1]))
        inside = np.flatnonzero((away > 0.03).any(axis=0))  # mV
        first, stop = before + int(inside[0]), before + int(inside[-1]) + 1
        second = bends[stop : stop + 4 * reach].max(initial=0.0) > 0.3 * bends[first:stop].max()
        spikes.append((first, stop if second else _end_of_ringing(bends, stop, reach)))
    return np.array(spikes, dtype=np.int64).reshape(-1, 2)
