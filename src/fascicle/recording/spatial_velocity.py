"""How fast the leads of a beat move, and from when on they are still: what finds the QRS.

Still is what is slower than a level, or than a little more than the stillest stretch nearby: noise,
an ending P wave or a rising ST segment are what the QRS has to stand out from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats
from fascicle.recording.resampling import MAINS

SMOOTHING = 4.0  # ms; standard deviation of the Gaussian derivative
NOISY_SMOOTHINGS = (5.0, 6.0, 8.0)  # ms; instead, where the leads are never still otherwise
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
FEW_LEADS = 4  # with fewer no lead is left out
SLOWER_THAN_HUM = 8.0  # ms; standard deviation of the Gaussian that takes hum away
HUM_SHARE = 0.5  # of the fast part of a lead at rest, above which it is hum
HUM_PERIODS = 4  # at rest, to recognise hum by
FROM_CORE = 60.0  # ms; beyond, a beat is at rest as far as hum is concerned


class NoQrsError(ValueError):
    """The signal holds no QRS: no lead moves, or one alone of many."""


class Search(NamedTuple):
    """How an end of the QRS is looked for."""

    level: float  # share of the highest speed that counts as moving where there is no noise
    # Time that makes a speed of a curvature (ms): at the top of a P wave or of a notch the leads
    # stand still for a moment, but turn.
    turning: float
    reach: float  # ms; the slow start or end of a QRS is not longer
    trend: float  # ms of the PR or ST segment that are taken as straight


# The QRS leaves a still PR segment slowly, and runs into an ST segment that is not still.
ONSET = Search(level=0.025, turning=8.0, reach=80.0, trend=20.0)
OFFSET = Search(level=0.03, turning=5.0, reach=100.0, trend=30.0)


@dataclass(frozen=True)
class SpatialVelocity:
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

    def level(self, search: Search, step: float) -> float:
        """Speed (mV/ms) that counts as moving: a share of the highest, by the search."""
        return search.level * _highest(self.speed(search.turning), step)

    def lead(self, row: int) -> SpatialVelocity:
        """That of one lead alone."""
        return SpatialVelocity(self.slope[[row]], self.curvature[[row]], self.smoothing)

    def backward(self) -> SpatialVelocity:
        """The same with time reversed."""
        return SpatialVelocity(-self.slope[:, ::-1], self.curvature[:, ::-1], self.smoothing)


def derivative(leads: Floats, smoothing: float, step: float, order: int) -> Floats:
    """Derivative (mV/ms or mV/ms²) of leads (k, n), by a Gaussian of `smoothing` ms."""
    width = max(smoothing / step, 0.5)
    smooth = gaussian_filter1d(leads, width, axis=-1, order=order, mode="nearest")
    return np.asarray(smooth / step**order)


def spatial_velocity(leads: Floats, smoothing: float, step: float) -> SpatialVelocity:
    """Slope and curvature of leads (k, n), mV."""
    slope = derivative(leads, smoothing, step, 1)
    return SpatialVelocity(slope, derivative(leads, smoothing, step, 2), smoothing)


def quiet_spatial_velocity(leads: Floats, step: float, smoothing: float) -> SpatialVelocity:
    """Slope and curvature, smoothed just enough that noise is slower than the onset of a QRS."""
    velocity = spatial_velocity(leads, smoothing, step)
    for wider in (wider for wider in NOISY_SMOOTHINGS if wider > smoothing):
        speed = velocity.speed(OFFSET.turning)
        if STANDS_OUT * _stillest(speed, step) <= ONSET.level * _highest(speed, step):
            break
        velocity = spatial_velocity(leads, wider, step)
    return velocity


def without_hum(leads: Floats, first: int, last: int, step: float) -> Floats:
    """Leads (k, n) without power-line interference where it is most of what is fast at rest."""
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


def core_of(leads: Floats, step: float) -> tuple[int, int]:
    """First and last sample of the fastest stretch of a beat (k, n), joined over short gaps.

    Where it is longer than any QRS, what counts as fast rises.

    Raises
    ------
    NoQrsError
        When no lead moves, or one of many alone.
    """
    speed = spatial_velocity(leads, CORE_SMOOTHING, step).speed(CORE_TURNING)
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


def isoelectric_from(
    velocity: SpatialVelocity, core: int, search: Search, level: float, step: float
) -> int:
    """First sample after the core from which the leads keep to a straight line.

    The line is found where they are still by the first measure, then all is measured against it.

    Parameters
    ----------
    velocity : SpatialVelocity
        Of the leads that are looked at; `SpatialVelocity.backward` finds the other end.
    core : int
        Sample of the QRS from which to search.
    search : Search
        How; its `level` is not used.
    level : float
        Speed (mV/ms) that counts as moving where there is no noise.
    step : float
        Sampling step (ms).
    """
    end = core + _still_after(velocity.speed(search.turning), core, level, search.reach, step)
    start = end + round(TREND_AFTER / step)
    beyond = velocity.slope[:, start : start + round(search.trend / step)]
    if not beyond.shape[1]:
        return end
    relative = velocity.speed(search.turning, beyond.mean(axis=1, keepdims=True))
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
