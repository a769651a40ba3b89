"""Straight ways from the endocardia, traced once per heart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fascicle.kernels.arrays import Mesh, Table, Ways
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


class Around(NamedTuple):
    """What is around sites.

    Attributes
    ----------
    share : (j, 4) array
        Barycentric coordinates of each in its tetrahedron.
    to_corner : (j, 4) array
        Squared travel times (ms²) to its corners.
    near : Ways
        To the vertices around.
    """

    share: NDArray[np.float64]
    to_corner: NDArray[np.float64]
    near: Ways

    def and_then(self, other: Around) -> Around:
        """These sites and, after them, the others."""
        one, two = self.near, other.near
        near = Ways(
            np.concatenate([one.start, one.start[-1] + two.start[1:]]),
            np.concatenate([one.target, two.target]),
            np.concatenate([one.time, two.time]),
        )
        return Around(
            np.concatenate([self.share, other.share]),
            np.concatenate([self.to_corner, other.to_corner]),
            near,
        )


def look_around(
    positions: NDArray[np.float64],
    elements: NDArray[np.int64],
    triangles: NDArray[np.int64],
    mesh: Mesh,
    table: Table,
) -> Around:
    """Find the straight ways from sites to the vertices around them.

    They are read from the table where it has the triangle, and traced to all vertices else.

    Parameters
    ----------
    positions, elements, triangles : (j, 3), (j,) and (j,) arrays
        Where the sites lie (mm), the tetrahedron of each (-1 where there is none), and the
        boundary triangle (-1 inside the tissue).
    mesh, table : Mesh, Table
        The myocardium, and the straight ways from its endocardia.
    """
    count, vertices = len(elements), len(mesh.vertices)
    share, to_corner = np.zeros((count, 4)), np.full((count, 4), np.inf)
    locate(positions, elements, mesh, share, to_corner)
    rows = np.where((triangles >= 0) & (elements >= 0), table.row[triangles], -1)
    room = np.where(rows >= 0, table.start[rows + 1] - table.start[rows], vertices) + 4
    ways = _room(count, int(room[elements >= 0].sum()))
    to_vertices(
        positions, elements, rows, table.opposite[triangles], share, to_corner, mesh, table, ways
    )
    return Around(share, to_corner, _used(ways))


def look_beside(elements: NDArray[np.int64], around: Around, mesh: Mesh) -> Ways:
    """Find the straight ways from sites to the other sites around them.

    Parameters
    ----------
    elements : (j,) array
        The tetrahedron of each site, -1 where there is none.
    around : Around
        What is around them.
    mesh : Mesh
        The myocardium.
    """
    vertices, attached = len(mesh.vertices), np.flatnonzero(elements >= 0)
    first_start, order = grouped(mesh.corners[elements[attached], 0], vertices)
    ways = _room(len(elements), int(np.diff(first_start)[around.near.target].sum()))
    to_sites(
        elements, around.share, around.to_corner, first_start, attached[order], mesh, around.near,
        np.full(vertices, np.inf), ways,
    )  # fmt: skip
    return _used(ways)


def _room(sites: int, most: int) -> Ways:
    return Ways(np.empty(sites + 1, np.int64), np.empty(most, np.int32), np.empty(most))


def _used(ways: Ways) -> Ways:
    used = ways.start[-1]
    return Ways(ways.start, ways.target[:used], ways.time[:used])


def grouped(groups: NDArray[np.integer], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each of `count` groups starts among the items in the order of their groups; that order.

    Items of one group stay in the order in which they came.
    """
    sizes = np.bincount(groups, minlength=count)
    return np.concatenate([[0], np.cumsum(sizes)]), np.argsort(groups, kind="stable")
