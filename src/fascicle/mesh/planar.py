"""Triangles between closed lines in a plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.topology import unique_edges


def best_plane(points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Centre (3,) of points (n, 3) with weights (n,), and the axes (3, 3) of their best plane.

    The axes are rows, the normal last.
    """
    centre = weights @ points / weights.sum()
    spread = np.sqrt(weights)[:, np.newaxis] * (points - centre)
    return centre, np.linalg.svd(spread, full_matrices=False)[2]


def constrained_delaunay(places: Floats, loops: Sequence[Integers]) -> tuple[Integers, Integers]:
    """Triangulate what lies between closed lines, whose sides are kept, by VTK.

    Parameters
    ----------
    places : (n, 2) array
        Points in the plane.
    loops : sequence of (k,) arrays
        The points along each line, the outermost line first.

    Returns
    -------
    triangles : (m, 3) array
        Indices of the points.
    missing : (s,) array
        First points of the sides that are no edge of the boundary. Unless it is empty, lines cross
        or touch, and the triangles are of no use.
    """
    import pyvista as pv

    points = np.column_stack([places, np.zeros(len(places))])
    faces: list[int] = []
    for k, loop in enumerate(loops):
        x, y = places[loop].T
        counter_clockwise = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) > 0
        # VTK fills what lies to the left of a line
        faces += [len(loop), *(loop if counter_clockwise == (k == 0) else loop[::-1])]
    with pv.vtk_verbosity("off"):
        mesh = pv.PolyData(points).delaunay_2d(edge_source=pv.PolyData(points, faces=faces))
    triangles = np.asarray(mesh.regular_faces, dtype=np.int64)
    edges, shared = unique_edges(triangles)
    boundary = set(map(tuple, edges[shared == 1].tolist()))
    starts = np.concatenate(loops)
    sides = np.column_stack([starts, np.concatenate([np.roll(loop, -1) for loop in loops])])
    kept = np.array([tuple(side) in boundary for side in np.sort(sides, axis=1).tolist()])
    return triangles, starts if len(boundary) > len(sides) else starts[~kept]
