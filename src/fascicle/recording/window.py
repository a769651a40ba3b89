"""Where the QRS begins and ends, from all leads together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.recording.detection import INDEPENDENT

SMOOTHING = 4.0  # ms; standard deviation of the Gaussian derivative
CORE = 0.2  # of the highest velocity: surely QRS
CORE_GAP = 60.0  # ms; a slower stretch between two fast ones belongs to the QRS
# Fractions of the highest velocity that count as moving. The QRS leaves a still PR segment slowly,
# and runs into an ST segment that is not still, hence two levels.
ONSET_LEVEL = 0.02
OFFSET_LEVEL = 0.05
QUIET = 10.0  # ms; how long the leads must be still
REACH = 80.0  # ms; the slow start or end of a QRS is not longer
ESCALATION = 1.25  # by which the level rises where the leads never are still
NOISE_FACTOR = 1.5  # a level this far above the stillest stretch is not noise


def spatial_velocity(signal: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    r"""Speed of all leads together, :math:`v(t) = \sqrt{\mathrm{mean}_i (dV_i/dt)^2}`.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV).
    step : float
        Sampling step (ms).

    Returns
    -------
    (n,) array
        Root mean square over the eight independent leads of the derivative (mV/ms), each smoothed
        by a Gaussian of `SMOOTHING` ms.
    """
    from scipy.ndimage import gaussian_filter1d

    leads = signal[list(INDEPENDENT)]
    width = max(SMOOTHING / step, 0.5)
    slope = gaussian_filter1d(leads, width, axis=-1, order=1, mode="nearest") / step
    return np.asarray(np.sqrt(np.mean(slope**2, axis=0)))


def qrs_window(signal: NDArray[np.float64], step: float) -> tuple[int, int]:
    """First and last sample of the QRS.

    The fastest stretches of the beat are its core; from there outward the QRS lasts until the leads
    have been still for `QUIET` ms. Still means slower than a fraction of the highest velocity,
    or than 1.5 times the noise where that is more.

    Parameters
    ----------
    signal : (12, n) array
        One beat, recorded (mean) or simulated, potential (mV). A simulated QRS may begin and end at
        the ends of the array.
    step : float
        Sampling step (ms).

    Returns
    -------
    onset, offset : int
        Samples; the QRS lasts ``(offset - onset) * step`` ms.

    Raises
    ------
    ValueError
        When no lead moves at all.
    """
    velocity = spatial_velocity(signal, step)
    highest = float(velocity.max())
    if not highest > 0:
        raise ValueError("no QRS: the leads do not move")
    first, last = _core(velocity, highest, round(CORE_GAP / step))
    onset = first - _still_after(velocity[: first + 1][::-1], ONSET_LEVEL * highest, step)
    offset = last + _still_after(velocity[last:], OFFSET_LEVEL * highest, step)
    return onset, offset


def _core(velocity: NDArray[np.float64], highest: float, gap: int) -> tuple[int, int]:
    """Find the ends of the fast stretch around the highest velocity, joined over short gaps."""
    fast = np.flatnonzero(velocity > CORE * highest)
    groups = np.split(fast, np.flatnonzero(np.diff(fast) > gap) + 1)
    peak = int(np.argmax(velocity))
    group = next(group for group in groups if group[0] <= peak <= group[-1])
    return int(group[0]), int(group[-1])


def _still_after(outward: NDArray[np.float64], level: float, step: float) -> int:
    """Count the samples, going outward from the core, until the leads are still.

    Beyond the end of the array everything is still. When nothing is below the level within `REACH`,
    the level rises.
    """
    quiet, reach = max(round(QUIET / step), 1), round(REACH / step)
    end = len(outward) - 1
    outward = np.append(outward, np.zeros(quiet))[: reach + quiet]
    stretches = np.lib.stride_tricks.sliding_window_view(outward, quiet)
    recorded = stretches[: max(len(stretches) - quiet, 1)]
    level = max(level, NOISE_FACTOR * float(recorded.mean(axis=1).min()))
    while True:
        still = np.flatnonzero(stretches.max(axis=1) < level)
        if still.size:
            return min(int(still[0]), end)
        level *= ESCALATION
