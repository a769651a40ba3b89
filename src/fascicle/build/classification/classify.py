"""A closed surface of the ventricles without labels: endocardia, epicardium and base are found."""

from __future__ import annotations

import numpy as np

from fascicle.build.classification.ambient_occlusion import openness
from fascicle.build.classification.base_direction import cosine_to_base
from fascicle.build.classification.dual_graph import DualGraph
from fascicle.build.classification.region_cleaning import clean_regions
from fascicle.build.sides import cavity_volume, leftness
from fascicle.build.surface_checks import check_edges, oriented_piece, place
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.heart.validate import check_units
from fascicle.mesh.measures import turned_outwards
from fascicle.mesh.topology import boundary_loops, without_unused_vertices

# Openness (one minus ambient occlusion). At the upper edge of a cavity that of a wall is a half,
# deeper less; that of the epicardium is more than 0.8 even in the grooves between the ventricles.
IN_CAVITY, OUTSIDE = 0.6, 0.85
# Cosine of the angle between normal and the way up out of the wall: base within 26°, none from 46°.
FACING_UP, NOT_FACING_UP = 0.9, 0.7
SMALLEST_CAVITY = 0.02  # of the whole area; smaller dents are none
ML = 1e3  # mm³

# labels while the surface is divided; the cavities come first, the larger area first of all
FIRST, SECOND, OUTER, BASAL = range(4)


def classify_surface(
    vertices: Floats, triangles: Integers, name: str, progress: StageProgress = no_progress
) -> LabelledSurface:
    """Label the closed surface of the ventricles from its shape alone.

    Endocardium is where rays that leave the surface mostly meet it again (ambient occlusion); there
    must be two such pieces, of which the left one is rounder, closer to convex and behind the
    thicker wall. The base is where the surface faces the way up out of the wall along the openings,
    whether it is flat or a rounded rim. A random walker draws the borders along the creases.

    Parameters
    ----------
    vertices : (n, 3) array
        Positions (mm), in any frame.
    triangles : (m, 3) array
        Vertex indices, in any orientation.
    name : str
        What to call the surface in messages.
    progress : StageProgress
        Called with the triangles done and in all, while rays are traced.

    Returns
    -------
    LabelledSurface
        The same triangles, turned to face out of the tissue, with `Label.BASE`,
        `Label.EPICARDIUM`, `Label.LV_ENDOCARDIUM` and `Label.RV_ENDOCARDIUM`; each of these is one
        piece and each endocardium has one opening. Vertices that no triangle uses are dropped.

    Raises
    ------
    InputError
        If the surface is not closed or not one piece, is not in mm, or does not have two cavities
        with one opening each.
    """
    vertices, triangles = without_unused_vertices(vertices, triangles)
    check_units(name, vertices)
    check_edges(name, vertices, triangles, closed=True)
    triangles = turned_outwards(vertices, oriented_piece(name, vertices, triangles))
    graph = DualGraph(vertices, triangles)
    exposed = openness(graph, progress)
    cavity = _cavities(graph, exposed, name)
    regions = clean_regions(graph, _divided(graph, exposed, cavity), name)
    _check_openings(graph, regions, name)
    outer, first, second = (
        (vertices, np.ascontiguousarray(triangles[regions == region]))
        for region in (OUTER, FIRST, SECOND)
    )
    sides = [Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM]
    if leftness(first, second, outer) < 0:
        sides.reverse()
    labels = np.array([*sides, Label.EPICARDIUM, Label.BASE], dtype=np.int64)[regions]
    return LabelledSurface(vertices, triangles, labels, name)


def _cavities(graph: DualGraph, exposed: Floats, name: str) -> Integers:
    """Number of the cavity that each triangle lies deep in, -1 elsewhere; there must be two."""
    piece = graph.components(exposed < IN_CAVITY)
    area = np.bincount(piece[piece >= 0], graph.areas[piece >= 0], minlength=1)
    found = int((area > SMALLEST_CAVITY * graph.areas.sum()).sum())
    if found != 2:
        volumes = [
            cavity_volume(graph.vertices, graph.triangles[piece == k]) / ML for k in range(found)
        ]
        sizes = ", ".join(f"{volume:.3g}" for volume in volumes)
        what = {0: "no cavity", 1: f"one cavity ({sizes} ml)"}.get(
            found, f"{found} cavities ({sizes} ml)"
        )
        raise InputError(
            f"{name}: {what} found; it must have two, of the left and the right ventricle, each "
            "open at the base"
        )
    return np.where(piece < 2, piece, -1)


def _divided(graph: DualGraph, exposed: Floats, cavity: Integers) -> Integers:
    """Divide the surface into the two cavities, the outer surface and the base between them."""
    seeds = np.where(cavity >= 0, cavity, np.where(exposed > OUTSIDE, OUTER, -1))
    upwards = cosine_to_base(graph, graph.random_walker(seeds, 3))
    outside = exposed > IN_CAVITY
    # the inner edge of a rounded rim faces neither up nor out: it is left to the random walker
    outer = graph.components((exposed > OUTSIDE) & (upwards < NOT_FACING_UP)) == 0
    seeds = np.where(cavity >= 0, cavity, -1)
    seeds[outer] = OUTER
    seeds[outside & (upwards > FACING_UP)] = BASAL
    return graph.random_walker(seeds, 4)


def _check_openings(graph: DualGraph, regions: Integers, name: str) -> None:
    """Refuse a surface that is all base or has none, and a cavity with several openings."""
    for region, what in ((OUTER, "epicardium"), (BASAL, "base")):
        if not (regions == region).any():
            raise InputError(
                f"{name}: no {what} found around the cavities; give the surface's parts one by one"
            )
    for region in (FIRST, SECOND):
        loops = boundary_loops(graph.triangles[regions == region])
        if len(loops) != 1:
            volume = cavity_volume(graph.vertices, graph.triangles[regions == region]) / ML
            where = " and ".join(place(graph.vertices[loop].mean(axis=0)) for loop in loops)
            raise InputError(
                f"{name}: the cavity of {volume:.3g} ml has {len(loops)} openings, about {where}"
                "; cut the base off below the bridge between them"
            )
