"""Artefacts of synthetic recordings: pacing spikes, f-waves and noise.

All are potentials (mV) of the nine electrodes, so that the leads obey Einthoven's law.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fascicle.core.leads import ELECTRODES, lead_matrix

Array = NDArray[np.float64]

CUT_OFF = (0.35, 300.0)  # of the sampling rate, and Hz: low-pass of recorders, smears spikes
BIPOLAR, UNIPOLAR = (0.5, 3.0), (5.0, 40.0)  # mV; spikes in the lead that shows them best

# How each of `ELECTRODES` sees the heart vector (left, down, forward), of a rough size that gives
# leads of the usual proportions.
SIGHT = np.array(
    [
        [-0.6, 0.5, 0.1, -0.5, -0.1, 0.6, 1.0, 1.2, 1.1],
        [-0.4, -0.4, 0.8, -0.1, 0.1, 0.2, 0.3, 0.3, 0.2],
        [0.0, 0.0, 0.1, 1.1, 1.4, 1.3, 0.9, 0.4, 0.1],
    ]
).T


def samples(t: Array, start: float, end: float) -> slice:
    """Samples of `t` from `start` to `end` (s), both included."""
    return slice(int(np.searchsorted(t, start)), int(np.searchsorted(t, end, side="right")))


def pulses(rng: np.random.Generator, t: Array, times: Array, size: float | None) -> Array:
    """Pulses (9, n) as a recorder with a Gaussian low-pass shows them."""
    from scipy.special import ndtr

    total = np.zeros((len(ELECTRODES), len(t)))
    rate = 1 / (t[1] - t[0])
    share, largest = CUT_OFF
    blur = np.sqrt(np.log(2)) / (2 * np.pi * min(share * rate, largest))  # s; -3 dB at the cut-off
    width = rng.uniform(0.0004, 0.002)
    if size is None:
        size = rng.uniform(*(UNIPOLAR if rng.random() < 0.5 else BIPOLAR))
    direction = SIGHT @ rng.standard_normal(3)
    direction *= size / np.abs(lead_matrix() @ direction).max()
    tallest = ndtr(width / 2 / blur) - ndtr(-width / 2 / blur)
    for time in times:
        at = samples(t, time - 6 * blur, time + width + 6 * blur)
        profile = ndtr((t[at] - time) / blur) - ndtr((t[at] - time - width) / blur)
        total[:, at] += direction[:, None] * profile / tallest
    return total


def f_waves(rng: np.random.Generator, t: Array) -> Array:
    """Fibrillating atria: 4 to 8 Hz with sharp tops, 0.05 to 0.15 mV, slowly changing."""
    frequency, drift = rng.uniform(4, 8), rng.uniform(0.05, 0.3)
    phase = 2 * np.pi * frequency * t + np.sin(2 * np.pi * drift * t)
    wave = np.sin(phase) + 0.3 * np.sin(2 * phase)
    size = rng.uniform(0.05, 0.15) * np.array([0.3, 0.3, 0.5, 1.0, 0.7, 0.5, 0.3, 0.3, 0.3])
    return np.asarray(size[:, None] * wave)


def _white(rng: np.random.Generator, t: Array) -> Array:
    return np.asarray(rng.standard_normal((len(ELECTRODES), len(t))))


def _mains(rng: np.random.Generator, t: Array) -> Array:
    """50 Hz with a third harmonic, of its own size and phase at each electrode."""
    size, phase = rng.uniform(0.2, 1, (9, 1)), rng.uniform(-1, 1, (9, 1))
    turn = 2 * np.pi * 50 * t + phase
    return np.asarray(size * (np.sin(turn) + 0.1 * np.sin(3 * turn)))


def _muscle(rng: np.random.Generator, t: Array) -> Array:
    """20 to 150 Hz in bursts that come and go."""
    from scipy.signal import butter, sosfilt

    rate = 1 / (t[1] - t[0])
    band = butter(2, (20, min(150, 0.45 * rate)), "bandpass", fs=rate, output="sos")
    burst = np.sin(2 * np.pi * rng.uniform(0.1, 0.5, (9, 1)) * t + rng.uniform(0, 6, (9, 1)))
    return np.asarray((1 + 0.7 * burst) * sosfilt(band, _white(rng, t), axis=-1))


def _wander(rng: np.random.Generator, t: Array) -> Array:
    """Slow drift of each electrode, 0.05 to 0.6 Hz."""
    total = np.zeros((len(ELECTRODES), len(t)))
    for frequency in rng.uniform(0.05, 0.6, 4):
        turn = 2 * np.pi * (frequency * t + rng.random((len(ELECTRODES), 1)))
        total += rng.standard_normal((len(ELECTRODES), 1)) * np.sin(turn)
    return total


def _motion(rng: np.random.Generator, t: Array) -> Array:
    """Electrodes that are pushed now and then: a rise in 50 ms, a decay in about half a second."""
    total = np.zeros((len(ELECTRODES), len(t)))
    for time in np.arange(-1, t[-1], 1.0) + rng.uniform(0, 1, len(np.arange(-1, t[-1], 1.0))):
        since = np.maximum(t - time, 0)
        push = (1 - np.exp(-since / 0.05)) * np.exp(-since / rng.uniform(0.2, 0.8))
        total[rng.integers(len(ELECTRODES))] += rng.standard_normal() * push
    return total


NOISES: dict[str, Callable[[np.random.Generator, Array], Array]] = {
    "white": _white,
    "mains": _mains,
    "muscle": _muscle,
    "wander": _wander,
    "motion": _motion,
}
