"""What an action potential is described by: its upstroke and duration."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError

NEIGHBOURS = 12  # samples on each side of the steepest that the upstroke is interpolated through


def max_upstroke(time: Floats, potential: Floats) -> tuple[float, float]:
    """Maximum of dU/dt (mV/ms, that is V/s) and its time (ms), between samples by a cubic spline.

    Parameters
    ----------
    time, potential : (n,) arrays
        A record (ms, mV).
    """
    steepest = int(np.argmax(np.diff(potential) / np.diff(time)))
    near = slice(max(steepest - NEIGHBOURS, 0), steepest + NEIGHBOURS + 2)
    spline = CubicSpline(time[near], potential[near])
    candidates = np.concatenate(
        [time[near], spline.derivative(2).roots(discontinuity=False, extrapolate=False)]
    )
    slopes = spline(candidates, 1)
    best = int(np.argmax(slopes))
    return float(slopes[best]), float(candidates[best])


def duration(time: Floats, potential: Floats, repolarised: float = 0.9) -> float:
    """Action potential duration (ms), APD90 unless said otherwise.

    From the maximum upstroke until the potential falls through
    peak − `repolarised`·(peak − rest), rest being what the record starts with.

    Parameters
    ----------
    time, potential : (n,) arrays
        A record of one action potential (ms, mV).
    repolarised : float
        Share of the amplitude that is lost at the end.

    Raises
    ------
    InputError
        If the record ends before that.
    """
    peak = potential.max()
    level = peak - repolarised * (peak - potential[0])
    last = int(np.flatnonzero(potential >= level)[-1])
    if last + 1 == len(potential):
        raise InputError(
            f"record of {time[-1]:g} ms: ends at {potential[-1]:.1f} mV, before it has fallen to "
            f"{level:.1f}; record longer"
        )
    share = (potential[last] - level) / (potential[last] - potential[last + 1])
    end = time[last] + share * (time[last + 1] - time[last])
    return float(end - max_upstroke(time, potential)[1])
