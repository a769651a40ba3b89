"""The twelve standard leads and the nine electrodes they are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEADS: tuple[str, ...] = (
    "I", "II", "III", "aVR", "aVL", "aVF", "V1", "V2", "V3", "V4", "V5", "V6",
)  # fmt: skip
ELECTRODES: tuple[str, ...] = ("RA", "LA", "LL", "V1", "V2", "V3", "V4", "V5", "V6")


def lead_matrix() -> NDArray[np.float64]:
    """Matrix that turns electrode potentials into leads.

    Returns
    -------
    (12, 9) array
        ``leads = lead_matrix() @ potentials`` with rows in the order of `LEADS` and columns in the
        order of `ELECTRODES`. Every row sums to zero: no lead sees a common potential.
    """
    ra, la, ll, *chest = np.eye(len(ELECTRODES))
    wilson = (ra + la + ll) / 3
    limb = [la - ra, ll - ra, ll - la]
    augmented = [ra - (la + ll) / 2, la - (ra + ll) / 2, ll - (ra + la) / 2]
    return np.array([*limb, *augmented, *(electrode - wilson for electrode in chest)])
