"""Beats as noise would have made them: repetitions of a single recorded one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats
from fascicle.recording.resampling import SAMPLING_STEP
from fascicle.recording.target import Target

NOISE_CORRELATION = 4.0  # ms
REPETITIONS = 10  # as many beats as an ordinary 10 s recording has


def repeated(target: Target, rng: np.random.Generator, count: int = REPETITIONS) -> Target:
    """Target with as many beats as if a single one had been recorded again and again.

    Parameters
    ----------
    target : Target
        One beat and its stated noise.
    rng : numpy.random.Generator
        Source of the noise.
    count : int
        Number of beats; their mean is exactly the recorded beat.

    Raises
    ------
    ValueError
        When no noise is stated.
    """
    if target.noise is None:
        raise ValueError("a target without a stated noise has beats of its own")
    noise = smooth_noise(rng, (count, *target.beats.shape[1:]), target.noise)
    noise -= noise.mean(axis=0)
    return replace(target, beats=target.beats + noise, noise=None)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], sd: float) -> Floats:
    """Noise that is smooth along the last axis, over some ms.

    Parameters
    ----------
    rng : numpy.random.Generator
        Its source.
    shape : tuple of int
        Of the result; the last axis is time, every `SAMPLING_STEP`.
    sd : float
        Standard deviation of the result (mV).
    """
    white = rng.standard_normal(shape)
    smooth = gaussian_filter1d(white, NOISE_CORRELATION / SAMPLING_STEP, axis=-1)
    return np.asarray(smooth * (sd / smooth.std()))
