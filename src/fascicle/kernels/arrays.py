"""The arrays that the coupled sweep works on, bundled by what they describe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# The corners of a tetrahedron's faces, in ascending order: of the one opposite each corner
FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


class Mesh(NamedTuple):
    """The conducting myocardium; elements that do not conduct are in no list.

    Attributes
    ----------
    vertices : (n, 3) array
        Positions (mm).
    corners : (m, 4) array
        Vertices of each tetrahedron.
    cells : (m, 24) array
        What a ray needs of each tetrahedron, in three cache lines: the barycentric coordinates as
        affine functions (columns 0-3, 4-7 and 8-11: the components of their gradients, 1/mm;
        12-15: their values at the origin), D⁻¹ (16-21: xx, yy, zz, xy, xz, yz, ms²/mm²), and in
        the rest, seen through `across`, its neighbours.
    across : (m, 48) array
        The memory of `cells` as whole numbers; columns 44-47 are the tetrahedra across the faces
        opposite each corner, -1 where no conducting one is.
    solver : (m, 12) array
        What the local solver needs of each: the products ∇λᵢ·D∇λⱼ (1/ms²) of its corners'
        barycentric coordinates for the pairs 01, 02, 03, 12, 13, 23, and the squared travel times
        (ms²) along those edges.
    star_start, star : (n + 1,) and (4m, 4) arrays
        The tetrahedra of each vertex: the other three corners, in ascending order of their place
        in the tetrahedron, and 4·tetrahedron + the vertex's own place.
    least : (4m,) array
        By how much (ms) any of the other corners is at least later than the vertex if the front
        comes to it through the vertex and the rest of the opposite face; may be negative.
    link_start, link, link_time : (n + 1,), (l,) and (l,) arrays
        The vertices that share an edge with each vertex, and the travel times to them (ms).
    slowness : float
        Least travel time over distance anywhere (ms/mm).
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int32]
    cells: NDArray[np.float64]
    across: NDArray[np.int32]
    solver: NDArray[np.float64]
    star_start: NDArray[np.int64]
    star: NDArray[np.int32]
    least: NDArray[np.float32]
    link_start: NDArray[np.int64]
    link: NDArray[np.int32]
    link_time: NDArray[np.float64]
    slowness: float

    @property
    def metric(self) -> NDArray[np.float64]:
        """D⁻¹ of each tetrahedron (ms²/mm²), shape (m, 3, 3)."""
        return self.cells[:, [16, 19, 20, 19, 17, 21, 20, 21, 18]].reshape(-1, 3, 3)


class Table(NamedTuple):
    """Straight ways from the triangles of the endocardia to the vertices around them.

    Attributes
    ----------
    row : (b,) array
        Row of each boundary triangle, -1 for those that have none.
    opposite : (b,) array
        The corner of its tetrahedron that each triangle does not have.
    start, vertex : (r + 1,) and (p,) arrays
        The vertices in each row.
    square : (p, 6) array
        Squared travel times (ms²) to each, from the points
        `fascicle.kernels.ray_travel_times.POINTS`.
    reach, longest : float
        How far (mm) and how long (ms) ways are.
    """

    row: NDArray[np.int32]
    opposite: NDArray[np.int8]
    start: NDArray[np.int64]
    vertex: NDArray[np.int32]
    square: NDArray[np.float32]
    reach: float
    longest: float


class Forest(NamedTuple):
    """All trees as one graph; a stimulus in the myocardium is a tree of one node.

    Attributes
    ----------
    order : (k,) array
        The nodes, each after its parent.
    parent, time : (k,) arrays
        Parent of each node, -1 at a root, and the travel time from it (ms; inf where blocked).
    child_start, child : (k + 1,) and (c,) arrays
        Children of each node.
    site : (k,) array
        Number of the site at each node, or -1.
    """

    order: NDArray[np.int64]
    parent: NDArray[np.int64]
    time: NDArray[np.float64]
    child_start: NDArray[np.int64]
    child: NDArray[np.int64]
    site: NDArray[np.int64]


class Ways(NamedTuple):
    """Straight ways from each site to what is around it.

    Attributes
    ----------
    start, target, time : (j + 1,), (p,) and (p,) arrays
        Where each site's ways start in the lists, where they lead, and how long they take (ms).
    """

    start: NDArray[np.int64]
    target: NDArray[np.int32]
    time: NDArray[np.float64]


class Sites(NamedTuple):
    """Where trees (and stimuli) meet the myocardium.

    Attributes
    ----------
    element : (j,) array
        Tetrahedron of each; -1 where a site meets no conducting tissue.
    to_corner : (j, 4) array
        Squared travel times (ms²) to its corners.
    node : (j,) array
        Tree node of each.
    orthodromic, antidromic : (j,) arrays
        Delays (ms) from tree to myocardium and back; inf where there is no way.
    reader_start, reader : (n + 1,) and (4j,) arrays
        The sites whose element has each vertex as a corner.
    near, beside : Ways
        To the vertices around each site, and to the other sites.
    """

    element: NDArray[np.int64]
    to_corner: NDArray[np.float64]
    node: NDArray[np.int64]
    orthodromic: NDArray[np.float64]
    antidromic: NDArray[np.float64]
    reader_start: NDArray[np.int64]
    reader: NDArray[np.int64]
    near: Ways
    beside: Ways


class Queue(NamedTuple):
    """Room for the nodes that wait to be taken.

    Attributes
    ----------
    heap : (n + k,) array
        Anything.
    place : (n + k,) array
        -1: where in the heap each node is.
    """

    heap: NDArray[np.int64]
    place: NDArray[np.int64]
