"""Limb leads that follow from two others."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.leads import LIMB_LEADS, limb_leads_from


def derive_limb_leads(signal: Floats, recorded: Collection[str]) -> tuple[Floats, tuple[str, ...]]:
    """Fill the limb leads that were not recorded, by Einthoven's and Goldberger's laws.

    Parameters
    ----------
    signal : (12, n) array
        Potential (mV), leads in the order of `fascicle.core.leads.LEADS`.
    recorded : collection of str
        Names of the leads to keep as they are.

    Returns
    -------
    signal : (12, n) array
        The same, with the other limb leads computed; NaN where fewer than two are recorded.
    derived : tuple of str
        Names of those that were computed.
    """
    matrix = limb_leads_from(recorded)
    rows = [k for k, lead in enumerate(LIMB_LEADS) if lead not in recorded]
    filled = signal.copy()
    filled[rows] = np.nan
    if matrix is None or not rows:
        return filled, ()
    used = np.flatnonzero(matrix.any(axis=0))
    filled[rows] = matrix[rows][:, used] @ signal[used]
    return filled, tuple(LIMB_LEADS[k] for k in rows)
