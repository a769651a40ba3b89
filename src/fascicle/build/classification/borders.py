"""Smooth borders between the parts of a closed surface, and a base that is nowhere too narrow."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from fascicle.build.classification.dual_graph import DualGraph
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.level_sets import cut_at_zero
from fascicle.mesh.topology import boundary_loops

# Regions while the surface is divided: the cavities come first, the larger area first of all, and
# the base lies between all others.
FIRST, SECOND, OUTER, BASAL = range(4)
REACH = 2.5  # mm over which a border is smoothed
LEAST_REACH = 1.5  # mean edges that it is at least
NARROWEST = 2.0  # mm between endocardium and epicardium, so that a thin wall, too, ends in a rim


def smoothed_regions(graph: DualGraph, regions: Integers) -> Integers:
    """Regions of triangles (m,) with borders that are as smooth as the triangles allow.

    Each cavity and the outer surface is smoothed for itself, so that a narrow base between them
    stays; then the outer surface ends `NARROWEST` before the cavities do.
    """
    shares = [_smoothed(graph, regions == part) for part in (FIRST, SECOND, OUTER)]
    smooth: Integers = np.argmax([*shares, np.full(len(regions), 0.5)], axis=0)
    sides = smooth[graph.edges[0]]
    ends = (sides[:, 0] != sides[:, 1]) & (sides < OUTER).any(axis=1)
    if not ends.any():
        return smooth
    line = graph.vertices[graph.edges[1][ends]]
    distance, _ = cKDTree(np.concatenate([line[:, 0], line.mean(axis=1)])).query(graph.centres)
    return np.where((smooth == OUTER) & (distance < NARROWEST), BASAL, smooth)


def cut_along_borders(surface: LabelledSurface, edge_length: float = NARROWEST) -> LabelledSurface:
    """The same surface with triangles divided so that borders need not follow their edges.

    Parameters
    ----------
    surface : LabelledSurface
        Closed, with `Label.BASE` between the other labels.
    edge_length : float
        Of the triangles to come (mm); the base is nowhere narrower than that.
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
    reach = max(REACH, LEAST_REACH * float(graph.lengths.mean()))
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
