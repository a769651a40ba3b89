"""Lead fields: the potential in the heart for unit current through an electrode."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.measures import HAMMER_STROUD_POINTS

MM_PER_CM = 10.0


def unbounded_gradients(
    vertices: Floats, corners: Integers, electrodes: Floats, conductivity: float
) -> Floats:
    """Mean over each element of ∇Z = −r/(4πσ|r|³), r from the electrode, by quadrature.

    (e, m, 3) (kΩ/mm), for electrodes (e, 3) (mm) and a conductivity σ (mS/cm). Far closer than the
    gradient of the interpolated Z, which in a flat element can be wrong by half.
    """
    # (q, 3, m), so that sums run along whole rows
    points = np.ascontiguousarray(np.moveaxis(HAMMER_STROUD_POINTS @ vertices[corners], 0, 2))
    gradients = np.empty((len(electrodes), len(corners), 3))
    for electrode, gradient in zip(electrodes, gradients, strict=True):
        towards = electrode[:, None] - points
        towards /= np.sqrt((towards * towards).sum(axis=1, keepdims=True)) ** 3
        gradient[:] = towards.mean(axis=0).T
    return gradients * MM_PER_CM / (4 * np.pi * conductivity)


def nodal_gradients(lead_fields: Floats, corners: Integers, gradients: Floats) -> Floats:
    """∇Z (e, m, 3) (kΩ/mm) of lead fields (e, n) (kΩ) at the vertices, linear in each element.

    `corners` (m, 4) are the vertices of each tetrahedron, `gradients` (m, 4, 3) those of its
    barycentric coordinates (1/mm).
    """
    return np.asarray(np.einsum("emk,mki->emi", lead_fields[:, corners], gradients))
