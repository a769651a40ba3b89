"""How beats differ from their mean: across leads, across time, and as noise would make them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.recording.target import Target


@dataclass(frozen=True)
class ResidualCovariance:
    """Covariance of the beats about their mean, within the QRS.

    The covariance of lead l at time t with lead m at time s is
    ``sd[l, t] * sd[m, s] * leads[l, m] * time[t, s]``.

    Attributes
    ----------
    sd : (n_leads, n_qrs) array
        Standard deviation of every sample (mV); NaN where a lead is not used.
    leads : (n_leads, n_leads) array
        Correlation across leads; NaN where a lead is not used.
    time : (n_qrs, n_qrs) array
        Correlation across samples of the QRS.
    shrinkage_leads, shrinkage_time : float
        Weight of "no correlation" in each: near 0 with many beats, 1 where they show nothing.
    """

    sd: Floats
    leads: Floats
    time: Floats
    shrinkage_leads: float
    shrinkage_time: float


def residual_covariance(target: Target) -> ResidualCovariance:
    """Estimate the covariance of a target's beats about their mean, within the QRS.

    The correlation is taken as separable, one between leads times one in time, each averaged over
    the other and shrunk towards none by the weight of Ledoit and Wolf (2004, J. Multivar. Anal.
    88:365), with whole beats as samples. Of a single beat, samples and leads vary by its stated
    noise independently.
    """
    window, used = target.qrs_samples, target.used
    sd = target.standard_deviation[:, window]
    if target.noise is not None:
        leads, time, weights = np.eye(len(sd)), np.eye(sd.shape[1]), (1.0, 1.0)
    else:
        residual = (target.qrs_beats - target.qrs)[:, used]
        scores = residual / np.maximum(sd[used], np.finfo(float).tiny)
        leads = np.eye(len(sd))
        leads[np.ix_(used, used)], by_lead = _correlation(scores)
        time, by_time = _correlation(scores.transpose(0, 2, 1))
        weights = by_lead, by_time
    leads[~used] = leads[:, ~used] = np.nan
    return ResidualCovariance(sd, leads, time, *weights)


def _correlation(scores: Floats) -> tuple[Floats, float]:
    """Shrunk correlation (p, p) of scores (n_beats, p, q), and the weight of none in it."""
    each = scores @ scores.transpose(0, 2, 1) / scores.shape[2]
    n, raw = len(each), each.mean(axis=0)
    identity = np.eye(len(raw)) * np.trace(raw) / len(raw)
    structure = ((raw - identity) ** 2).sum()
    if n < 3 or not structure > 0:  # about their own mean, two beats differ by the same
        return np.eye(len(raw)), 1.0
    # n(n - 2), not n(n - 1): the residuals are about the mean of the same beats
    weight = float(min(((each - raw) ** 2).sum() / (n * (n - 2)) / structure, 1.0))
    shrunk = (1 - weight) * raw + weight * identity
    root = np.sqrt(np.maximum(np.diag(shrunk), np.finfo(float).tiny))
    return shrunk / np.outer(root, root), weight


def repeated(target: Target, rng: np.random.Generator, count: int = 10) -> Target:
    """Target with `count` beats as if its single one, of stated noise, had been recorded often.

    Their mean is the recorded beat.
    """
    assert target.noise is not None
    noise = smooth_noise(rng, (count, *target.beats.shape[1:]), target.noise)
    noise -= noise.mean(axis=0)
    return replace(target, beats=target.beats + noise, noise=None)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], sd: float) -> Floats:
    """Noise of standard deviation `sd` (mV), smooth along the last axis, time, over some ms."""
    white = rng.standard_normal(shape)
    smooth = gaussian_filter1d(white, 4.0 / SAMPLING_STEP, axis=-1)  # ms
    return np.asarray(smooth * (sd / smooth.std()))
