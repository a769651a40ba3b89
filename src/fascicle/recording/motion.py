"""How fast all leads of a beat move together."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.recording.resampling import MAINS

FEW_LEADS = 4  # with fewer no lead is left out
SLOWER_THAN_HUM = 8.0  # ms; standard deviation of the Gaussian that takes hum away
HUM_SHARE = 0.5  # of the fast part of a lead at rest, above which it is hum
HUM_PERIODS = 4  # at rest, to recognise hum by
FROM_CORE = 60.0  # ms; beyond, a beat is at rest as far as hum is concerned


@dataclass(frozen=True)
class Motion:
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

    def backward(self) -> Motion:
        """The same with time reversed."""
        return Motion(-self.slope[:, ::-1], self.curvature[:, ::-1], self.smoothing)


def derivative(leads: Floats, smoothing: float, step: float, order: int) -> Floats:
    """Derivative (mV/ms or mV/ms²) of leads (k, n), by a Gaussian of `smoothing` ms."""
    from scipy.ndimage import gaussian_filter1d

    width = max(smoothing / step, 0.5)
    smooth = gaussian_filter1d(leads, width, axis=-1, order=order, mode="nearest")
    return np.asarray(smooth / step**order)


def motion_of(leads: Floats, smoothing: float, step: float) -> Motion:
    """Motion of leads (k, n), mV."""
    slope = derivative(leads, smoothing, step, 1)
    return Motion(slope, derivative(leads, smoothing, step, 2), smoothing)


def without_hum(leads: Floats, first: int, last: int, step: float) -> Floats:
    """Leads (k, n) less the mains hum of those in which it is most of what is fast at rest."""
    from scipy.ndimage import gaussian_filter1d

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
