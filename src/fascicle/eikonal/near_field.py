"""Straight ways from the endocardia, traced once per heart."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fascicle.kernels.arrays import Mesh, Table
from fascicle.kernels.near import POINTS, locate, to_sites, to_vertices, trace_ways

EDGES_FAR = 4.0  # how far the table reaches, in edges of the mesh
FURTHEST = 20.0  # mm, but no further than this
LONGEST = 40.0  # ms: what is further in time is left to the elements


def build_table(
    mesh: Mesh,
    surface: NDArray[np.int64],
    owner: NDArray[np.int64],
    triangles: NDArray[np.int64],
    edge_length: float,
) -> Table:
    """Trace the straight ways from boundary triangles to the vertices around them.

    Parameters
    ----------
    mesh : Mesh
        The myocardium.
    surface, owner : (b, 3) and (b,) arrays
        Its boundary triangles, and the tetrahedron of each.
    triangles : (r,) array
        Those from which ways are wanted.
    edge_length : float
        Mean edge of the mesh (mm).
    """
    missing = ~(mesh.corners[owner][:, :, None] == surface[:, None, :]).any(axis=2)
    opposite = missing.argmax(axis=1)
    elements = owner[triangles]
    of_face = np.array([[c for c in range(4) if c != skip] for skip in range(4)])
    corners = mesh.corners[elements[:, None], of_face[opposite[triangles]]]
    at = mesh.vertices[corners]
    reach = min(EDGES_FAR * edge_length, FURTHEST)
    around = KDTree(mesh.vertices).query_ball_point(at.mean(axis=1), reach, return_sorted=True)
    sizes = np.array([len(found) for found in around], dtype=np.int64)
    start = np.concatenate([[0], np.cumsum(sizes)])
    vertex = np.concatenate([*around, []]).astype(np.int32)
    square = np.full((len(vertex), len(POINTS)), np.inf)
    trace_ways(POINTS @ at, elements, start, vertex, LONGEST, mesh, square)
    known = np.isfinite(square).all(axis=1)
    row = np.repeat(np.arange(len(triangles)), sizes)
    known &= (vertex[:, None] != mesh.corners[elements[row]]).all(axis=1)  # exact without it
    row_of = np.full(len(surface), -1, dtype=np.int32)
    row_of[triangles] = np.arange(len(triangles))
    kept = np.bincount(row[known], minlength=len(triangles))
    return Table(
        row_of,
        opposite.astype(np.int8),
        np.concatenate([[0], np.cumsum(kept)]),
        vertex[known],
        square[known].astype(np.float32),
    )


def surround(
    positions: NDArray[np.float64],
    elements: NDArray[np.int64],
    triangles: NDArray[np.int64],
    mesh: Mesh,
    table: Table,
) -> tuple[NDArray[Any], ...]:
    """The straight ways from sites to the vertices and the other sites around them.

    Parameters
    ----------
    positions, elements, triangles : (j, 3), (j,) and (j,) arrays
        Where the sites lie (mm), the tetrahedron of each (-1 where there is none), and the
        boundary triangle (-1 inside the tissue).
    mesh, table : Mesh, Table
        The myocardium, and the straight ways from its endocardia.

    Returns
    -------
    to_corner, near_start, near, near_way, beside_start, beside, beside_way
        See `fascicle.kernels.arrays.Sites`.
    """
    count, vertices = len(elements), len(mesh.vertices)
    share, to_corner = np.zeros((count, 4)), np.full((count, 4), np.inf)
    locate(positions, elements, mesh, share, to_corner)
    rows = np.where(triangles >= 0, table.row[triangles], -1)
    rows[elements < 0] = -1
    room = np.where(rows >= 0, table.start[rows + 1] - table.start[rows], vertices) + 4
    most = int(room[elements >= 0].sum())
    start, near, way = np.empty(count + 1, np.int64), np.empty(most, np.int32), np.empty(most)
    to_vertices(positions, elements, rows, table.opposite[triangles], share, to_corner, mesh, table,
                start, near, way)  # fmt: skip
    near, way = near[: start[-1]], way[: start[-1]]
    attached = np.flatnonzero(elements >= 0)
    first_start, first = grouped(mesh.corners[elements[attached], 0], vertices)
    first = attached[first]
    most = int(np.diff(first_start)[near].sum())
    beside_start = np.empty(count + 1, np.int64)
    beside, beside_way = np.empty(most, np.int32), np.empty(most)
    to_sites(elements, share, to_corner, first_start, first, mesh, start, near, way,
             np.full(vertices, np.inf), beside_start, beside, beside_way)  # fmt: skip
    most = beside_start[-1]
    return to_corner, start, near, way, beside_start, beside[:most], beside_way[:most]


def grouped(groups: NDArray[np.integer], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each of `count` groups starts among the items in the order of their groups; that order.

    Items of one group stay in the order in which they came.
    """
    sizes = np.bincount(groups, minlength=count)
    return np.concatenate([[0], np.cumsum(sizes)]), np.argsort(groups, kind="stable")
