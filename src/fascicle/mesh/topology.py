"""Which vertices, edges, triangles and tetrahedra belong together."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray


def boundary_loops(triangles: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Boundary loops of a surface, each in the direction of its triangles' edges."""
    return [np.asarray(loop, dtype=np.int64) for loop in igl.boundary_loop_all(triangles)]


def boundary_triangles(
    tetrahedra: NDArray[np.integer],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (b, 3) that belong to one tetrahedron only, and which one (b,).

    Seen from outside they run counter-clockwise, if the tetrahedra are positively oriented.
    """
    triangles, owner, _ = igl.boundary_facets(tetrahedra.astype(np.int64))
    return np.asarray(triangles, dtype=np.int64), np.asarray(owner, dtype=np.int64)


def interior_edges(
    triangles: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Edges (e, 2) between two triangles, these triangles (e, 2), and each edge's row there."""
    neighbours, _ = igl.triangle_triangle_adjacency(triangles)
    triangle, side = np.nonzero(np.asarray(neighbours) > np.arange(len(triangles))[:, None])
    across = np.column_stack([triangle, np.asarray(neighbours)[triangle, side]])
    edges = np.column_stack([triangles[triangle, side], triangles[triangle, (side + 1) % 3]])
    return edges.astype(np.int64), across.astype(np.int64), side
