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
    metric : (m, 6) array
        D⁻¹ of each tetrahedron (ms²/mm²): xx, yy, zz, xy, xz, yz.
    squares : (m, 6) array
        Squared travel times (ms²) along its edges 01, 02, 03, 12, 13, 23.
    planes : (m, 4, 4) array
        The barycentric coordinates as affine functions: ``planes[:, :3, k]`` is the gradient
        (1/mm) of coordinate k, ``planes[:, 3, k]`` its value at the origin.
    neighbours : (m, 4) array
        Tetrahedron across the face opposite each corner; -1 where no conducting one is.
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
        interpolation of a spherical wave of age w is late by at most h²/8w, so with h²/8 no ray is
        dropped that would arrive first further on.
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int32]
    metric: NDArray[np.float64]
    squares: NDArray[np.float64]
    planes: NDArray[np.float64]
    neighbours: NDArray[np.int32]
    star_start: NDArray[np.int64]
    star: NDArray[np.int32]
    star_vertex: NDArray[np.int32]
    reach: NDArray[np.float32]
    height: NDArray[np.float32]
    link_start: NDArray[np.int64]
    link: NDArray[np.int32]
    slowness: float
    slack: float


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
