"""Lengths, areas, normals and volumes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fascicle.mesh.topology import boundary_loops


def triangle_normals(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Give normals whose length is the triangle's area, shape (m, 3)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a) / 2)


def enclosed_volume(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """Signed volume of an open surface closed by a fan over its opening (mm³).

    Negative where the normals point into the cavity, as an `Endocardium`'s do.
    """
    loop = vertices[boundary_loops(triangles)[0]]
    centred = vertices - loop.mean(axis=0)  # the fan's triangles then contribute nothing
    a, b, c = (centred[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def signed_volumes(
    vertices: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Signed volume of each tetrahedron, shape (m,)."""
    origin, a, b, c = (vertices[tetrahedra[:, k]] for k in range(4))
    return np.asarray(
        np.einsum("ij,ij->i", a - origin, np.cross(b - origin, c - origin)) / 6, dtype=float
    )
