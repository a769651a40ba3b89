"""Where the QRS begins and ends, from all leads together, and how surely.

The ends are read from one curve, the speed at which all leads together leave a straight line. They
are what losses and likelihoods see; a cardiologist, who goes lead by lead, marks a wider QRS:
`fascicle.recording.global_window`. `benchmarks/qrs_window.py` measures the errors on simulated
ECGs, `benchmarks/global_qrs.py` those against manual marks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats
from fascicle.recording.detection import complete_leads
from fascicle.recording.filters import Filter, FilterKind
from fascicle.recording.spatial_velocity import (
    OFFSET,
    ONSET,
    SMOOTHING,
    core_of,
    derivative,
    isoelectric_from,
    quiet_spatial_velocity,
    without_hum,
)

RINGING_ORDER = 4.0  # low-passes of higher order ring at their cut-off
# of whose period so wide a Gaussian leaves 4 % of the ringing: exp(-2 (0.4 pi)^2)
AGAINST_RINGING = 0.4
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
    slope = derivative(signal[complete_leads(signal)], SMOOTHING, step, 1)
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
    first, last = core_of(leads, step)
    velocity = quiet_spatial_velocity(without_hum(leads, first, last, step), step, smoothing)
    end = leads.shape[1] - 1
    level = velocity.level(ONSET, step)
    onset = end - isoelectric_from(velocity.backward(), end - first, ONSET, level, step)
    offset = isoelectric_from(velocity, last, OFFSET, velocity.level(OFFSET, step), step)
    smeared = SPREAD_PER_SMOOTHING * (velocity.smoothing - SMOOTHING)
    if onset > 0:
        onset = min(onset + round((smeared + ONSET_EXCESS) / step), first)
    if offset < end:
        offset = max(offset - round((smeared + OFFSET_EXCESS) / step), last)
    return not_before + onset, not_before + offset


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
