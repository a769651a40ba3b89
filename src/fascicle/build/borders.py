"""Smooth borders between the parts of a closed surface, and a base that is nowhere too narrow."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from fascicle.build.dual_graph import DualGraph
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.topology import TRIANGLE_EDGES, boundary_loops, unique_edges

NARROWEST = 2.0  # mm between endocardium and epicardium, so that a thin wall, too, ends in a rim


class Region(IntEnum):
    """Parts of a surface while it is divided; the base lies between all others.

    The first cavity has the larger area.
    """

    FIRST = 0
    SECOND = 1
    OUTER = 2
    BASAL = 3


def smoothed_regions(graph: DualGraph, regions: Integers) -> Integers:
    """Regions of triangles (m,) with borders that are as smooth as the triangles allow.

    Each cavity and the outer surface is smoothed for itself, so that a narrow base between them
    stays; then the outer surface ends `NARROWEST` before the cavities do.
    """
    shares = [
        _smoothed(graph, regions == part) for part in (Region.FIRST, Region.SECOND, Region.OUTER)
    ]
    smooth: Integers = np.argmax([*shares, np.full(len(regions), 0.5)], axis=0)
    sides = smooth[graph.edges[0]]
    ends = (sides[:, 0] != sides[:, 1]) & (sides < Region.OUTER).any(axis=1)
    if not ends.any():
        return smooth
    line = graph.vertices[graph.edges[1][ends]]
    distance, _ = cKDTree(np.concatenate([line[:, 0], line.mean(axis=1)])).query(graph.centres)
    return np.where((smooth == Region.OUTER) & (distance < NARROWEST), Region.BASAL, smooth)


def cut_along_borders(surface: LabelledSurface, edge_length: float = NARROWEST) -> LabelledSurface:
    """The same surface with triangles divided so that borders need not follow their edges.

    The surface is closed, with `Label.BASE` between the other labels. The base is nowhere narrower
    than the edge length of the triangles to come (mm).
    """
    for part in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.EPICARDIUM):
        inside = surface.labels == part
        graph = DualGraph(surface.vertices, surface.triangles)
        level = _level(graph, inside)
        if part == Label.EPICARDIUM:
            away = _distance_to_endocardia(surface) / max(NARROWEST, edge_length) - 1
            level = np.minimum(level, away)
        cut = cut_at_zero(graph.vertices, graph.triangles, level)
        before = surface.labels[cut.parent]
        outside = np.where(before == part, Label.BASE, before)
        labels = np.where(cut.side > 0, part, np.where(cut.side < 0, outside, before))
        surface = LabelledSurface(cut.vertices, cut.triangles, labels, surface.name)
    return surface


def _smoothed(graph: DualGraph, chosen: Booleans) -> Floats:
    """Share of the surface about each triangle that is chosen, shape (m,).

    The characteristic function after an implicit step of diffusion that hardly crosses creases: its
    level ½ is the border without teeth (Merriman, Bence and Osher 1992, Diffusion generated motion
    by mean curvature), and a border that follows a crease stays there.
    """
    reach = max(2.5, 1.5 * float(graph.lengths.mean()))  # mm over which a border is smoothed
    system = diags_array(graph.areas) + reach**2 * graph.laplacian(graph.crease_weights)
    return np.asarray(splu(csc_array(system)).solve(graph.areas * chosen))


def _distance_to_endocardia(surface: LabelledSurface) -> Floats:
    """Distance of each vertex from the nearest edge of an endocardium (mm), shape (n,)."""
    line = np.concatenate(
        [
            loop
            for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
            for loop in boundary_loops(surface.having(label))
        ]
    )
    return np.asarray(cKDTree(surface.vertices[line]).query(surface.vertices)[0])


def _level(graph: DualGraph, inside: Booleans) -> Floats:
    """A function of the vertices that is positive inside, zero on the smooth border, (n,)."""
    corners, count = graph.triangles.ravel(), len(graph.vertices)
    weights = np.repeat(graph.areas, 3)
    share = np.repeat(_smoothed(graph, inside) - 0.5, 3)
    level = np.bincount(corners, weights * share, count) / np.bincount(corners, weights, count)
    return np.asarray(level)


class CutSurface(NamedTuple):
    """A surface none of whose triangles (m, 3) lies on both sides of a line.

    The old vertices come first. `parent` (m,) is the triangle that each is part of, `side` (m,) 1
    where the function is positive, -1 where negative, 0 where all corners are on the line.
    """

    vertices: Floats
    triangles: Integers
    parent: Integers
    side: Integers


def cut_at_zero(vertices: Floats, triangles: Integers, values: Floats) -> CutSurface:
    """Divide the triangles that the zero level of a function, given at the vertices, crosses."""
    near = 0.15  # of an edge; a line that passes a vertex so near is led through it
    values = values.copy()
    edges, _ = unique_edges(triangles)
    one, other = values[edges].T
    crossing = one * other < 0
    share = np.divide(one, one - other, out=np.zeros(len(edges)), where=crossing)
    for close, end in ((share < near, 0), (share > 1 - near, 1)):
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
        new.append(on_edge.get((a, b), -1))
    cut = [vertex != -1 for vertex in new]
    # first the one edge that is cut, or the one that is not, whose ends lie on one side
    k = cut.index(sum(cut) == 1)
    a, b, c = (corners[(k + s) % 3] for s in range(3))
    if sum(cut) == 1:
        return [[a, new[k], c], [new[k], b, c]]
    bc, ca = new[(k + 1) % 3], new[(k + 2) % 3]
    return [[a, b, bc], [a, bc, ca], [ca, bc, c]]
