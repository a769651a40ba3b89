"""Synthetic beats: of a simulated ECG, and of a single recorded one with its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fascicle.core.arrays import Floats
from fascicle.recording.target import SAMPLING_STEP, Target
from fascicle.recording.window import qrs_window

MARGIN = 60  # samples before and after the simulated ECG
NOISE_CORRELATION = 4.0  # ms
REPETITIONS = 10  # as many beats as an ordinary 10 s recording has


def synthetic_target(
    leads: Floats,
    rng: np.random.Generator,
    beats: int = 10,
    noise: float = 0.03,
    amplitude_spread: float = 0.05,
) -> Target:
    """Beats of a simulated QRS that vary as recorded ones do: in amplitude and by noise.

    By default they vary by about 0.04 mV (standard deviation within the QRS), as in clinical
    10 s recordings.

    Parameters
    ----------
    leads : (12, n) array
        Simulated ECG (mV), every `SAMPLING_STEP`.
    rng : numpy.random.Generator
        Source of the variation.
    beats : int
        Number of beats.
    noise : float
        Standard deviation of additive noise (mV), smooth over a few ms.
    amplitude_spread : float
        Relative standard deviation of a beat's amplitude, all leads together.
    """
    clean = np.pad(leads, ((0, 0), (MARGIN, MARGIN)))
    onset, offset = qrs_window(clean, SAMPLING_STEP)
    peak = int(np.argmax((clean**2).sum(axis=0)))
    smooth = _smooth_noise(rng, (beats, *clean.shape), noise)
    amplitude = 1 + amplitude_spread * rng.standard_normal((beats, 1, 1))
    time = SAMPLING_STEP * (np.arange(clean.shape[1], dtype=np.float64) - peak)
    return Target(
        beats=amplitude * clean + smooth,
        time=time,
        qrs_onset=float(time[onset]),
        qrs_offset=float(time[offset]),
        heart_rate=60.0,
        provenance={"source": "simulated"},
    )


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
    noise = _smooth_noise(rng, (count, *target.beats.shape[1:]), target.noise)
    noise -= noise.mean(axis=0)
    return replace(target, beats=target.beats + noise, noise=None)


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], sd: float) -> Floats:
    """Noise (mV) of a standard deviation, smooth along the last axis over some ms."""
    white = rng.standard_normal(shape)
    smooth = gaussian_filter1d(white, NOISE_CORRELATION / SAMPLING_STEP, axis=-1)
    return np.asarray(smooth * (sd / smooth.std()))
