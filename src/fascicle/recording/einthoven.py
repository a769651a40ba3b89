"""Whether the limb leads obey Einthoven's law."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LARGEST_MISFIT = 0.05  # mV
LARGEST_SHARE = 0.05  # of the limb leads' largest deflection


def einthoven_misfit(signal: NDArray[np.float64]) -> tuple[float, float]:
    r"""How far I + III is from II.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV).

    Returns
    -------
    misfit, height : float
        99th percentile of \|I + III - II\|, and of the largest \|limb lead\| (mV), each less
        its median: a constant offset of a lead is no misfit.
    """
    lead_i, lead_ii, lead_iii = signal[:3]
    misfit = lead_i + lead_iii - lead_ii
    limb = np.abs(signal[:3] - np.median(signal[:3], axis=1, keepdims=True)).max(axis=0)
    misfit = np.abs(misfit - np.median(misfit))
    return float(np.percentile(misfit, 99)), float(np.percentile(limb, 99))


def einthoven_warning(signal: NDArray[np.float64]) -> str | None:
    """One line when I + III differs noticeably from II in a (12, n) signal (mV)."""
    misfit, height = einthoven_misfit(signal)
    if misfit <= LARGEST_MISFIT or misfit <= LARGEST_SHARE * height:
        return None
    return (
        f"I + III differs from II by {misfit:.2f} mV ({misfit / height:.0%} of the limb leads); "
        "probably the leads have different gains in the file, give it one gain for all leads"
    )
