"""Straight ways from the endocardia, traced once per heart."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fascicle.kernels.arrays import FACES, Mesh, Table, Ways
from fascicle.kernels.ray_travel_times import POINTS, locate, to_sites, to_vertices, trace_ways

FURTHEST = 20.0  # mm: what is further is left to the elements
LONGEST = 50.0  # ms, likewise
# Bounds of the table, which reaches less far where it would have more ways: for each vertex of the
# mesh, for the time it takes to trace them; and in all, for the memory (28 bytes each)
WAYS_PER_VERTEX = 150
MOST = 8_000_000
SAMPLE = 500  # triangles that tell how many ways there will be
CHUNK = 1024  # triangles worked on at a time, which bounds the memory
PATIENCE = 1.0  # s without a word

# Told how many of how many triangles are done
Told = Callable[[int, int], None]


def build_table(
    mesh: Mesh,
    surface: NDArray[np.int64],
    owner: NDArray[np.int64],
    triangles: NDArray[np.int64],
    progress: Told | None = None,
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
    progress : callable, optional
        Told how far this is, once it is clear that it takes a while.
    """
    missing = ~(mesh.corners[owner][:, :, None] == surface[:, None, :]).any(axis=2)
    opposite = missing.argmax(axis=1)
    vertices = KDTree(mesh.vertices)
    centres = mesh.vertices[surface[triangles]].mean(axis=1)
    reach = _how_far(centres, vertices)
    sizes, found = [np.zeros(1, np.int64)], [np.empty(0, np.int32)]
    squares = [np.empty((0, len(POINTS)), np.float32)]
    begin = time.monotonic()
    for first in range(0, len(triangles), CHUNK):
        chunk = triangles[first : first + CHUNK]
        size, vertex, square = _rows(mesh, owner[chunk], opposite[chunk], vertices, reach)
        sizes.append(size)
        found.append(vertex)
        squares.append(square)
        if progress is not None and time.monotonic() - begin > PATIENCE:
            progress(first + len(chunk), len(triangles))
    row = np.full(len(surface), -1, dtype=np.int32)
    row[triangles] = np.arange(len(triangles))
    start = np.cumsum(np.concatenate(sizes))
    return Table(
        row,
        opposite.astype(np.int8),
        start,
        np.concatenate(found),
        np.concatenate(squares),
        reach,
        LONGEST,
    )


def _how_far(centres: NDArray[np.float64], vertices: KDTree) -> float:
    """How far the table reaches (mm), given the triangles' centres."""
    some = centres[:: max(1, len(centres) // SAMPLE)]
    most, reach = min(MOST, WAYS_PER_VERTEX * vertices.n), FURTHEST
    for _ in range(3 if len(some) else 0):  # a wall is neither a ball nor flat
        around = vertices.query_ball_point(some, reach, return_length=True)
        ways = len(centres) * float(np.mean(around))
        reach *= float(np.cbrt(min(1.0, most / max(ways, 1.0))))
    return reach


def _rows(
    mesh: Mesh,
    elements: NDArray[np.int64],
    opposite: NDArray[np.int64],
    vertices: KDTree,
    reach: float,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Rows of the table for the faces opposite a corner of some elements.

    How many vertices each has, which, and the squares. A vertex that not all six points have a way
    to is left out, and so are the element's own corners, the ways to which are exact without it.
    """
    at = mesh.vertices[mesh.corners[elements[:, None], FACES[opposite]]]
    pairs = KDTree(at.mean(axis=1)).sparse_distance_matrix(vertices, reach, output_type="ndarray")
    order = np.lexsort((pairs["j"], pairs["i"]))
    row, vertex = pairs["i"][order], pairs["j"][order].astype(np.int32)
    start = np.searchsorted(row, np.arange(len(elements) + 1))
    square = np.full((len(vertex), len(POINTS)), np.inf)
    trace_ways(POINTS @ at, elements, start, vertex, LONGEST, mesh, square)
    known = np.isfinite(square).all(axis=1)
    known &= (vertex[:, None] != mesh.corners[elements[row]]).all(axis=1)
    size = np.bincount(row[known], minlength=len(elements))
    return size, vertex[known], square[known].astype(np.float32)


class Around(NamedTuple):
    """What is around sites.

    Attributes
    ----------
    barycentric : (j, 4) array
        Barycentric coordinates of each in its tetrahedron.
    to_corner : (j, 4) array
        Squared travel times (ms²) to its corners.
    near : Ways
        To the vertices around.
    """

    barycentric: NDArray[np.float64]
    to_corner: NDArray[np.float64]
    near: Ways

    def joined_with(self, other: Around) -> Around:
        """These sites and, after them, the others."""
        one, two = self.near, other.near
        near = Ways(
            np.concatenate([one.start, one.start[-1] + two.start[1:]]),
            np.concatenate([one.target, two.target]),
            np.concatenate([one.time, two.time]),
        )
        return Around(
            np.concatenate([self.barycentric, other.barycentric]),
            np.concatenate([self.to_corner, other.to_corner]),
            near,
        )


def look_around(
    positions: NDArray[np.float64],
    elements: NDArray[np.int64],
    triangles: NDArray[np.int64] | None,
    mesh: Mesh,
    table: Table,
) -> Around:
    """Find the straight ways from sites to the vertices around them.

    Parameters
    ----------
    positions, elements : (j, 3) and (j,) arrays
        Where the sites lie (mm), and the tetrahedron of each, -1 where there is none.
    triangles : (j,) array or None
        The boundary triangle that each lies in: ways are read from the table, and traced as far as
        it reaches where it does not have the triangle. Without: all are traced, to every vertex.
    mesh, table : Mesh, Table
        The myocardium, and the straight ways from its endocardia.
    """
    count = len(elements)
    barycentric, to_corner = np.zeros((count, 4)), np.full((count, 4), np.inf)
    locate(positions, elements, mesh, barycentric, to_corner)
    rows, opposite = np.full(count, -1, np.int32), np.zeros(count, np.int8)
    reach = longest = np.inf
    if triangles is not None:
        rows, opposite = table.row[triangles], table.opposite[triangles]
        reach, longest = table.reach, table.longest
    room = np.where(rows >= 0, table.start[rows + 1] - table.start[rows], len(mesh.vertices))
    off = np.flatnonzero((rows < 0) & (elements >= 0))
    if off.size and reach < np.inf:
        room[off] = KDTree(mesh.vertices).query_ball_point(
            positions[off], reach * (1 + 1e-9), return_length=True
        )
    ways = _room(count, int((room + 4)[elements >= 0].sum()))
    to_vertices(
        positions, elements, rows, opposite, barycentric, to_corner, mesh, table, reach, longest,
        ways,
    )  # fmt: skip
    return Around(barycentric, to_corner, _used(ways))


def look_beside(
    positions: NDArray[np.float64], elements: NDArray[np.int64], around: Around, mesh: Mesh
) -> Ways:
    """Find the straight ways from sites to the other sites around them.

    Parameters
    ----------
    positions, elements : (j, 3) and (j,) arrays
        Where the sites lie (mm), and the tetrahedron of each, -1 where there is none.
    around : Around
        What is around them.
    mesh : Mesh
        The myocardium.
    """
    vertices, attached = len(mesh.vertices), np.flatnonzero(elements >= 0)
    first_start, order = grouped(mesh.corners[elements[attached], 0], vertices)
    ways = _room(len(elements), int(np.diff(first_start)[around.near.target].sum()))
    to_sites(
        positions, elements, around.barycentric, around.to_corner, first_start, attached[order],
        mesh, around.near, np.full(vertices, np.inf), ways,
    )  # fmt: skip
    return _used(ways)


def _room(sites: int, most: int) -> Ways:
    return Ways(np.empty(sites + 1, np.int64), np.empty(most, np.int32), np.empty(most))


def _used(ways: Ways) -> Ways:
    used = ways.start[-1]
    return Ways(ways.start, ways.target[:used], ways.time[:used])


def grouped(groups: NDArray[np.integer], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sort items by their group; those of one group stay in the order in which they came.

    Parameters
    ----------
    groups : (n,) array
        The group of each item.
    count : int
        How many groups there are.

    Returns
    -------
    start, order : (count + 1,) and (n,) arrays
        Where each group starts in the order, and the order.
    """
    sizes = np.bincount(groups, minlength=count)
    return np.concatenate([[0], np.cumsum(sizes)]), np.argsort(groups, kind="stable")
