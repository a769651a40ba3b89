"""Regions of a closed surface, made manifold and one piece each."""

from __future__ import annotations

import numpy as np

from fascicle.build.classification.dual_graph import DualGraph
from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError

BASAL = 3  # the region that must lie between all others: the base
ROUNDS = 20


def clean_regions(graph: DualGraph, regions: Integers, name: str) -> Integers:
    """Make each region one manifold piece, all apart from one another by the base.

    Parameters
    ----------
    graph : DualGraph
        The closed surface.
    regions : (m,) array
        Region of each triangle, 0 to `BASAL`.
    name : str
        What to call the surface in an error.

    Returns
    -------
    (m,) array
        Regions.

    Raises
    ------
    InputError
        If they do not settle.
    """
    for _ in range(ROUNDS):
        before = regions
        regions = _without_non_manifold_vertices(
            graph, _in_one_piece(graph, _separated(graph, regions))
        )
        if (regions == before).all():
            return regions
    raise InputError(
        f"{name}: no clean borders between endocardia, epicardium and base found; remesh the "
        "surface evenly, or give its parts one by one"
    )


def _separated(graph: DualGraph, regions: Integers) -> Integers:
    """Give the base the triangles about vertices at which two other regions meet."""
    sides = regions[graph.edges[0]]
    meeting = (sides[:, 0] != sides[:, 1]) & (sides < BASAL).all(axis=1)
    if not meeting.any():
        return regions
    touched = np.isin(graph.triangles, graph.edges[1][meeting]).any(axis=1)
    return np.where(touched, BASAL, regions)


def _in_one_piece(graph: DualGraph, regions: Integers) -> Integers:
    """Keep the largest piece of each region; the rest goes to what it is surrounded by."""
    kept = np.full(len(regions), -1)
    for region in range(BASAL + 1):
        kept[graph.components(regions == region) == 0] = region
    return graph.random_walker(kept, BASAL + 1)


def _without_non_manifold_vertices(graph: DualGraph, regions: Integers) -> Integers:
    """Give all triangles about a vertex at which a region touches itself to one region."""
    sides = regions[graph.edges[0]]
    border = graph.edges[1][sides[:, 0] != sides[:, 1]]
    changes = np.bincount(border.ravel(), minlength=len(graph.vertices))
    corners = graph.triangles.ravel()
    present = np.zeros((len(graph.vertices), BASAL + 1), dtype=bool)
    present[corners, np.repeat(regions, 3)] = True
    # around a vertex k regions change k times (two regions twice), more where one comes back
    kinds = present.sum(axis=1)
    touching = (changes > kinds) & (changes > 2)
    result = regions.copy()
    for vertex in np.flatnonzero(touching):
        around = np.flatnonzero((graph.triangles == vertex).any(axis=1))
        result[around] = BASAL if present[vertex, BASAL] else regions[around[0]]
    return result
