"""Triangles of a surface that cut through one another."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers

CHUNK = 1 << 13  # triangles looked at a time, which bounds the memory
# Relative, of the volumes that an edge and the sides of a triangle span, and of the distance of its
# ends from the triangle's plane.
ROUNDING = 1e-9
# The two triangles of an edge that make an angle below this lie on one another.
FOLDED = np.cos(np.radians(1.0))


def self_intersections(
    vertices: Floats, triangles: Integers, surface: Integers | None = None
) -> Integers:
    """Pairs of triangles that cut through or lie folded on one another.

    Two triangles cut through one another where an edge of one passes through the other. Touching
    in a vertex or an edge is no cut; nor are two triangles without a common edge that lie in one
    plane, as far as rounding can decide.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices.
    surface : (m,) array, optional
        Number of the surface that each triangle belongs to; only pairs of two different surfaces
        are then looked for.

    Returns
    -------
    (k, 2) array
        Numbers of triangles, the smaller first.
    """
    corners = vertices[triangles]
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    lowest, highest = corners.min(axis=1), corners.max(axis=1)
    tree = cKDTree(centres)
    found = []
    for start in range(0, len(triangles), CHUNK):
        rows = np.arange(start, min(start + CHUNK, len(triangles)))
        # the smaller triangle of a pair is found by the larger one
        near = tree.query_ball_point(centres[rows], 2 * reach[rows])
        first = np.repeat(rows, [len(of_one) for of_one in near])
        second = np.concatenate([np.asarray(of_one, dtype=np.int64) for of_one in near])
        smaller = (reach[second] < reach[first]) | (
            (reach[second] == reach[first]) & (second < first)
        )
        overlap = ((lowest[first] <= highest[second]) & (lowest[second] <= highest[first])).all(
            axis=1
        )
        keep = smaller & overlap
        if surface is not None:
            keep &= surface[first] != surface[second]
        pairs = np.sort(np.column_stack([first[keep], second[keep]]), axis=1)
        found.append(pairs[_cut(vertices, triangles, pairs)])
    return np.unique(np.concatenate(found), axis=0)


def _cut(vertices: Floats, triangles: Integers, pairs: Integers) -> Booleans:
    """Whether the two triangles of each pair cut through, or lie on, one another."""
    one, other = triangles[pairs[:, 0]], triangles[pairs[:, 1]]
    shared = (one[:, :, None] == other[:, None, :]).any(axis=2).sum(axis=1)
    cut = np.zeros(len(pairs), dtype=bool)
    apart = np.flatnonzero(shared < 2)
    for edges_of, through in ((one, other), (other, one)):
        for k in range(3):
            edge = edges_of[apart][:, [k, (k + 1) % 3]]
            pierced = through[apart]
            # an edge that starts on the other triangle touches it and does not cut it
            free = ~(edge[:, :, None] == pierced[:, None, :]).any(axis=(1, 2))
            cut[apart[free]] |= _pierces(vertices, edge[free], pierced[free])
    hinged = np.flatnonzero(shared == 2)
    cut[hinged] = _folded(vertices, one[hinged], other[hinged])
    return cut


def _pierces(vertices: Floats, edge: Integers, triangle: Integers) -> Booleans:
    """Whether each edge passes through its triangle: signs of the volumes that they span."""
    p, q = vertices[edge[:, 0]], vertices[edge[:, 1]]
    a, b, c = (vertices[triangle[:, k]] for k in range(3))

    def side(u: Floats, v: Floats, w: Floats) -> Floats:
        return np.asarray(np.einsum("ij,ij->i", u, np.cross(v, w)))

    normal = np.cross(b - a, c - a)
    above = [np.einsum("ij,ij->i", end - a, normal) for end in (p, q)]
    along = q - p
    in_plane = (
        ROUNDING
        * np.linalg.norm(normal, axis=1)
        * np.max([np.linalg.norm(x, axis=1) for x in (p - a, along, b - a, c - a)], axis=0)
    )
    across = (np.sign(above[0]) != np.sign(above[1])) & (np.abs(above) > in_plane).all(axis=0)
    turns = np.stack(
        [side(along, a - p, b - p), side(along, b - p, c - p), side(along, c - p, a - p)]
    )
    on_edge = ROUNDING * np.abs(turns).max(axis=0)  # passing through an edge or corner cuts too
    inside = (turns >= -on_edge).all(axis=0) | (turns <= on_edge).all(axis=0)
    return np.asarray(across & inside)


def _folded(vertices: Floats, one: Integers, other: Integers) -> Booleans:
    """Whether two triangles with a common edge lie on one another."""
    common = (one[:, :, None] == other[:, None, :]).any(axis=2)
    common_other = (other[:, :, None] == one[:, None, :]).any(axis=2)
    rows = np.arange(len(one))
    tip, tip_other = (
        one[rows, (~common).argmax(axis=1)],
        other[rows, (~common_other).argmax(axis=1)],
    )
    ends = one[common].reshape(-1, 2)
    origin = vertices[ends[:, 0]]
    edge = vertices[ends[:, 1]] - origin
    normals = [np.cross(edge, vertices[at] - origin) for at in (tip, tip_other)]
    product = np.prod([np.linalg.norm(normal, axis=1) for normal in normals], axis=0)
    return np.asarray(np.einsum("ij,ij->i", *normals) > FOLDED * product)
