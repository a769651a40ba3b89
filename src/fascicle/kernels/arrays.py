"""The arrays that the coupled sweep works on, bundled by what they describe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
    squares : (m, 6) array
        Squared travel times (ms²) along its edges 01, 02, 03, 12, 13, 23.
    star_start, star : (n + 1,) and (4m,) arrays
        The tetrahedra of each vertex, as 4·tetrahedron + corner.
    star_vertex : (4m, 3) array
        Their other corners.
    reach : (4m, 3) array
        By how much (ms) the other corners are at least later than the vertex if the front comes
        to them through the vertex and the rest of the opposite face; may be negative.
    height : (4m, 3) array
        By how much (ms) they are at least later than the earliest corner of the opposite face.
    link_start, link : (n + 1,) and (l,) arrays
        The vertices that share an edge with each vertex.
    slowness : float
        Least travel time over distance anywhere (ms/mm).
    slack : float
        A ray is followed through a vertex for as long as the product of how long it took and by
        how much it comes late is at most this (ms²). Along an edge that takes h, the linear
        interpolation of a spherical wave of age w is late by at most h²/8w, so with h²/8 hardly a
        ray is dropped that would arrive first further on.
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int32]
    cells: NDArray[np.float64]
    across: NDArray[np.int32]
    squares: NDArray[np.float64]
    star_start: NDArray[np.int64]
    star: NDArray[np.int32]
    star_vertex: NDArray[np.int32]
    reach: NDArray[np.float32]
    height: NDArray[np.float32]
    link_start: NDArray[np.int64]
    link: NDArray[np.int32]
    slowness: float
    slack: float

    @property
    def metric(self) -> NDArray[np.float64]:
        """D⁻¹ of each tetrahedron (ms²/mm²), shape (m, 3, 3)."""
        return self.cells[:, [16, 19, 20, 19, 17, 21, 20, 21, 18]].reshape(-1, 3, 3)


class Forest(NamedTuple):
    """All trees as one graph; a stimulus in the myocardium is a tree of one node.

    Attributes
    ----------
    start, node, time : (k + 1,), (l,) and (l,) arrays
        Neighbours of each tree node and the travel times to them (ms; inf where blocked).
    site : (k,) array
        Number of the site at each node, or -1.
    """

    start: NDArray[np.int64]
    node: NDArray[np.int64]
    time: NDArray[np.float64]
    site: NDArray[np.int64]


class Sites(NamedTuple):
    """Where trees (and stimuli) meet the myocardium.

    Attributes
    ----------
    positions : (j, 3) array
        Positions in the tissue (mm).
    elements : (j,) array
        Tetrahedron of each; -1 where a site meets no conducting tissue.
    node : (j,) array
        Tree node of each.
    orthodromic, antidromic : (j,) arrays
        Delays (ms) from tree to myocardium and back; inf where there is no way.
    reader_start, reader : (n + 1,) and (4j,) arrays
        The sites whose element has each vertex as a corner.
    """

    positions: NDArray[np.float64]
    elements: NDArray[np.int64]
    node: NDArray[np.int64]
    orthodromic: NDArray[np.float64]
    antidromic: NDArray[np.float64]
    reader_start: NDArray[np.int64]
    reader: NDArray[np.int64]
