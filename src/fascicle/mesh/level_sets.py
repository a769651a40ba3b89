"""Cutting a surface along a level of a function on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.topology import TRIANGLE_EDGES, unique_edges

NEAR = 0.15  # of an edge; a line that passes a vertex so near is led through it
UNCUT = -1  # in place of the new vertex of an edge


class CutSurface(NamedTuple):
    """A surface none of whose triangles lies on both sides of a line.

    Attributes
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm), those that were there first, and vertex indices.
    parent : (m,) array
        The triangle that each is part of.
    side : (m,) array
        1 where the function is positive, -1 where negative, 0 where all corners are on the line.
    """

    vertices: Floats
    triangles: Integers
    parent: Integers
    side: Integers


def cut_at_zero(vertices: Floats, triangles: Integers, values: Floats) -> CutSurface:
    """Divide the triangles that the zero level of a function passes through.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        The surface (mm).
    values : (n,) array
        The function at its vertices, linear between them.
    """
    values = values.copy()
    edges, _ = unique_edges(triangles)
    one, other = values[edges].T
    crossing = one * other < 0
    share = np.divide(one, one - other, out=np.zeros(len(edges)), where=crossing)
    for close, end in ((share < NEAR, 0), (share > 1 - NEAR, 1)):
        values[edges[crossing & close, end]] = 0.0
    one, other = values[edges].T
    edges = edges[one * other < 0]
    one, other = values[edges].T
    share = (one / (one - other))[:, None]
    added = (1 - share) * vertices[edges[:, 0]] + share * vertices[edges[:, 1]]
    on_edge = {tuple(edge): len(vertices) + k for k, edge in enumerate(edges.tolist())}
    corner_signs = np.sign(values[triangles]).astype(np.int64)
    through = corner_signs.min(axis=1) * corner_signs.max(axis=1) < 0
    whole = np.flatnonzero(~through)
    parts, parent = [triangles[whole]], [whole]
    for number in np.flatnonzero(through):
        pieces = _divided(triangles[number].tolist(), on_edge)
        parts.append(np.array(pieces))
        parent.append(np.full(len(pieces), number))
    cut = np.concatenate(parts)
    signs = np.concatenate([np.sign(values), np.zeros(len(added))]).astype(np.int64)
    side = np.sign(signs[cut].sum(axis=1))
    return CutSurface(np.concatenate([vertices, added]), cut, np.concatenate(parent), side)


def _divided(corners: list[int], on_edge: dict[tuple[int, int], int]) -> list[list[int]]:
    """Two or three triangles for one, at the new vertices on one or two of its edges."""
    new = []
    for start, end in TRIANGLE_EDGES:
        a, b = sorted((corners[start], corners[end]))
        new.append(on_edge.get((a, b), UNCUT))
    cut = [vertex != UNCUT for vertex in new]
    # first the one edge that is cut, or the one that is not, whose ends lie on one side
    k = cut.index(sum(cut) == 1)
    a, b, c = (corners[(k + s) % 3] for s in range(3))
    if sum(cut) == 1:
        return [[a, new[k], c], [new[k], b, c]]
    bc, ca = new[(k + 1) % 3], new[(k + 2) % 3]
    return [[a, b, bc], [a, bc, ca], [ca, bc, c]]
