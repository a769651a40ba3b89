"""Arrays of the coupled eikonal solver (`fascicle.kernels.coupled`), grouped by what they describe.

To *lower* a node is to replace its arrival time by an earlier one; the *sweep* is the solver's pass
over the queue of lowered nodes. Indices that only the sweep reads are unsigned: with a signed index
Numba would test at every access whether it is negative and counts from the end.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

CACHE_LINE = 64  # bytes

# FACES[i]: corners of a tetrahedron's face opposite to corner i, in ascending order
FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])

CORNERS = 4  # corners of a tetrahedron

# Columns of `EikonalMesh.solver`: six products for the edges 01, 02, 03, 12, 13, 23, and, from
# column SQUARES on, their six squared travel times
SQUARES = 6


class Column(IntEnum):
    """Columns of `EikonalMesh.cells`: the first of each four (one per corner), and those of D⁻¹."""

    GRADIENT_X = 0
    GRADIENT_Y = 4
    GRADIENT_Z = 8
    AT_ORIGIN = 12
    XX = 16
    YY = 17
    ZZ = 18
    XY = 19
    XZ = 20
    YZ = 21


def aligned(array: NDArray[Any]) -> NDArray[Any]:
    """Copy an array so that it begins at a cache line, unless it does already.

    The system allocates large arrays 16 bytes after the beginning of a line, where many rows span
    one line more than necessary.
    """
    if array.ctypes.data % CACHE_LINE == 0:
        return array
    buffer = np.empty(array.nbytes + CACHE_LINE, np.uint8)
    first = -buffer.ctypes.data % CACHE_LINE
    copy = buffer[first : first + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


# An element around a vertex; a, b and c are its other corners, in ascending order of their place in
# it. Fields that the sweep reads together lie together, so that it loads fewer cache lines
STAR = np.dtype(
    [
        # least delay (ms) of each corner after the vertex, if the front reaches the corner through
        # the face that the vertex forms with the two others; may be negative
        ("least_a", np.float32),
        ("least_b", np.float32),
        ("least_c", np.float32),
        ("item", np.uint32),  # CORNERS * tetrahedron + the vertex's own place in it
        # index of each corner among the neighbours of the vertex in `EikonalMesh.link`
        ("a", np.uint16),
        ("b", np.uint16),
        ("c", np.uint16),
    ]
)

# A vertex that shares an edge with another one, and the travel time between them (ms)
LINK = np.dtype([("time", np.float64), ("vertex", np.uint32)])


class EikonalMesh(NamedTuple):
    """Mesh of the myocardium; its lists leave out elements that do not conduct.

    Attributes
    ----------
    vertices, corners : (n, 3) and (m, 4) arrays
        Positions (mm), and the vertices of each tetrahedron.
    cells : (m, 22) array
        What a ray needs of each tetrahedron: the barycentric coordinates as affine functions
        (components of their gradients, 1/mm, and values at the origin) and D⁻¹ (ms²/mm²).
    neighbours : (m, 4) array
        The tetrahedra across the faces opposite each corner, -1 where no conducting one is.
    solver : (m, 12) array
        What the local solver needs of each: the products ∇λᵢ·D∇λⱼ (1/ms²) of the barycentric
        coordinates for each pair of corners, and the squared travel times (ms²) along those edges.
    star_start, star : (n + 1,) array, and (4m,) array of STAR
        The elements around each vertex.
    link_start, link : (n + 1,) array, and (l,) array of LINK
        The vertices that share an edge with each vertex.
    slowness : float
        Least travel time over distance anywhere (ms/mm).
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int32]
    cells: NDArray[np.float64]
    neighbours: NDArray[np.int32]
    solver: NDArray[np.float64]
    star_start: NDArray[np.int64]
    star: NDArray[np.void]
    link_start: NDArray[np.int64]
    link: NDArray[np.void]
    slowness: float

    @property
    def metric(self) -> NDArray[np.float64]:
        """D⁻¹ of each tetrahedron (ms²/mm²), shape (m, 3, 3)."""
        columns = Column.XX + np.array([0, 3, 4, 3, 1, 5, 4, 5, 2])
        return self.cells[:, columns].reshape(-1, 3, 3)


class TravelTimeTable(NamedTuple):
    """Ray travel times from the triangles of the endocardia to the vertices around them.

    Attributes
    ----------
    row, opposite : (b,) arrays
        Row of each boundary triangle, -1 without one, and the corner of its tetrahedron that is
        opposite to it.
    start, vertex : (r + 1,) and (p,) arrays
        The vertices in each row.
    square : (p, 6) array
        Squared travel times (ms²) to each, from `fascicle.kernels.ray_travel_times.POINTS`.
    reach, longest : float
        Greatest length (mm) and travel time (ms) of a ray.
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

    The roots of the Purkinje trees are children of the last node, the His bundle.

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


class RayTravelTimes(NamedTuple):
    """Travel times along rays, straight lines from each site to vertices or sites around it.

    Attributes
    ----------
    start, target, time : (j + 1,), (p,) and (p,) arrays
        Rows of each site's rays (`start[k]` to `start[k + 1]`), the vertex or site at the end of
        each ray, and its travel time (ms).
    """

    start: NDArray[np.int64]
    target: NDArray[np.int32]
    time: NDArray[np.float64]


class JunctionSites(NamedTuple):
    """Sites where trees (and stimuli) meet the myocardium.

    Attributes
    ----------
    element, to_corner : (j,) and (j, 4) arrays
        Tetrahedron of each site, -1 without one, and squared travel times (ms²) to its corners.
    node : (j,) array
        Tree node of each site.
    anterograde, retrograde : (j,) arrays
        Delays (ms) from tree to myocardium and back; inf where nothing passes.
    reader_start, reader : (n + 1,) and (4j,) arrays
        The sites whose element has each vertex as a corner.
    to_vertices, to_sites : RayTravelTimes
        To the vertices around each site, and to the other sites.
    """

    element: NDArray[np.int64]
    to_corner: NDArray[np.float64]
    node: NDArray[np.int64]
    anterograde: NDArray[np.float64]
    retrograde: NDArray[np.float64]
    reader_start: NDArray[np.int64]
    reader: NDArray[np.int64]
    to_vertices: RayTravelTimes
    to_sites: RayTravelTimes


# State in the sweep of a node, of the mesh or of a tree
STATE = np.dtype(
    [
        ("time", np.float64),  # arrival time of the front (ms)
        ("bucket", np.int32),  # bucket of the queue; a `Bucket` of `coupled` if not queued
        ("before", np.int32),  # previous and next node in the bucket's linked list, -1 at its ends
        ("after", np.int32),
        # site that activated it, or by which the front entered its tree; else -1
        ("origin", np.int32),
    ]
)


class Queue(NamedTuple):
    """Queue of nodes, in buckets by arrival time; see `fascicle.kernels.coupled.lower`.

    Attributes
    ----------
    head : (r,) array
        First node in the linked list of each bucket, -1 if it is empty; r is a power of 2.
    now : (1,) array
        Earliest bucket that may hold a node.
    """

    head: NDArray[np.int32]
    now: NDArray[np.int64]


# An element in which the front from a vertex may lower another corner
CHOSEN = np.dtype(
    [
        ("star", np.uint32),  # index in `EikonalMesh.star`
        ("slot", np.uint16),  # index of the vertex in the batch
        ("corners", np.uint16),  # corners that may be lowered, as bits: 1 for a, 2 for b, 4 for c
    ]
)

# A neighbour of a vertex, when elements are chosen: its delay after the vertex (ms, rounded up),
# and 1 if faces may use its arrival time, which they may unless the neighbour is in the queue
NEAR = np.dtype([("later", np.float32), ("lends", np.uint32)])


class Surroundings(NamedTuple):
    """Work arrays for a batch of vertices and their neighbours; see `fascicle.kernels.coupled`.

    Attributes
    ----------
    batch, now : (b,) arrays
        The vertices, and their arrival times (ms).
    time, near : (b·k,) array, and (b·k,) array of NEAR
        Arrival times (ms) so far of up to k neighbours of each vertex, and what elements are
        chosen by.
    chosen : (e,) array of CHOSEN
        The elements in which a corner may be lowered.
    face : (f,) array
        The faces through which a corner may be lowered: `CORNERS`·index of the element in `chosen`
        + index of the corner (0 to 2: a to c) that is opposite to the face.
    faces : (b, 14·8) array
        Blocks of eight faces, each as 14 rows (quantities) of eight values.
    """

    batch: NDArray[np.int64]
    now: NDArray[np.float64]
    time: NDArray[np.float64]
    near: NDArray[np.void]
    chosen: NDArray[np.void]
    face: NDArray[np.uint32]
    faces: NDArray[np.float64]


class Front(NamedTuple):
    """State of the sweep: results and work arrays.

    Attributes
    ----------
    nodes : (n + k,) array of STATE
        State of each mesh vertex and, after these, of each tree node.
    entered_by : (j,) array
        The site whose front entered a tree at each site, or -1.
    queue, around : Queue, Surroundings
        Queue of nodes; work arrays, whose initial content does not matter.
    """

    nodes: NDArray[np.void]
    entered_by: NDArray[np.int64]
    queue: Queue
    around: Surroundings
