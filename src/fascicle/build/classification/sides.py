"""Which of two endocardia is the left one."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from fascicle.mesh.measures import triangle_normals

Part = tuple[NDArray[np.float64], NDArray[np.int64]]

FREE_WALL = 40.0  # percentile of the distances to the epicardium that stands for the free wall


def leftness(one: Part, other: Part, epicardium: Part) -> float:
    """How much rather the first of two endocardia is the left one than the second.

    The left cavity is nearly convex and round, and its wall is thick; the right one is a crescent
    about the septum with a thin free wall. The logarithms of the three ratios, each of which
    speaks for the left where it is larger, are added.

    Parameters
    ----------
    one, other, epicardium : pair of (n, 3) and (m, 3) arrays
        Vertices (mm) and triangles of surfaces that are open at the base.

    Returns
    -------
    float
        Positive where the first one is the left one.
    """
    features = [np.array([*cavity_shape(*part), _wall(part, epicardium)]) for part in (one, other)]
    return float(np.log(features[0] / features[1]).sum())


def cavity_volume(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """Volume between an open surface and a fan over its rims (mm³), whatever its orientation."""
    return _capped(vertices, triangles)[0]


def cavity_shape(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[float, float]:
    """Share of the convex hull that a cavity fills, and 36πV²/A³ (1 for a ball)."""
    volume, cap = _capped(vertices, triangles)
    hull = ConvexHull(vertices[np.unique(triangles)]).volume
    area = np.linalg.norm(triangle_normals(vertices, triangles), axis=1).sum() + cap
    return volume / float(hull), 36 * np.pi * volume**2 / float(area) ** 3


def _capped(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> tuple[float, float]:
    """Volume of an open surface closed by a fan about its rim's centre (mm³), fan's area (mm²)."""
    rim = np.asarray(igl.boundary_facets(triangles)[0], dtype=np.int64)
    centred = vertices - vertices[np.unique(rim)].mean(axis=0)
    a, b, c = (centred[triangles[:, k]] for k in range(3))
    volume = abs(float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6))
    fan = np.cross(centred[rim[:, 0]], centred[rim[:, 1]]) / 2
    return volume, float(np.linalg.norm(fan, axis=1).sum())


def _wall(part: Part, epicardium: Part) -> float:
    """Thickness of the free wall (mm)."""
    points = np.ascontiguousarray(part[0][np.unique(part[1])])
    squared = igl.point_mesh_squared_distance(points, *epicardium)[0]
    return float(np.sqrt(np.percentile(squared, FREE_WALL)))
