"""QRS onset and offset, over all leads, and their errors.

`benchmarks/qrs_window.py` measures the errors on simulated ECGs, `benchmarks/manual_marks.py` those
against manual marks. Signals have a sample every ms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS, LIMB_LEADS
from fascicle.recording.detection import complete_leads
from fascicle.recording.filters import MAINS, Filter, FilterKind

SMOOTHING = 4.0  # ms; standard deviation of the Gaussian derivative
# Error of the method without noise (ms), that of the experts included: 95 % within two standard
# deviations
ONSET_ERROR, OFFSET_ERROR = 5.0, 4.5


class NoQrsError(ValueError):
    """The signal has no QRS: all leads are flat, or all but one of many."""


class _Search(NamedTuple):
    """Parameters of the search for the onset or the offset of the QRS."""

    # Time that makes a speed of a curvature (ms): at the top of a P wave or of a notch the leads
    # stand still for a moment, but turn.
    turning: float
    reach: int  # ms; the slow start or end of a QRS is not longer
    trend: int  # ms of the PR or ST segment that are taken as straight
    sloping: bool  # whether the segment may slope


# The QRS leaves an isoelectric PR segment slowly, and runs into an ST segment that is none.
_ONSET = _Search(turning=8.0, reach=80, trend=20, sloping=False)
_OFFSET = _Search(turning=5.0, reach=100, trend=30, sloping=True)


@dataclass(frozen=True)
class _Velocity:
    """Slope (mV/ms) and curvature (mV/ms²) of each lead, (k, n)."""

    slope: Floats
    curvature: Floats

    # ratio of a speed above noise to the speed of the quietest stretch nearby
    stands_out: ClassVar[float] = 2.2
    escalation: ClassVar[float] = 1.1  # factor by which a level rises that is too low for noise

    @classmethod
    def of(cls, leads: Floats, smoothing: float) -> _Velocity:
        """Velocity of leads (k, n), mV, smoothed by a Gaussian of `smoothing` ms."""
        slope, curvature = (
            np.asarray(gaussian_filter1d(leads, smoothing, axis=-1, order=order, mode="nearest"))
            for order in (1, 2)
        )
        return cls(slope, curvature)

    def speed(self, turning: float, trend: Floats | float = 0.0) -> Floats:
        """Speed (n,): root mean square over the leads of their deviation from the slope `trend`.

        Of four or more leads the fastest is left out at each instant, so that no lead decides
        alone.
        """
        power = (self.slope - trend) ** 2 + (turning * self.curvature) ** 2
        if len(power) >= 4:
            power = np.sort(power, axis=0)[:-1]
        return np.asarray(np.sqrt(power.mean(axis=0)))


def spatial_velocity(signal: Floats) -> Floats:
    r"""Speed (mV/ms) of all leads together, :math:`v(t) = \sqrt{\mathrm{mean}_i (dV_i/dt)^2}`.

    The signal is (12, n), mV, every ms; the mean is over the independent leads that were recorded,
    each smoothed by a Gaussian of `SMOOTHING` ms.
    """
    slope = _Velocity.of(signal[complete_leads(signal)], SMOOTHING).slope
    return np.asarray(np.sqrt(np.mean(slope**2, axis=0)))


def smoothing_against_ringing(filters: Sequence[Filter]) -> float:
    """Smoothing (ms) under which the ringing of steep low-passes does not count as QRS."""
    ringing = [
        # so wide a Gaussian leaves 4 % of the ringing: exp(-2 (0.4 pi)^2)
        1000.0 * 0.4 / filter_.frequency
        for filter_ in filters
        if filter_.kind is FilterKind.LOW_PASS and filter_.shape > 4.0
    ]
    return max([SMOOTHING, *ringing])


def qrs_window(
    signal: Floats, not_before: int = 0, smoothing: float = SMOOTHING
) -> tuple[int, int]:
    r"""First and last sample of the QRS.

    The fastest stretches of the beat, and the samples before them that are far from the isoelectric
    level, are the core of the QRS. From there outward the leads are followed until they rest for 10
    ms, slower than a level or than 2.2 times the quietest stretch nearby. Their speed is the root
    mean square over the leads, less the fastest, of
    :math:`\sqrt{(\dot V - \dot V_0)^2 + (\tau \ddot V)^2}`, with derivatives by a Gaussian,
    :math:`\tau` a time and :math:`\dot V_0` the slope of the PR or ST segment. From rest back
    inward, a lead is in the QRS from where it is 0.02 mV, or three standard deviations of its
    noise, from the line through the segment. Power-line interference is subtracted. A P wave that
    runs into the QRS is no part of it, nor is a T wave that begins at the J point.

    There is one mark of the limb leads together, which share electrodes, and one of each chest
    lead. The QRS begins and ends 2 ms outside of the second outermost mark, so that no mark decides
    alone. Its duration is that which electrocardiographs state; experts, who mark lead by lead,
    begin it 15 ms earlier in the outermost lead, and end it 9 ms later.

    Parameters
    ----------
    signal : (12, n) array
        One beat, recorded (mean) or simulated, potential (mV); leads not recorded are NaN. Rows
        after the twelfth, of additional leads, are ignored. A simulated QRS may begin and end at
        the ends of the array.
    not_before : int
        End of a pacing spike; the leads are at rest before it.
    smoothing : float
        Least smoothing (ms); see `smoothing_against_ringing`.

    Raises
    ------
    ValueError
        If no lead is complete, all leads are flat, or all but one of many.
    """
    onsets, offsets = _marks(signal, not_before, smoothing)
    second, further_out = min(1, len(onsets) - 1), 2  # ms
    first, last = int(onsets[second]) - further_out, int(offsets[second]) + further_out
    return max(first, not_before), min(last, signal.shape[1] - 1)


class _Marks(NamedTuple):
    """Sorted onsets and offsets (samples), outermost first, of the limb and each chest lead."""

    onsets: Integers
    offsets: Integers


def _marks(signal: Floats, not_before: int, smoothing: float) -> _Marks:
    """Ends of the QRS in the limb leads and in each chest lead."""
    beat = signal[: len(LEADS)].copy()
    if not_before:  # until a pacing spike ends, the level before it
        begin, end = (max(not_before - before, 0) for before in (30, 12))  # ms
        level = beat[:, begin : max(end, begin + 1)].mean(axis=1, keepdims=True)
        beat[:, :not_before] = level
    complete = np.isfinite(beat).all(axis=1)
    electrodes = np.maximum(np.flatnonzero(complete) - len(LIMB_LEADS) + 1, 0)
    core, velocity, leads, first = _core_and_leads(beat, smoothing, not_before > 0)
    p_end = 0 if not_before else _end_of_p_wave(leads, velocity, first, core)
    if p_end:
        beat[:, :p_end] = beat[:, p_end, None]
        core, velocity, leads, first = _core_and_leads(beat, smoothing, False)
    # A share of the height in ECGs of another size than a person's, such as uncalibrated ones
    height = float(np.ptp(leads[:, first : core[1] + 1], axis=1).max())
    # mV from which the QRS is seen to differ from the PR or ST segment
    visible = float(np.clip(0.02, 0.005 * height, 0.04 * height))
    last = leads.shape[1] - 1
    backward = _Velocity(-velocity.slope[:, ::-1], velocity.curvature[:, ::-1])
    ends = []
    for search, moving, outward, inside, start in (
        (_ONSET, backward, leads[:, ::-1], last - core[0], last - first),
        (_OFFSET, velocity, leads, core[1], core[1]),
    ):
        high = _highest(velocity.speed(search.turning))
        # mV/ms from which the leads are not at rest
        level = float(np.clip(0.001, 0.005 * high, 0.04 * high))
        isoelectric = _isoelectric_from(moving, start, search, level, max(first - search.trend, 0))
        away = _away_from_segment(outward, isoelectric, search, smoothing)
        noise = np.sqrt((away[:, isoelectric : isoelectric + search.trend] ** 2).mean(axis=1))
        least = np.maximum(visible, 3.0 * np.maximum(noise, np.median(noise)))
        deflected = np.abs(away[:, inside : isoelectric + 1]) > least[:, None]
        until = np.where(
            deflected.any(axis=1), deflected.shape[1] - 1 - np.argmax(deflected[:, ::-1], axis=1), 0
        )
        ends.append(
            [inside + until[electrodes == electrode].max() for electrode in np.unique(electrodes)]
        )
    # shift of the ends outward by additional smoothing (ms)
    smeared = round(1.2 * (smoothing - SMOOTHING))
    onsets = np.sort(last - np.array(ends[0])) + smeared
    return _Marks(np.maximum(onsets, not_before), -np.sort(-np.array(ends[1])) - smeared)


def _core_and_leads(
    beat: Floats, smoothing: float, paced: bool
) -> tuple[tuple[int, int], _Velocity, Floats, int]:
    """Core of the QRS, velocity, leads without interference, and first sample with a slow start.

    The velocity is smoothed until noise hardly contributes to it.
    """
    independent = beat[complete_leads(beat)]
    core = _core_of(independent, paced)
    independent = _without_interference(independent, core)
    velocity = _Velocity.of(independent, smoothing)
    for wider in (wider for wider in (5.0, 6.0, 8.0) if wider > smoothing):  # ms
        speed = velocity.speed(_OFFSET.turning)
        if velocity.stands_out * _quietest(speed) <= 0.025 * _highest(speed):
            break
        velocity = _Velocity.of(independent, wider)
    leads = _without_interference(beat[np.isfinite(beat).all(axis=1)], core)
    return core, velocity, leads, _with_slow_start(leads, velocity, core)


def _away_from_segment(
    leads: Floats, isoelectric: int, search: _Search, smoothing: float
) -> Floats:
    """Leads (k, n), outward, less the level or line of the segment from sample `isoelectric` on."""
    segment = np.arange(isoelectric, min(isoelectric + search.trend, leads.shape[1]))
    away = leads - leads[:, segment].mean(axis=1, keepdims=True)
    if search.sloping and len(segment) > 2:
        centred = segment - segment.mean()
        slope = away[:, segment] @ centred / (centred @ centred)
        away = away - slope[:, None] * (np.arange(leads.shape[1]) - segment.mean())
    return np.asarray(gaussian_filter1d(away, smoothing - 1.0, axis=1, mode="nearest"))


def _with_slow_start(leads: Floats, velocity: _Velocity, core: tuple[int, int]) -> int:
    """First sample at which leads (k, n) are off their level by a tenth of that in the core.

    By this a slow first part, such as a delta wave, is not taken for the PR segment.
    """
    earliest, width = max(core[0] - 220, 0), 20
    speed = velocity.speed(_ONSET.turning)[earliest : core[0]]
    if len(speed) < 2 * width:
        return core[0]
    speed = np.convolve(speed, np.full(width, 1 / width), mode="valid")
    quietest = earliest + int(np.argmin(speed))
    level = leads[:, quietest : quietest + width].mean(axis=1, keepdims=True)
    away = np.sqrt(((leads - level) ** 2).mean(axis=0))
    noise = 2.0 * float(away[quietest : quietest + width].mean())
    far = max(0.1 * float(away[core[0] : core[1] + 1].max()), noise)
    near = np.flatnonzero(away[: core[0] + 1] <= far)
    start = int(near[-1]) + 1 if near.size else 0
    start = max(start, core[0] - 130, quietest + width)
    return min(start, core[0])


def _end_of_p_wave(leads: Floats, velocity: _Velocity, first: int, core: tuple[int, int]) -> int:
    """Sample at which a P wave ends that was taken for the first part of the QRS, or 0.

    There all leads (k, n) return to the level before the P wave together, which they never do 60
    ms or more after the onset of a QRS, and faster deflections follow.
    """
    smooth = gaussian_filter1d(leads[:, : core[1] + 1], 3.0, axis=1, mode="nearest")
    level = smooth[:, max(first - 15, 0) : first + 1].mean(axis=1, keepdims=True)
    away = np.sqrt(((smooth - level) ** 2).mean(axis=0))[first:]
    if (highest := int(np.argmax(away))) <= 60:
        return 0
    lowest = 60 + int(np.argmin(away[60:highest]))
    speed = velocity.speed(_ONSET.turning)[first : core[1] + 1]
    alone = away[lowest] < 0.2 * min(away[:lowest].max(), away[highest])
    slower = speed[:lowest].max() < 0.5 * speed[lowest:].max()
    return first + lowest if alone and slower else 0


def _without_interference(leads: Floats, core: tuple[int, int]) -> Floats:
    """Leads (k, n) without power-line interference, where it dominates the isoelectric noise."""
    time = np.arange(leads.shape[1])
    # more than 60 ms from the core the beat is at rest
    isoelectric = np.flatnonzero((time < core[0] - 60) | (time > core[1] + 60))
    if len(isoelectric) < 4 * 1000.0 / min(MAINS):  # periods
        return leads
    slower = 8.0  # ms; standard deviation of the Gaussian that takes the interference away
    fast = leads - gaussian_filter1d(leads, slower, mode="nearest")
    power = np.sum(fast[:, isoelectric] ** 2, axis=1)
    for frequency in MAINS:
        turns = 2 * math.pi * frequency / 1000.0
        waves = np.array([np.cos(turns * time), np.sin(turns * time)])
        fitted = (
            np.linalg.lstsq(waves[:, isoelectric].T, fast[:, isoelectric].T, rcond=None)[0].T
            @ waves
        )
        interferes = np.sum(fitted[:, isoelectric] ** 2, axis=1) > 0.5 * power
        # share of the interference that is in `fast`
        kept = 1 - math.exp(-((turns * slower) ** 2) / 2)
        leads = leads - interferes[:, None] * fitted / kept
    return leads


def _quietest(speed: Floats) -> float:
    """Mean speed of the quietest 20 ms, or of all where there is less."""
    width = min(20, len(speed))
    return float(np.convolve(speed, np.full(width, 1 / width), mode="valid").min())


def _highest(speed: Floats) -> float:
    """Mean speed of the fastest 10 ms."""
    return float(np.sort(speed)[-10:].mean())


def _core_of(leads: Floats, paced: bool) -> tuple[int, int]:
    """First and last sample of the stretch of a beat (k, n) that is surely QRS.

    Its speed is a fifth of the highest or more, but for gaps of 40 ms; where that is longer than
    any QRS, because noise or a T wave are fast, the level rises. Then only half of a slow paced QRS
    may be left; the other half, unlike most T waves, has half of the highest speed or more.
    """
    smoothing = 10.0  # ms; leaves 1 % of 50 Hz interference
    # Curvature has much weight in the core: tall T waves are steep, but turn slowly.
    speed = _Velocity.of(leads, smoothing).speed(turning=10.0)
    highest = _highest(speed)
    if not highest > 0:
        raise NoQrsError("no QRS: the leads do not move, or one of many alone")
    peak, level = int(np.argmax(speed)), 0.2 * highest
    while True:
        fast = np.flatnonzero(speed >= min(level, speed[peak]))
        groups = np.split(fast, np.flatnonzero(np.diff(fast) > 40) + 1)
        group = next(group for group in groups if group[0] <= peak <= group[-1])
        if group[-1] - group[0] <= 220:  # ms
            break
        level *= _Velocity.escalation
    first, last, end = int(group[0]), int(group[-1]), len(speed) - 1
    sure, reach = np.flatnonzero(speed >= 0.5 * highest), 110
    sure = sure[(sure >= first - reach) & (sure <= last + reach)]
    if paced and sure.size and max(last, sure[-1]) - min(first, sure[0]) <= 300:  # ms
        first, last = min(first, int(sure[0])), max(last, int(sure[-1]))
    # smoothing has moved the ends outward, unless they are those of the array
    spread = round(smoothing)
    return (
        min(first + spread, peak) if first else 0,
        max(last - spread, peak) if last < end else end,
    )


def _isoelectric_from(
    velocity: _Velocity, core: int, search: _Search, level: float, rest: int
) -> int:
    """First sample after the core from which the leads follow the straight line of the segment.

    An ST segment that is elevated from the level at the sample `rest` need not be straight.
    """
    speed = velocity.speed(search.turning)
    end = core + _slow_after(speed, core, level, search.reach)
    if search.sloping and end - core >= 2:
        # Where a T wave follows the QRS at once, the leads never rest for 10 ms: slowest between
        slowest = core + int(np.argmin(speed[core:end]))
        t_wave = speed[slowest:end].max()
        if 1.2 * speed[slowest] < t_wave < 0.06 * _highest(speed):
            end = slowest
        elevation = 300.0 * level  # 0.3 mV; less moves the J point of normal ECGs
        j_point = _j_point(velocity.slope[:, rest : end + 1], core - rest, elevation)
        if j_point is not None:
            return rest + j_point
    start = end + 5  # nearer, the slope of the QRS is smoothed in
    beyond = velocity.slope[:, start : start + search.trend]
    if not beyond.shape[1]:
        return end
    trend = beyond.mean(axis=1, keepdims=True)
    if not search.sloping:
        trend = np.clip(trend, -0.3 * level, 0.3 * level)
    relative = velocity.speed(search.turning, trend)
    return core + _slow_after(relative, core, level, search.reach)


def _j_point(slope: Floats, core: int, elevation: float) -> int | None:
    """Sample after the core at which an elevated ST segment begins; None without one.

    Slopes (k, n), mV/ms, are those from rest to the end of the QRS. In the segment all leads go on
    away from rest in one direction, to an `elevation` (mV, root sum of squares) at least, and slow
    down by less than a factor e in 15 ms. A QRS ends on the other side or faster.
    """
    away, slope = slope.cumsum(axis=1)[:, core:], slope[:, core:]
    speed, trend = np.linalg.norm(slope, axis=0), slope[:, -10:].mean(axis=1)
    last = max(float(np.linalg.norm(trend)), np.finfo(float).tiny)
    before = np.maximum(np.arange(len(speed))[::-1] - 4.5, 0)  # ms, from the middle of the trend
    elevated = trend @ away / last
    in_segment = (elevated >= 0) & (trend @ slope >= 0.9 * speed * last)
    in_segment &= speed <= 1.1 * last * np.exp(before / 15)
    length = int(np.argmin(np.append(in_segment[::-1], False)))
    return core + len(speed) - length if length > 15 and elevated[-1] >= elevation else None


def _slow_after(speed: Floats, core: int, level: float, reach: int) -> int:
    """Count the samples after the core until the leads are slower than the level for 10 ms.

    The leads are taken as flat beyond the end of the array. If they are not slower within `reach`,
    the level is raised.
    """
    outward = speed[core:]
    end = len(outward) - 1
    # Right before the end of the array there may be no rest.
    near = outward[:reach] if end > 60 else speed
    level = max(level, _Velocity.stands_out * _quietest(near))
    outward = np.append(outward, np.zeros(10))[: reach + 10]
    fastest = np.lib.stride_tricks.sliding_window_view(outward, 10).max(axis=1)
    while True:
        slow = np.flatnonzero(fastest < level)
        if slow.size:
            return min(int(slow[0]), end)
        level *= _Velocity.escalation


def window_uncertainty(
    beats: Floats, not_before: int = 0, noise: float | None = None, smoothing: float = SMOOTHING
) -> tuple[float, float]:
    """Standard deviations (ms) of the ends of the QRS that `qrs_window` finds in the mean beat.

    The beats (n_beats, 12, n), mV, are aligned. The QRS is found again in 50 mean beats: of beats
    drawn with replacement (bootstrap, Efron, Ann. Statist. 7:1, 1979) or, where the `noise` (mV) of
    a beat is stated, as for a single one, with that much noise added. The method's own error,
    `ONSET_ERROR` and `OFFSET_ERROR`, adds to the spread of these windows, as does 0.4 times the
    time from the first to the fourth lead that is in the QRS. The draws are the same in every call.
    """
    rng, n_means = np.random.default_rng(0), 50
    n_beats, beats = len(beats), beats[:, : len(LEADS)]
    if noise is None:
        draws = rng.multinomial(n_beats, np.full(n_beats, 1 / n_beats), size=n_means) / n_beats
        means = np.tensordot(draws, beats, axes=1)
        inflation = n_beats / (n_beats - 1)  # the drawn beats vary about their mean, not the true
    else:
        white = rng.standard_normal((n_means, *beats.shape[1:]))
        # as smooth as a recorder's (2 ms)
        smooth = np.asarray(gaussian_filter1d(white, 2.0, axis=-1, mode="wrap"))
        means = beats.mean(axis=0) + np.asarray(smooth / smooth.std()) * noise / n_beats**0.5
        inflation = 1.0
    windows = np.array([qrs_window(mean, not_before, smoothing) for mean in means])
    # 68 % of a normal distribution; a few means in which another wave stands out do not count
    low, high = np.quantile(windows, [0.16, 0.84], axis=0)
    by_noise = inflation * ((high - low) / 2) ** 2
    onsets, offsets = _marks(beats.mean(axis=0), not_before, smoothing)
    fourth = min(3, len(onsets) - 1)
    by_leads = np.square(0.4 * np.array([onsets[fourth] - onsets[0], offsets[0] - offsets[fourth]]))
    onset, offset = np.sqrt(by_noise + by_leads + np.square([ONSET_ERROR, OFFSET_ERROR]))
    return float(onset), float(offset)
