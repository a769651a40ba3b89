"""How far leads are from linear relations that should hold between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LARGEST_MISFIT = 0.05  # mV
LARGEST_SHARE = 0.05  # of the limb leads' height
PERCENTILE = 99.0
ENOUGH = 30_000  # samples that give the percentile


def misfits(leads: NDArray[np.float64], zeros: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each relation is from zero.

    Parameters
    ----------
    leads : (m, n) array
        Potential (mV).
    zeros : (k, m) array
        Coefficients: ``zeros @ leads`` should be constant.

    Returns
    -------
    (k,) array
        99th percentile of the absolute value less its median (mV).
    """
    rest = zeros @ thinned(leads)
    rest = np.abs(rest - np.median(rest, axis=1, keepdims=True))
    return np.asarray(np.percentile(rest, PERCENTILE, axis=1))


def height(leads: NDArray[np.float64]) -> float:
    """99th percentile of the largest absolute value among leads (m, n), each less its median."""
    leads = thinned(leads)
    centred = np.abs(leads - np.median(leads, axis=1, keepdims=True))
    return float(np.percentile(centred.max(axis=0), PERCENTILE))


def limit_of(leads: NDArray[np.float64]) -> float:
    """Misfit (mV) up to which a relation between leads (m, n) holds."""
    return max(LARGEST_MISFIT, LARGEST_SHARE * height(leads))


def thinned(leads: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evenly spread samples of leads (m, n), which serve as relations hold at each sample."""
    return leads[:, :: max(leads.shape[1] // ENOUGH, 1)]
