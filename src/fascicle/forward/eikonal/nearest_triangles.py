"""Boundary triangles of the tissue that can be nearest to a point of an endocardium."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from scipy.spatial import KDTree

from fascicle.core.arrays import Floats, Integers


class Candidates(NamedTuple):
    """Boundary triangles that can be nearest to each triangle of an endocardium.

    Attributes
    ----------
    start : (m + 1,) array
        Where the candidates of each triangle begin in the list.
    triangle, least : (c,) arrays
        The list, and a lower bound of the distance of each from its ball's centre (mm), ascending.
    centre, square : (m, 3) and (m,) arrays
        A ball around each triangle: its centre (mm) and its squared radius (mm²). The boundary
        triangle nearest to any point of the ball is among the candidates.
    """

    start: Integers
    triangle: Integers
    least: Floats
    centre: Floats
    square: Floats


def find_candidates(
    triangles: Floats, vertices: Floats, surface: Integers, tree: igl.AABB
) -> Candidates:
    """Find the boundary triangles that can be nearest to points of an endocardium.

    With a triangle in a ball of radius r, and the surface at a distance d from the centre, the
    surface point nearest to any point of the ball is d + 2r from the centre at most.

    Parameters
    ----------
    triangles : (m, 3, 3) array
        Corners of the endocardium's triangles (mm).
    vertices, surface : (v, 3) and (b, 3) arrays
        The tissue's boundary.
    tree : igl.AABB
        Finds its nearest triangle.
    """
    centres, radii = _balls(triangles)
    surface_centres, surface_radii = _balls(vertices[surface])
    square, _, _ = tree.squared_distance(vertices, surface, centres)
    a_little, chunk = 1 + 1e-9, 1 << 12  # more than rounding; triangles at a time, for memory
    radii *= a_little
    reach = (np.sqrt(square) + 2 * radii) * a_little
    surface_tree, candidates = KDTree(surface_centres), []
    for first in range(0, len(centres), chunk):
        part = slice(first, first + chunk)
        around = surface_tree.query_ball_point(centres[part], reach[part] + surface_radii.max())
        for centre, near, far in zip(
            centres[part], map(np.array, around), reach[part], strict=True
        ):
            least = np.linalg.norm(surface_centres[near] - centre, axis=1) - surface_radii[near]
            order = np.argsort(least, kind="stable")
            order = order[: np.searchsorted(least[order], far, "right")]
            candidates.append((near[order], least[order]))
    triangle, least = (np.concatenate(parts) for parts in zip(*candidates, strict=True))
    start = np.cumsum([0, *(len(numbers) for numbers, _ in candidates)])
    return Candidates(start, triangle, least, centres, radii**2)


def _balls(triangles: Floats) -> tuple[Floats, Floats]:
    """Centres and radii of balls around triangles (m, 3, 3)."""
    centres = triangles.mean(axis=1)
    return centres, np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)
