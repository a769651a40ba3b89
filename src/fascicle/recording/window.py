"""Where the QRS begins and ends, of all leads together and in the outermost leads, and how surely.

The *window*, of the spatial velocity of all leads together, is what losses and likelihoods see. The
*global window*, of the outermost leads, is longer; thresholds of guidelines (120, 130, 150 ms) rest
on its duration. `benchmarks/qrs_window.py` measures the errors on simulated ECGs,
`benchmarks/global_qrs.py` those against manual marks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats
from fascicle.recording.detection import complete_leads
from fascicle.recording.filters import MAINS, Filter, FilterKind

SMOOTHING = 4.0  # ms; standard deviation of the Gaussian derivative
# Error of the method without noise (ms), bias included: 95 % within two of it
ONSET_ERROR, OFFSET_ERROR = 5.0, 7.0
CORE_SMOOTHING = 10.0  # ms; leaves 1 % of 50 Hz interference
STANDS_OUT = 1.8  # speed over that of the quietest stretch nearby from which it is more than noise
ESCALATION = 1.1  # by which a level rises that is too low for noise
WINDOWS = 50  # mean beats, changed by noise, in which the window is found again
# Share of the highest speed of all leads together from which one lead moves: 25 to 30 dB above the
# noise of a mean beat, so that recordings and simulated ECGs without noise have the same level.
ONE_LEAD_LEVEL = 0.035


class NoQrsError(ValueError):
    """The signal holds no QRS: no lead moves, or one alone of many."""


class QrsWindows(NamedTuple):
    """First and last sample of the QRS of all leads together, and in the outermost leads."""

    window: tuple[int, int]
    global_window: tuple[int, int]


class _Search(NamedTuple):
    """How an end of the QRS is looked for."""

    level: float  # share of the highest speed that counts as moving without noise
    # Time that makes a speed of a curvature (ms): at the top of a P wave or of a notch the leads
    # stand still for a moment, but turn.
    turning: float
    reach: float  # ms; the slow start or end of a QRS is not longer
    trend: float  # ms of the PR or ST segment that are taken as straight


# The QRS leaves an isoelectric PR segment slowly, and runs into an ST segment that is none.
_ONSET = _Search(level=0.025, turning=8.0, reach=80.0, trend=20.0)
_OFFSET = _Search(level=0.03, turning=5.0, reach=100.0, trend=30.0)


@dataclass(frozen=True)
class _Velocity:
    """Slope (mV/ms) and curvature (mV/ms²) of each lead, (k, n), and the smoothing (ms) of both."""

    slope: Floats
    curvature: Floats
    smoothing: float

    @classmethod
    def of(cls, leads: Floats, smoothing: float, step: float) -> _Velocity:
        """Velocity of leads (k, n), mV."""
        first, second = (_derivative(leads, smoothing, step, order) for order in (1, 2))
        return cls(first, second, smoothing)

    def speed(self, turning: float, trend: Floats | float = 0.0) -> Floats:
        """Root mean square over the leads, (n,), of how fast they leave lines of slope `trend`.

        Of four or more leads the fastest is left out at each instant, so that none decides alone.
        """
        power = (self.slope - trend) ** 2 + (turning * self.curvature) ** 2
        if len(power) >= 4:
            power = np.sort(power, axis=0)[:-1]
        return np.asarray(np.sqrt(power.mean(axis=0)))

    def highest(self, step: float) -> list[float]:
        """Highest speeds (mV/ms), by the measures of the onset and of the offset."""
        return [_highest(self.speed(search.turning), step) for search in (_ONSET, _OFFSET)]

    def ends(self, core: tuple[int, int], levels: list[float], step: float) -> list[int]:
        """First and last sample outside the core from which the leads are isoelectric."""
        last = self.slope.shape[1] - 1
        backward = _Velocity(-self.slope[:, ::-1], self.curvature[:, ::-1], self.smoothing)
        before = _isoelectric_from(backward, last - core[0], _ONSET, levels[0], step)
        return [last - before, _isoelectric_from(self, core[1], _OFFSET, levels[1], step)]


def spatial_velocity(signal: Floats, step: float) -> Floats:
    r"""Speed (mV/ms) of all leads together, :math:`v(t) = \sqrt{\mathrm{mean}_i (dV_i/dt)^2}`.

    Of a signal (12, n), mV, every `step` ms; the mean is over the independent leads that are there,
    each smoothed by a Gaussian of `SMOOTHING` ms.
    """
    slope = _derivative(signal[complete_leads(signal)], SMOOTHING, step, 1)
    return np.asarray(np.sqrt(np.mean(slope**2, axis=0)))


def smoothing_against_ringing(filters: Sequence[Filter]) -> float:
    """Smoothing (ms) under which the ringing of steep low-passes does not count as QRS."""
    ringing = [
        # so wide a Gaussian leaves 4 % of the ringing: exp(-2 (0.4 pi)^2)
        1000.0 * 0.4 / one.frequency
        for one in filters
        if one.kind is FilterKind.LOW_PASS and one.shape > 4.0
    ]
    return max([SMOOTHING, *ringing])


def qrs_windows(
    signal: Floats, step: float, not_before: int = 0, smoothing: float = SMOOTHING
) -> QrsWindows:
    r"""First and last sample of the QRS, of all leads together and in the outermost leads.

    The fastest stretches of the beat are its core; from there outward the QRS lasts until the leads
    have been isoelectric for 10 ms. How fast they move is the root mean square over the leads, less
    the fastest, of :math:`\sqrt{(\dot V - \dot V_0)^2 + (\tau \ddot V)^2}`, with derivatives by a
    Gaussian, :math:`\tau` a time and :math:`\dot V_0` the slope of the PR or ST segment next to the
    QRS. Isoelectric is what is slower than a share of the highest speed, or than `STANDS_OUT` times
    the quietest stretch near the QRS: noise, an ending P wave or a rising ST segment. Power-line
    interference is subtracted.

    For the global window the same rule is applied to each lead alone, with `ONE_LEAD_LEVEL` times
    the highest speed of all leads together. The onset is the earliest mark that three other leads
    confirm within 12 ms, the offset the latest, within 10 ms.

    Parameters
    ----------
    signal : (12, n) array
        One beat, recorded (mean) or simulated, potential (mV); leads that are not there are NaN. A
        simulated QRS may begin and end at the ends of the array.
    step : float
        Sampling step (ms).
    not_before : int
        First sample that is looked at: the end of a pacing spike.
    smoothing : float
        Least smoothing (ms); see `smoothing_against_ringing`.

    Raises
    ------
    ValueError
        When no lead is there, none moves, or one of many alone.

    References
    ----------
    J. L. Willems et al., Eur. Heart J. 6:815 (1985), on both windows; P. Laguna et al., Comput.
    Biomed. Res. 27:45 (1994), and J. P. Martínez et al., IEEE Trans. Biomed. Eng. 51:570 (2004), on
    the outermost mark that others confirm.
    """
    beat = signal[:, not_before:]
    core, together = _core_and_velocity(beat, step, smoothing)
    onset, offset = _outermost_ends(beat, core, together, step)
    return QrsWindows(
        _window(core, together, step, not_before), (not_before + onset, not_before + offset)
    )


def qrs_window(
    signal: Floats, step: float, not_before: int = 0, smoothing: float = SMOOTHING
) -> tuple[int, int]:
    """Window of `qrs_windows`, of all leads together, alone."""
    core, together = _core_and_velocity(signal[:, not_before:], step, smoothing)
    return _window(core, together, step, not_before)


def _core_and_velocity(
    beat: Floats, step: float, smoothing: float
) -> tuple[tuple[int, int], _Velocity]:
    """Core of the QRS and the velocity of all leads together, hardly faster by noise than it."""
    leads = beat[complete_leads(beat)]
    core = _core_of(leads, step)
    leads = _without_interference(leads, core, step)
    velocity = _Velocity.of(leads, smoothing, step)
    for wider in (wider for wider in (5.0, 6.0, 8.0) if wider > smoothing):  # ms
        speed = velocity.speed(_OFFSET.turning)
        if STANDS_OUT * _quietest(speed, step) <= _ONSET.level * _highest(speed, step):
            break
        velocity = _Velocity.of(leads, wider, step)
    return core, velocity


def _window(
    core: tuple[int, int], velocity: _Velocity, step: float, not_before: int
) -> tuple[int, int]:
    """First and last sample of the QRS of all leads together."""
    fastest = velocity.highest(step)
    levels = [_ONSET.level * fastest[0], _OFFSET.level * fastest[1]]
    onset, offset = velocity.ends(core, levels, step)
    smeared = _smeared(velocity)
    # How much further out than the first and last activation the ends are found in simulated ECGs
    # without noise (ms): 1 is half of the 2 ms at the onset, which experts mark earlier.
    if onset > 0:
        onset = min(onset + round((smeared + 1.0) / step), core[0])
    if offset < velocity.slope.shape[1] - 1:
        offset = max(offset - round((smeared + 2.0) / step), core[1])
    return not_before + onset, not_before + offset


def _smeared(velocity: _Velocity) -> float:
    """How much further out (ms) more smoothing than `SMOOTHING` moves the ends."""
    return 1.75 * (velocity.smoothing - SMOOTHING)


def _outermost_ends(
    beat: Floats, core: tuple[int, int], together: _Velocity, step: float
) -> tuple[int, int]:
    """First and last sample of the QRS in the outermost leads that others confirm."""
    leads = _without_interference(beat[np.isfinite(beat).all(axis=1)], core, step)
    alone = [_Velocity.of(lead[None], together.smoothing, step) for lead in leads]
    levels = [ONE_LEAD_LEVEL * highest for highest in together.highest(step)]
    moving = [one for one in alone if one.highest(step)[0] > levels[0]]
    marks = [one.ends(core, levels, step) for one in moving]
    onsets, offsets = np.array(marks).T
    smeared = round(_smeared(together) / step)
    onset = _confirmed(onsets, 12.0 / step) + smeared
    offset = -_confirmed(-offsets, 10.0 / step) - smeared
    return min(onset, core[0]), max(offset, core[1])


def _confirmed(marks: Floats, within: float) -> int:
    """The smallest mark that three others confirm, or the median where none is confirmed."""
    marks = np.sort(marks)
    others = min(3, len(marks) - 1)
    confirmed = np.flatnonzero(marks[others:] - marks[: len(marks) - others] <= within)
    return int(marks[confirmed[0]] if confirmed.size else np.median(marks))


def _derivative(leads: Floats, smoothing: float, step: float, order: int) -> Floats:
    """Derivative (mV/ms or mV/ms²) of leads (k, n), by a Gaussian of `smoothing` ms."""
    width = max(smoothing / step, 0.5)
    smooth = gaussian_filter1d(leads, width, axis=-1, order=order, mode="nearest")
    return np.asarray(smooth / step**order)


def _without_interference(leads: Floats, core: tuple[int, int], step: float) -> Floats:
    """Leads (k, n) without power-line interference where it is most of what is fast at rest."""
    time = step * np.arange(leads.shape[1])
    # more than 60 ms from the core the beat is at rest
    rest = np.flatnonzero((time < step * core[0] - 60.0) | (time > step * core[1] + 60.0))
    if len(rest) * step < 4 * 1000.0 / min(MAINS):  # periods
        return leads
    slower = 8.0  # ms; standard deviation of the Gaussian that takes the interference away
    fast = leads - gaussian_filter1d(leads, slower / step, mode="nearest")
    power = np.sum(fast[:, rest] ** 2, axis=1)
    for frequency in MAINS:
        turns = 2 * math.pi * frequency / 1000.0
        waves = np.array([np.cos(turns * time), np.sin(turns * time)])
        fitted = np.linalg.lstsq(waves[:, rest].T, fast[:, rest].T, rcond=None)[0].T @ waves
        interferes = np.sum(fitted[:, rest] ** 2, axis=1) > 0.5 * power
        kept = 1 - math.exp(-((turns * slower) ** 2) / 2)  # of the interference, in `fast`
        leads = leads - interferes[:, None] * fitted / kept
    return leads


def _quietest(speed: Floats, step: float) -> float:
    """Mean speed of the quietest 30 ms, or of all where there is less."""
    width = min(max(round(30.0 / step), 1), len(speed))
    return float(np.convolve(speed, np.full(width, 1 / width), mode="valid").min())


def _highest(speed: Floats, step: float) -> float:
    """Mean of the fastest 10 ms, not one sample alone."""
    return float(np.sort(speed)[-max(round(10.0 / step), 1) :].mean())


def _core_of(leads: Floats, step: float) -> tuple[int, int]:
    """First and last sample of the stretch of a beat (k, n) that is surely QRS.

    It has a fifth of the highest speed, but for gaps of 40 ms; where that is longer than any QRS,
    because noise or a T wave are fast, the level rises.
    """
    # In the core curvature counts much: tall T waves are steep, but turn slowly.
    speed = _Velocity.of(leads, CORE_SMOOTHING, step).speed(turning=10.0)
    highest = _highest(speed, step)
    if not highest > 0:
        raise NoQrsError("no QRS: the leads do not move, or one of many alone")
    peak, level = int(np.argmax(speed)), 0.2 * highest
    while True:
        fast = np.flatnonzero(speed >= min(level, speed[peak]))
        groups = np.split(fast, np.flatnonzero(np.diff(fast) > 40.0 / step) + 1)
        group = next(group for group in groups if group[0] <= peak <= group[-1])
        if (group[-1] - group[0]) * step <= 220.0:  # ms
            break
        level *= ESCALATION
    # smoothing has moved the ends out, but for those of the array
    first, last, end = int(group[0]), int(group[-1]), len(speed) - 1
    spread = round(CORE_SMOOTHING / step)
    return (
        min(first + spread, peak) if first else 0,
        max(last - spread, peak) if last < end else end,
    )


def _isoelectric_from(
    velocity: _Velocity, core: int, search: _Search, level: float, step: float
) -> int:
    """First sample after the core from which the leads keep to the line that they are slow on."""
    end = core + _slow_after(velocity.speed(search.turning), core, level, search.reach, step)
    start = end + round(5.0 / step)  # nearer, the slope of the QRS is smoothed in
    beyond = velocity.slope[:, start : start + round(search.trend / step)]
    if not beyond.shape[1]:
        return end
    relative = velocity.speed(search.turning, beyond.mean(axis=1, keepdims=True))
    return core + _slow_after(relative, core, level, search.reach, step)


def _slow_after(speed: Floats, core: int, level: float, reach: float, step: float) -> int:
    """Count the samples after the core until the leads are slower than the level for 10 ms.

    Beyond the end of the array nothing moves. Where none are within `reach`, the level rises.
    """
    quiet, furthest = max(round(10.0 / step), 1), round(reach / step)
    outward = speed[core:]
    end = len(outward) - 1
    # Right before the end of the array there may be no rest.
    near = outward[:furthest] if end * step > 60.0 else speed
    level = max(level, STANDS_OUT * _quietest(near, step))
    outward = np.append(outward, np.zeros(quiet))[: furthest + quiet]
    fastest = np.lib.stride_tricks.sliding_window_view(outward, quiet).max(axis=1)
    while True:
        slow = np.flatnonzero(fastest < level)
        if slow.size:
            return min(int(slow[0]), end)
        level *= ESCALATION


def window_uncertainty(
    beats: Floats,
    step: float,
    not_before: int = 0,
    noise: float | None = None,
    smoothing: float = SMOOTHING,
) -> tuple[float, float]:
    """Standard deviations (ms) of the ends of the QRS that `qrs_window` finds in the mean beat.

    Of aligned beats (n_beats, 12, n), mV. The window is found again in `WINDOWS` mean beats: of
    beats drawn with replacement (bootstrap, Efron, Ann. Statist. 7:1, 1979) or, where the `noise`
    (mV) of a beat is stated, as for a single one, with that much noise added. The method's own
    error, `ONSET_ERROR` and `OFFSET_ERROR`, adds to it. The draws are the same in every call.
    """
    rng = np.random.default_rng(0)
    n_beats = len(beats)
    if noise is None:
        draws = rng.multinomial(n_beats, np.full(n_beats, 1 / n_beats), size=WINDOWS) / n_beats
        means = np.tensordot(draws, beats, axes=1)
        inflation = n_beats / (n_beats - 1)  # the drawn beats vary about their mean, not the true
    else:
        white = rng.standard_normal((WINDOWS, *beats.shape[1:]))
        # as smooth as a recorder's (2 ms)
        smooth = np.asarray(gaussian_filter1d(white, 2.0 / step, axis=-1, mode="wrap"))
        means = beats.mean(axis=0) + np.asarray(smooth / smooth.std()) * noise / n_beats**0.5
        inflation = 1.0
    windows = np.array([qrs_window(mean, step, not_before, smoothing) for mean in means])
    # 68 % of a normal distribution; a few means in which another wave stands out do not count
    low, high = np.quantile(windows, [0.16, 0.84], axis=0)
    by_noise = step**2 * inflation * ((high - low) / 2) ** 2
    onset, offset = np.sqrt(by_noise + np.square([ONSET_ERROR, OFFSET_ERROR]))
    return float(onset), float(offset)
