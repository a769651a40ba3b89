"""The arrays that the sweep and the growth of trees work on, bundled by what they describe."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

CACHE_LINE = 64  # bytes

# The corners of a tetrahedron's faces, in ascending order: of the one opposite each corner
FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])

CORNERS = 4  # of a tetrahedron

# Columns of `EikonalMesh.cells`
GRADIENT_X, GRADIENT_Y, GRADIENT_Z = 0, 4, 8  # the first of four: one for each corner
AT_ORIGIN = 12  # the first of four, likewise
XX, YY, ZZ, XY, XZ, YZ = range(16, 22)  # of D⁻¹
CELL_COLUMNS = 22

# Columns of `EikonalMesh.solver`: the six pairs of corners in the order 01, 02, 03, 12, 13, 23
PRODUCTS, SQUARES = 0, 6  # the first of six each


def aligned(array: NDArray[Any]) -> NDArray[Any]:
    """Copy an array to where a cache line begins, if it does not begin with one.

    The system gives large arrays memory that begins 16 bytes after that, where many rows lie across
    one line more than they need to.
    """
    if array.ctypes.data % CACHE_LINE == 0:
        return array
    room = np.empty(array.nbytes + CACHE_LINE, np.uint8)
    first = -room.ctypes.data % CACHE_LINE
    copy = room[first : first + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


class EikonalMesh(NamedTuple):
    """The conducting myocardium; elements that do not conduct are in no list.

    What only the sweep reads is unsigned: that a negative index counts from the end, Numba would
    look for at every access.

    Attributes
    ----------
    vertices : (n, 3) array
        Positions (mm).
    corners : (m, 4) array
        Vertices of each tetrahedron.
    cells : (m, 22) array
        What a ray needs of each tetrahedron: the barycentric coordinates as affine functions
        (components of their gradients, 1/mm, and values at the origin) and D⁻¹ (ms²/mm²).
    neighbours : (m, 4) array
        The tetrahedra across the faces opposite each corner, -1 where no conducting one is.
    solver : (m, 12) array
        What the local solver needs of each: the products ∇λᵢ·D∇λⱼ (1/ms²) of its corners'
        barycentric coordinates for each pair of corners, and the squared travel times (ms²) along
        those edges.
    star_start, star : (n + 1,) and (4m,) arrays
        The tetrahedra of each vertex: `CORNERS`·tetrahedron + the vertex's own place in it.
    others : (4m, 3) array
        Their other three corners, in ascending order of their place in the tetrahedron: which of
        the vertices that share an edge with the vertex each is.
    least : (4m, 3) array
        By how much (ms) each of those corners is at least later than the vertex if the front
        comes to it through the vertex and the rest of the opposite face; may be negative.
    link_start, link, link_time : (n + 1,), (l,) and (l,) arrays
        The vertices that share an edge with each vertex, and the travel times to them (ms).
    slowness : float
        Least travel time over distance anywhere (ms/mm).
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int32]
    cells: NDArray[np.float64]
    neighbours: NDArray[np.int32]
    solver: NDArray[np.float64]
    star_start: NDArray[np.int64]
    star: NDArray[np.uint32]
    others: NDArray[np.uint16]
    least: NDArray[np.float32]
    link_start: NDArray[np.int64]
    link: NDArray[np.uint32]
    link_time: NDArray[np.float64]
    slowness: float

    @property
    def metric(self) -> NDArray[np.float64]:
        """D⁻¹ of each tetrahedron (ms²/mm²), shape (m, 3, 3)."""
        return self.cells[:, [XX, XY, XZ, XY, YY, YZ, XZ, YZ, ZZ]].reshape(-1, 3, 3)


class RayMedium(NamedTuple):
    """What a ray passes through: the three fields of these names of an `EikonalMesh`."""

    cells: NDArray[np.float64]
    neighbours: NDArray[np.int32]
    slowness: float


class TravelTimeTable(NamedTuple):
    """Ray travel times from the triangles of the endocardia to the vertices around them.

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
        How far (mm) and how long (ms) rays are.
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

    The roots of the Purkinje trees hang on the last node, the His bundle.

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
    """Travel times along straight lines from each site to what is around it.

    Attributes
    ----------
    start, target, time : (j + 1,), (p,) and (p,) arrays
        Where each site's rays start in the lists, where they lead, and how long they take (ms).
    """

    start: NDArray[np.int64]
    target: NDArray[np.int32]
    time: NDArray[np.float64]


class LocatedSites(NamedTuple):
    """Where sites lie in the mesh.

    Attributes
    ----------
    positions : (j, 3) array
        Positions (mm).
    elements : (j,) array
        The tetrahedron of each; -1 where there is none.
    barycentric : (j, 4) array
        Barycentric coordinates of each in its tetrahedron.
    to_corner : (j, 4) array
        Squared travel times (ms²) to its corners.
    """

    positions: NDArray[np.float64]
    elements: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    to_corner: NDArray[np.float64]


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
        Delays (ms) from tree to myocardium and back; inf where nothing passes.
    reader_start, reader : (n + 1,) and (4j,) arrays
        The sites whose element has each vertex as a corner.
    to_vertices, to_sites : RayTravelTimes
        To the vertices around each site, and to the other sites.
    """

    element: NDArray[np.int64]
    to_corner: NDArray[np.float64]
    node: NDArray[np.int64]
    orthodromic: NDArray[np.float64]
    antidromic: NDArray[np.float64]
    reader_start: NDArray[np.int64]
    reader: NDArray[np.int64]
    to_vertices: RayTravelTimes
    to_sites: RayTravelTimes


class Queue(NamedTuple):
    """The nodes that wait to be taken, in buckets of time; see `fascicle.kernels.queue`.

    Attributes
    ----------
    head : (RING,) array
        The first node in the list of each bucket, -1 where there is none.
    before, after : (n + k,) arrays
        The nodes on both sides of each in its list, -1 at the ends.
    bucket : (n + k,) array
        The bucket of each node; `WAITS_NOT` if it is in none.
    now : (1,) array
        A bucket before which all are empty.
    """

    head: NDArray[np.int32]
    before: NDArray[np.int32]
    after: NDArray[np.int32]
    bucket: NDArray[np.int32]
    now: NDArray[np.int64]


class Chosen(NamedTuple):
    """Elements around vertices of a batch.

    Attributes
    ----------
    item : (e,) array
        The item of `EikonalMesh.star` that each is.
    corners : (e,) array
        Which corners may be lowered, the sum of 1, 2 and 4.
    vertex, at : (e,) arrays
        The vertex, and where its neighbours start in `Surroundings.time`.
    """

    item: NDArray[np.uint32]
    corners: NDArray[np.uint32]
    vertex: NDArray[np.uint32]
    at: NDArray[np.uint32]


class ChosenFaces(NamedTuple):
    """Faces of chosen elements.

    Attributes
    ----------
    row, corner : (f,) arrays
        The element's place in `Chosen`, and which of its corners the face is opposite to.
    """

    row: NDArray[np.uint32]
    corner: NDArray[np.uint32]


class Surroundings(NamedTuple):
    """Room for a batch of vertices and what is around them: neighbours, elements and their faces.

    Blocks hold a few elements or faces side by side, each number of all of them in a row; see
    `fascicle.kernels.star`.

    Attributes
    ----------
    batch : (b,) array
        The vertices.
    now : (b·k,) array
        Time of each vertex (ms), at the first of its k items.
    time, lent : (b·k,) arrays
        Of each vertex's neighbours: when the front comes to them (ms), as far as is known; and the
        time that they lend to faces, inf while they wait in the queue.
    chosen : Chosen
        The elements that may lower a corner.
    elements : array
        Blocks of those.
    face : ChosenFaces
        The faces by which a corner may be lowered.
    faces : array
        Blocks of those.
    """

    batch: NDArray[np.int64]
    now: NDArray[np.float64]
    time: NDArray[np.float64]
    lent: NDArray[np.float64]
    chosen: Chosen
    elements: NDArray[np.float64]
    face: ChosenFaces
    faces: NDArray[np.float64]


class Front(NamedTuple):
    """What the sweep finds out, for mesh vertices first and then tree nodes.

    Attributes
    ----------
    time : (n + k,) array
        When the front arrives (ms).
    origin : (n + k,) array
        The site that fired each vertex, or by which the front entered a tree; else -1.
    entered_by : (j,) array
        The site whose front entered a tree at each site, or -1.
    queue : Queue
        The nodes that wait to be taken.
    around : Surroundings
        Anything.
    """

    time: NDArray[np.float64]
    origin: NDArray[np.int64]
    entered_by: NDArray[np.int64]
    queue: Queue
    around: Surroundings


# What the search for the nearest node reads of a node lies together: one cache line, not five.
NODE = np.dtype(
    [
        ("u", np.float64),
        ("v", np.float64),
        ("branch", np.int32),  # number of the branch it belongs to
        ("following", np.int32),  # next node in the same cell of the hash, or -1
        ("parent", np.int32),  # node before it, -1 at the root
        ("triangle", np.int32),
        ("length", np.float64),  # of the segment to its parent (mm)
    ]
)


class Rules(NamedTuple):
    """What is held fixed: `fascicle.purkinje.growth.GrowthRules`, with `step` = l_b/N_s (mm)."""

    step: float
    segments: int
    generations: int
    repulsion: float
    branch_angle: float
    clearance: float


class Tree(NamedTuple):
    """A tree that grows.

    Attributes
    ----------
    nodes : array of NODE
        The nodes, and room for more.
    size : int
        How many nodes there are.
    head : (GRID, GRID) array
        The hash: a node in each cell, from which `following` leads to the others; or -1.
    """

    nodes: NDArray[np.void]
    size: int
    head: NDArray[np.int32]
