"""Where the QRS begins and ends, from all leads together, and how surely.

The ends are those of the global QRS: the earliest onset and the latest offset in any lead. They are
read from one curve, the speed at which all leads together leave a straight line, against the
stillest stretch nearby: noise, an ending P wave or a rising ST segment are what the QRS has to
stand out from. `benchmarks/qrs_window.py` measures the errors on simulated ECGs.
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
from fascicle.recording.filters import Filter, FilterKind
from fascicle.recording.resampling import MAINS

SMOOTHING = 4.0  # ms; standard deviation of the Gaussian derivative
NOISY_SMOOTHINGS = (5.0, 6.0, 8.0)  # ms; instead, where the leads are never still otherwise
RINGING_ORDER = 4.0  # low-passes of higher order ring at their cut-off
# of whose period so wide a Gaussian leaves 4 % of the ringing: exp(-2 (0.4 pi)^2)
AGAINST_RINGING = 0.4
CORE_SMOOTHING = 10.0  # ms; leaves 1 % of 50 Hz hum
# Time (ms) that makes a speed of a curvature, in the core: tall T waves are steep, but turn slowly.
CORE_TURNING = 10.0
CORE = 0.2  # of the highest speed: surely QRS
CORE_GAP = 40.0  # ms; a slower stretch between two fast ones belongs to the QRS
LONGEST_CORE = 220.0  # ms; with more, it is noise or a T wave that is fast
PEAK = 10.0  # ms; the highest speed is the mean of so many fastest ms, not one of them
QUIET = 10.0  # ms; how long the leads must be still
REST = 30.0  # ms; of this length is the stillest stretch near the QRS
STANDS_OUT = 1.8  # times the mean speed in it is more than noise
ESCALATION = 1.1  # by which a level rises that is too low for noise
TREND_AFTER = 5.0  # ms from the end of the QRS; nearer, its own slope is smoothed in
# How much further out than the first and last activation the ends are found in simulated ECGs
# without noise (ms): half of the 2 ms at the onset, which experts mark earlier. Then, how much more
# it is for each ms of smoothing beyond `SMOOTHING`.
ONSET_EXCESS, OFFSET_EXCESS = 1.0, 2.0
SPREAD_PER_SMOOTHING = 1.75
# Error of the method where there is no noise (ms), bias included: 95 % within two of it on the
# simulated ECGs of `benchmarks/qrs_window.py`.
ONSET_ERROR, OFFSET_ERROR = 5.0, 7.0
REPEATS = 50  # of the search, in mean beats that noise has changed
NOISE_CORRELATION = 2.0  # ms; of stated noise
FEW_LEADS = 4  # with fewer no lead is left out
SLOWER_THAN_HUM = 8.0  # ms; standard deviation of the Gaussian that takes hum away
HUM_SHARE = 0.5  # of the fast part of a lead at rest, above which it is hum
HUM_PERIODS = 4  # at rest, to recognise hum by
FROM_CORE = 60.0  # ms; beyond, a beat is at rest as far as hum is concerned


class NoQrsError(ValueError):
    """The signal holds no QRS: no lead moves, or one alone of many."""


class _Search(NamedTuple):
    """How an end of the QRS is looked for."""

    level: float  # share of the highest speed that counts as moving where there is no noise
    # Time that makes a speed of a curvature (ms): at the top of a P wave or of a notch the leads
    # stand still for a moment, but turn.
    turning: float
    reach: float  # ms; the slow start or end of a QRS is not longer
    trend: float  # ms of the PR or ST segment that are taken as straight


# The QRS leaves a still PR segment slowly, and runs into an ST segment that is not still.
ONSET = _Search(level=0.025, turning=8.0, reach=80.0, trend=20.0)
OFFSET = _Search(level=0.03, turning=5.0, reach=100.0, trend=30.0)


@dataclass(frozen=True)
class _Motion:
    """Slope (mV/ms) and curvature (mV/ms²) of each lead, (k, n), and the smoothing (ms) of both."""

    slope: Floats
    curvature: Floats
    smoothing: float

    def speed(self, turning: float, trend: Floats | float = 0.0) -> Floats:
        """Root mean square over the leads, (n,), of how fast they leave lines of slope `trend`.

        Curvature counts as speed when multiplied by `turning` (ms). At each instant the fastest
        lead is left out, so that none decides alone.
        """
        power = (self.slope - trend) ** 2 + (turning * self.curvature) ** 2
        if len(power) >= FEW_LEADS:
            power = np.sort(power, axis=0)[:-1]
        return np.asarray(np.sqrt(power.mean(axis=0)))

    def backward(self) -> _Motion:
        """The same with time reversed."""
        return _Motion(-self.slope[:, ::-1], self.curvature[:, ::-1], self.smoothing)


def spatial_velocity(signal: Floats, step: float) -> Floats:
    r"""Speed of all leads together, :math:`v(t) = \sqrt{\mathrm{mean}_i (dV_i/dt)^2}`.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV); leads that are not there are NaN.
    step : float
        Sampling step (ms).

    Returns
    -------
    (n,) array
        Root mean square over the independent leads that are there of the derivative (mV/ms), each
        smoothed by a Gaussian of `SMOOTHING` ms.
    """
    slope = _derivative(signal[complete_leads(signal)], SMOOTHING, step, 1)
    return np.asarray(np.sqrt(np.mean(slope**2, axis=0)))


def smoothing_against_ringing(filters: Sequence[Filter]) -> float:
    """Smoothing (ms) under which steep low-passes that a recording has passed do not show.

    Without it the ringing before and after a QRS counts as QRS: in 30 simulated ECGs behind a
    low-pass at 35 Hz, of order 20, the onset was found 25 ms early and the offset 31 ms late.

    Parameters
    ----------
    filters : sequence of Filter
        What the recording has passed.
    """
    ringing = [
        1000.0 * AGAINST_RINGING / one.frequency
        for one in filters
        if one.kind is FilterKind.LOW_PASS and one.shape > RINGING_ORDER
    ]
    return max([SMOOTHING, *ringing])


def qrs_window(
    signal: Floats, step: float, not_before: int = 0, smoothing: float = SMOOTHING
) -> tuple[int, int]:
    r"""First and last sample of the QRS.

    The fastest stretches of the beat are its core; from there outward the QRS lasts until the leads
    have been still for `QUIET` ms. How fast they move is the root mean square over the leads, less
    the fastest, of :math:`\sqrt{(\dot V - \dot V_0)^2 + (\tau \ddot V)^2}`, with derivatives by a
    Gaussian, :math:`\tau` a time and :math:`\dot V_0` the slope of the PR or ST segment next to the
    QRS. Still is what is slower than a share of the highest speed, or than `STANDS_OUT` times the
    stillest stretch near the QRS where that is more. Mains hum is subtracted first.

    Parameters
    ----------
    signal : (12, n) array
        One beat, recorded (mean) or simulated, potential (mV); leads that are not there are NaN. A
        simulated QRS may begin and end at the ends of the array.
    step : float
        Sampling step (ms).
    not_before : int
        Sample before which the onset cannot be: the end of a pacing spike. Nothing before it is
        looked at.
    smoothing : float
        Least smoothing (ms); see `smoothing_against_ringing`.

    Returns
    -------
    onset, offset : int
        Samples; the QRS lasts ``(offset - onset) * step`` ms.

    Raises
    ------
    ValueError
        When no lead is there, none moves, or one of many alone.

    Notes
    -----
    Spatial velocity as in vectorcardiography, with one window for all leads as the CSE working
    party measures it (Willems et al., Eur. Heart J. 6:815, 1985).
    """
    leads = signal[complete_leads(signal), not_before:]
    first, last = _core(_motion_of(leads, CORE_SMOOTHING, step).speed(CORE_TURNING), step)
    motion = _quiet_motion(_without_hum(leads, first, last, step), step, smoothing)
    end = leads.shape[1] - 1
    onset = end - _still_from(motion.backward(), end - first, ONSET, step)
    offset = _still_from(motion, last, OFFSET, step)
    smeared = SPREAD_PER_SMOOTHING * (motion.smoothing - SMOOTHING)
    if onset > 0:
        onset = min(onset + round((smeared + ONSET_EXCESS) / step), first)
    if offset < end:
        offset = max(offset - round((smeared + OFFSET_EXCESS) / step), last)
    return not_before + onset, not_before + offset


def _quiet_motion(leads: Floats, step: float, smoothing: float) -> _Motion:
    """Motion with as little smoothing as makes its noise slower than the onset of a QRS."""
    motion = _motion_of(leads, smoothing, step)
    for wider in (wider for wider in NOISY_SMOOTHINGS if wider > smoothing):
        speed = motion.speed(OFFSET.turning)
        if STANDS_OUT * _stillest(speed, step) <= ONSET.level * _highest(speed, step):
            break
        motion = _motion_of(leads, wider, step)
    return motion


def _derivative(leads: Floats, smoothing: float, step: float, order: int) -> Floats:
    """Derivative (mV/ms or mV/ms²) of leads (k, n), by a Gaussian of `smoothing` ms."""
    width = max(smoothing / step, 0.5)
    smooth = gaussian_filter1d(leads, width, axis=-1, order=order, mode="nearest")
    return np.asarray(smooth / step**order)


def _motion_of(leads: Floats, smoothing: float, step: float) -> _Motion:
    """Motion of leads (k, n), mV."""
    slope = _derivative(leads, smoothing, step, 1)
    return _Motion(slope, _derivative(leads, smoothing, step, 2), smoothing)


def _without_hum(leads: Floats, first: int, last: int, step: float) -> Floats:
    """Leads (k, n) less the mains hum of those in which it is most of what is fast at rest."""
    time = step * np.arange(leads.shape[1])
    rest = np.flatnonzero((time < step * first - FROM_CORE) | (time > step * last + FROM_CORE))
    if len(rest) * step < HUM_PERIODS * 1000.0 / min(MAINS):
        return leads
    fast = leads - gaussian_filter1d(leads, SLOWER_THAN_HUM / step, mode="nearest")
    power = np.sum(fast[:, rest] ** 2, axis=1)
    for frequency in MAINS:
        turns = 2 * math.pi * frequency / 1000.0
        waves = np.array([np.cos(turns * time), np.sin(turns * time)])
        fitted = np.linalg.lstsq(waves[:, rest].T, fast[:, rest].T, rcond=None)[0].T @ waves
        hums = np.sum(fitted[:, rest] ** 2, axis=1) > HUM_SHARE * power
        kept = 1 - math.exp(-((turns * SLOWER_THAN_HUM) ** 2) / 2)  # of the hum, in `fast`
        leads = leads - hums[:, None] * fitted / kept
    return leads


def _stillest(speed: Floats, step: float) -> float:
    """Mean speed of the stillest `REST` ms, or of all where there is less."""
    width = min(max(round(REST / step), 1), len(speed))
    return float(np.convolve(speed, np.full(width, 1 / width), mode="valid").min())


def _highest(speed: Floats, step: float) -> float:
    """Mean of the fastest `PEAK` ms."""
    return float(np.sort(speed)[-max(round(PEAK / step), 1) :].mean())


def _core(speed: Floats, step: float) -> tuple[int, int]:
    """Find the ends of the fast stretch around the highest speed, joined over short gaps.

    Where it is longer than any QRS, what counts as fast rises.
    """
    highest = _highest(speed, step)
    if not highest > 0:
        raise NoQrsError("no QRS: the leads do not move, or one of many alone")
    peak, level = int(np.argmax(speed)), CORE * highest
    while True:
        fast = np.flatnonzero(speed >= min(level, speed[peak]))
        groups = np.split(fast, np.flatnonzero(np.diff(fast) > CORE_GAP / step) + 1)
        group = next(group for group in groups if group[0] <= peak <= group[-1])
        if (group[-1] - group[0]) * step <= LONGEST_CORE:
            break
        level *= ESCALATION
    # smoothing has moved the ends out, but for those of the array
    first, last, end = int(group[0]), int(group[-1]), len(speed) - 1
    spread = round(CORE_SMOOTHING / step)
    return min(first + spread, peak) if first else 0, max(
        last - spread, peak
    ) if last < end else end


def _still_from(motion: _Motion, core: int, search: _Search, step: float) -> int:
    """First sample after the core from which the leads keep to a straight line.

    The line is found where they are still by the first measure, then all is measured against it.
    """
    speed = motion.speed(search.turning)
    level = search.level * _highest(speed, step)
    end = core + _still_after(speed, core, level, search.reach, step)
    start = end + round(TREND_AFTER / step)
    beyond = motion.slope[:, start : start + round(search.trend / step)]
    if not beyond.shape[1]:
        return end
    relative = motion.speed(search.turning, beyond.mean(axis=1, keepdims=True))
    return core + _still_after(relative, core, level, search.reach, step)


def _still_after(speed: Floats, core: int, level: float, reach: float, step: float) -> int:
    """Count the samples after the core until the leads are still.

    Beyond the end of the array everything is still. When nothing is below the level within `reach`,
    the level rises.
    """
    quiet, furthest = max(round(QUIET / step), 1), round(reach / step)
    outward = speed[core:]
    end = len(outward) - 1
    # Right before the end of the array there may be no rest.
    near = outward[:furthest] if end * step > 2 * REST else speed
    level = max(level, STANDS_OUT * _stillest(near, step))
    outward = np.append(outward, np.zeros(quiet))[: furthest + quiet]
    fastest = np.lib.stride_tricks.sliding_window_view(outward, quiet).max(axis=1)
    while True:
        still = np.flatnonzero(fastest < level)
        if still.size:
            return min(int(still[0]), end)
        level *= ESCALATION


def window_uncertainty(
    beats: Floats,
    step: float,
    not_before: int = 0,
    noise: float | None = None,
    smoothing: float = SMOOTHING,
) -> tuple[float, float]:
    """Standard deviations of the ends of the QRS that `qrs_window` finds in the mean beat.

    What noise does is seen by finding the window again in `REPEATS` mean beats: of beats drawn with
    replacement (bootstrap) or, where the noise is stated, with that much noise added. The method's
    own error, `ONSET_ERROR` and `OFFSET_ERROR`, adds to it.

    Parameters
    ----------
    beats : (n_beats, 12, n) array
        Aligned beats (mV); leads that are not there are NaN in every beat.
    step : float
        Sampling step (ms).
    not_before, smoothing
        As in `qrs_window`.
    noise : float, optional
        Standard deviation of every sample of a beat (mV); needed where there is one beat.

    Returns
    -------
    onset_sd, offset_sd : float
        Standard deviations (ms); two of them hold 95 % of the errors.

    Raises
    ------
    ValueError
        When one beat comes without `noise`, or no lead moves.

    Notes
    -----
    Bootstrap after Efron, Ann. Statist. 7:1 (1979). The draws are the same in every call.
    """
    rng = np.random.default_rng(0)
    n_beats = len(beats)
    if noise is None:
        if n_beats < 2:
            raise ValueError("one beat says nothing about its noise; state it")
        draws = rng.multinomial(n_beats, np.full(n_beats, 1 / n_beats), size=REPEATS) / n_beats
        means = np.tensordot(draws, beats, axes=1)
        inflation = n_beats / (n_beats - 1)  # the drawn beats vary about their mean, not the true
    else:
        means = beats.mean(axis=0) + _noise(rng, beats.shape[1:], step) * noise / n_beats**0.5
        inflation = 1.0
    windows = np.array([qrs_window(mean, step, not_before, smoothing) for mean in means])
    # 68 % of a normal distribution; a few means in which another wave stands out do not count
    low, high = np.quantile(windows, [0.16, 0.84], axis=0)
    by_noise = step**2 * inflation * ((high - low) / 2) ** 2
    onset, offset = np.sqrt(by_noise + np.square([ONSET_ERROR, OFFSET_ERROR]))
    return float(onset), float(offset)


def _noise(rng: np.random.Generator, shape: tuple[int, ...], step: float) -> Floats:
    """`REPEATS` times noise of standard deviation 1, as smooth as a recorder's."""
    white = rng.standard_normal((REPEATS, *shape))
    smooth = gaussian_filter1d(white, NOISE_CORRELATION / step, axis=-1, mode="wrap")
    return np.asarray(smooth / smooth.std())
