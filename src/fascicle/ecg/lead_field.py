"""Lead fields: the potential in the heart for unit current through an electrode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MM_PER_CM = 10.0


def unbounded(
    points: NDArray[np.float64], electrodes: NDArray[np.float64], conductivity: float
) -> NDArray[np.float64]:
    """Z = 1/(4πσr), the lead field of an unbounded homogeneous conductor.

    Parameters
    ----------
    points : (n, 3) array
        Where (mm).
    electrodes : (e, 3) array
        Positions (mm).
    conductivity : float
        σ (mS/cm).

    Returns
    -------
    (e, n) array
        Potential for unit current (mV/µA, that is kΩ).
    """
    distance = np.linalg.norm(electrodes[:, None, :] - points[None, :, :], axis=2) / MM_PER_CM
    return np.asarray(1 / (4 * np.pi * conductivity * distance))
