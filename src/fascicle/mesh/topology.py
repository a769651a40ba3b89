"""Connections between vertices, edges, triangles and tetrahedra."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers

# Corners of the face opposite each corner of a tetrahedron, counter-clockwise seen from outside
TETRAHEDRON_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
TETRAHEDRON_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])


def directed_edges(triangles: Integers) -> Integers:
    """Edges of triangles (m, 3) as each runs around it, shape (3m, 2)."""
    return np.asarray(triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2))


def unique_edges(triangles: Integers) -> tuple[Integers, Integers]:
    """Edges (e, 2) of triangles (m, 3), and how many triangles share each (e,).

    Edges are sorted, their smaller vertex first.
    """
    return np.unique(np.sort(directed_edges(triangles), axis=1), axis=0, return_counts=True)


def boundary_loops(triangles: Integers) -> list[Integers]:
    """Boundary loops of a surface, each in the direction of its triangles' edges."""
    return [np.asarray(loop, dtype=np.int64) for loop in igl.boundary_loop_all(triangles)]


def fan(loop: Integers, centre: int) -> Integers:
    """Triangles (k, 3) from a boundary loop (k,) to a vertex, which continue its surface."""
    # the loop runs along the surface's edges, so the fan's edges run against it
    return np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), centre)])


def boundary_triangles(tetrahedra: NDArray[np.integer]) -> tuple[Integers, Integers]:
    """Triangles (b, 3) that belong to one tetrahedron only, and that tetrahedron (b,).

    Seen from outside they run counter-clockwise, if the tetrahedra are positively oriented.
    """
    triangles, owner, _ = igl.boundary_facets(tetrahedra.astype(np.int64))
    return np.asarray(triangles, dtype=np.int64), np.asarray(owner, dtype=np.int64)


def faces_in_order(tetrahedra: Integers) -> tuple[Integers, Booleans]:
    """Faces of tetrahedra (m, 4), equal ones adjacent, and a mask of those equal to the next.

    A face's number is 4 times its tetrahedron's, plus the corner opposite. Shapes are (4m,) and
    (4m - 1,).
    """
    faces = np.sort(tetrahedra[:, TETRAHEDRON_FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    return order, (faces[order[1:]] == faces[order[:-1]]).all(axis=1)


def interior_edges(triangles: Integers) -> tuple[Integers, Integers]:
    """Edges (e, 2) between two triangles, and these triangles (e, 2)."""
    neighbours, _ = igl.triangle_triangle_adjacency(triangles)
    triangle, side = np.nonzero(np.asarray(neighbours) > np.arange(len(triangles))[:, None])
    across = np.column_stack([triangle, np.asarray(neighbours)[triangle, side]])
    edges = np.column_stack([triangles[triangle, side], triangles[triangle, (side + 1) % 3]])
    return edges.astype(np.int64), across.astype(np.int64)


def without_unused_vertices(vertices: Floats, cells: Integers) -> tuple[Floats, Integers]:
    """Vertices (n, 3) that some cell (m, k) has, in their order, and the cells renumbered."""
    used, renumbered = np.unique(cells, return_inverse=True)
    return vertices[used], renumbered.reshape(cells.shape).astype(np.int64)


def components_of(pairs: Integers, count: int) -> Integers:
    """Component (count,) of each of `count` nodes, from 0, linked by pairs (k, 2)."""
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def pieces_of(tetrahedra: Integers, count: int) -> Integers:
    """Piece (count,) of each of `count` vertices, linked by tetrahedra (m, 4)."""
    return components_of(tetrahedra[:, [(0, 1), (0, 2), (0, 3)]].reshape(-1, 2), count)


def merged_vertices(vertices: Floats, tolerance: float | None = None) -> Integers:
    """For each vertex (n, 3) the first one that it is merged with, shape (n,).

    Vertices within the tolerance (mm), by default a millionth of the largest extent, of one
    another, or linked by others that are, become one.
    """
    if tolerance is None:
        tolerance = 1e-6 * float(np.ptp(vertices, axis=0).max())
    pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    group = components_of(pairs, len(vertices))
    _, first = np.unique(group, return_index=True)
    return np.asarray(first[group], dtype=np.int64)


def whole_triangles(triangles: Integers) -> Booleans:
    """Mask (m,) of triangles (m, 3) with three different corners that repeat no earlier one."""
    corners = np.sort(triangles, axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    is_first = np.zeros(len(triangles), dtype=bool)
    is_first[first] = True
    return np.asarray(is_first & (corners[:, 1:] != corners[:, :-1]).all(axis=1))


def places_in(triangles: Integers, among: Integers) -> Integers:
    """Row of each triangle (m, 3) in `among` (n, 3), in any order of corners; -1 if absent."""
    rows = np.sort(np.concatenate([among, triangles]), axis=1)
    _, number = np.unique(rows, axis=0, return_inverse=True)
    place = np.full(number.max() + 1, -1)
    place[number[: len(among)]] = np.arange(len(among))
    return np.asarray(place[number[len(among) :]])
