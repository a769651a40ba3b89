"""Labels of a closed ventricular surface (endocardia, epicardium, base) from its shape."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.borders import DualGraph, SurfacePart, openness, smoothed_regions
from fascicle.build.surface_checks import leftness
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledSurface
from fascicle.mesh.checks import check_edges, check_units, oriented_piece, place
from fascicle.mesh.measures import closed_by_fan, loop_length, turned_outwards, unit
from fascicle.mesh.topology import boundary_loops, without_unused_vertices


def classify_surface(
    vertices: Floats, triangles: Integers, name: str, progress: StageProgress = no_progress
) -> LabelledSurface:
    """Label the closed surface of the ventricles from its shape alone.

    Endocardium is where rays that leave the surface mostly meet it again (ambient occlusion); there
    must be two such pieces, of which the left one is rounder, closer to convex and has the thicker
    wall. The base is where the surface along the openings faces upwards out of the wall, whether it
    is flat or a rounded rim. A random walker draws the borders along the creases; the borders are
    then smoothed, and the base is nowhere narrower than about 2 mm.

    Vertices (n, 3) (mm) are in any frame, triangles (m, 3) in any orientation; they are turned to
    face out of the tissue. Each label is one piece. Of several openings of a cavity the longest is
    its base, and a note says so. Vertices that no triangle uses are dropped.
    """
    vertices, triangles = without_unused_vertices(vertices, triangles)
    check_units(name, vertices)
    check_edges(name, vertices, triangles, "close the surface, or give its parts one by one")
    which = "one (cavities must be open at the base)"
    triangles = turned_outwards(vertices, oriented_piece(name, vertices, triangles, which))
    graph = DualGraph(vertices, triangles)
    exposed = openness(graph, progress)
    # it is a half at the upper edge of a cavity and less deeper down
    cavity = _cavities(graph, exposed < 0.6, name)
    regions = _clean_regions(graph, _divided(graph, exposed, cavity), name)
    regions = _clean_regions(graph, smoothed_regions(graph, regions), name)
    notes = _openings(graph, regions, name)
    outer, first, second = (
        (vertices, np.ascontiguousarray(triangles[regions == region]))
        for region in (SurfacePart.OUTER, SurfacePart.FIRST, SurfacePart.SECOND)
    )
    sides = [*ENDOCARDIA]
    if leftness(first, second, outer) < 0:
        sides.reverse()
    labels = np.array([*sides, Label.EPICARDIUM, Label.BASE], dtype=np.int64)[regions]
    return LabelledSurface(vertices, triangles, labels, name, notes=notes)


def _cavities(graph: DualGraph, deep: Booleans, name: str) -> Integers:
    """Cavity that each triangle lies deep in, or -1; InputError unless there are two cavities."""
    piece = graph.components(deep)
    area = np.bincount(piece[piece >= 0], graph.areas[piece >= 0], minlength=1)
    count = int((area > 0.02 * graph.areas.sum()).sum())  # smaller ones are dents
    if count != 2:
        sizes = [f"{_millilitres(graph, piece == k):.3g} ml" for k in range(count)]
        remedy = "give a surface of both ventricles, each open at the base"
        if count > 2:
            remedy = "cut off what is no ventricle, or label the surface (--label-array)"
        noun, listed = "cavity" if count == 1 else "cavities", ", ".join(sizes)
        raise InputError(
            f"{name}: {count} {noun} found{f' ({listed})' if sizes else ''}, and two needed; "
            f"{remedy}"
        )
    return np.where(piece < 2, piece, -1)


def _millilitres(graph: DualGraph, chosen: Booleans) -> float:
    """Volume (ml) of the cavity that chosen triangles line."""
    return abs(closed_by_fan(graph.vertices, graph.triangles[chosen])[0]) / 1e3


def _divided(graph: DualGraph, exposed: Floats, cavity: Integers) -> Integers:
    """Divide the surface into the two cavities, the outer surface and the base between them."""
    # the openness of the epicardium is more than 0.8 even in the grooves between the ventricles
    exterior = exposed > 0.85
    seeds = np.where(cavity >= 0, cavity, np.where(exterior, SurfacePart.OUTER, -1))
    upwards = _cosine_to_base(graph, graph.random_walker(seeds, 3))
    # the inner edge of a rounded rim faces neither up nor out; the random walker labels it
    # facing away from the base by 46 degrees or more
    outer = graph.components(exterior & (upwards < 0.7)) == 0
    seeds = np.where(cavity >= 0, cavity, -1)
    seeds[outer] = SurfacePart.OUTER
    seeds[(exposed > 0.6) & (upwards > 0.9)] = SurfacePart.BASAL  # within 26 degrees
    return graph.random_walker(seeds, 4)


def _cosine_to_base(graph: DualGraph, regions: Integers) -> Floats:
    """Cosine between each triangle's normal and the way up out of the wall, shape (m,).

    Up is normal to the plane of the nearest opening and, since rims undulate, to the opening's
    edge; farther than 50 mm from both openings the cosine is -1.
    """
    sides = regions[graph.edges[0]]
    middle = graph.vertices[graph.edges[1]].mean(axis=1)
    edges, directions = [], []
    for cavity in (SurfacePart.FIRST, SurfacePart.SECOND):
        edge = middle[(sides == cavity).sum(axis=1) == 1]
        centre = edge.mean(axis=0)
        normal = np.linalg.svd(edge - centre, full_matrices=False)[2][2]
        normal *= np.sign(normal @ (centre - graph.centres[regions == cavity].mean(axis=0)))
        tangents = []
        for near in cKDTree(edge).query_ball_point(edge, 10.0):  # mm
            piece = edge[near] - edge[near].mean(axis=0)
            tangents.append(np.linalg.svd(piece, full_matrices=False)[2][0])
        along = np.array(tangents)
        edges.append(edge)
        directions.append(unit(normal - (along @ normal)[:, np.newaxis] * along))
    distance, nearest = cKDTree(np.vstack(edges)).query(graph.centres)
    cosine = np.einsum("ij,ij->i", graph.smooth_normals, np.vstack(directions)[nearest])
    return np.where(distance > 50.0, -1.0, cosine)


def _clean_regions(graph: DualGraph, regions: Integers, name: str) -> Integers:
    """Make each region one manifold piece, all apart from one another by the base."""
    for _ in range(20):
        before = regions
        # the base takes the triangles about vertices at which two other regions meet
        sides = regions[graph.edges[0]]
        meeting = (sides[:, 0] != sides[:, 1]) & (sides < SurfacePart.BASAL).all(axis=1)
        touched = np.isin(graph.triangles, graph.edges[1][meeting]).any(axis=1)
        separated = np.where(touched, SurfacePart.BASAL, regions)
        # the largest piece of each region stays, the rest goes to the regions around it
        kept = np.full(len(regions), -1)
        for region in SurfacePart:
            kept[graph.components(separated == region) == 0] = region
        regions = _without_non_manifold_vertices(graph, graph.random_walker(kept, len(SurfacePart)))
        if (regions == before).all():
            return regions
    raise InputError(
        f"{name}: no clean borders between endocardia, epicardium and base found; remesh the "
        "surface evenly, or give its parts one by one"
    )


def _without_non_manifold_vertices(graph: DualGraph, regions: Integers) -> Integers:
    """Give all triangles about a vertex at which a region touches itself to one region."""
    sides = regions[graph.edges[0]]
    border = graph.edges[1][sides[:, 0] != sides[:, 1]]
    changes = np.bincount(border.ravel(), minlength=len(graph.vertices))
    corners = graph.triangles.ravel()
    present = np.zeros((len(graph.vertices), len(SurfacePart)), dtype=bool)
    present[corners, np.repeat(regions, 3)] = True
    # around a vertex k regions change k times (two regions twice), more if one touches itself
    kinds = present.sum(axis=1)
    touching = (changes > kinds) & (changes > 2)
    result = regions.copy()
    for vertex in np.flatnonzero(touching):
        around = np.flatnonzero((graph.triangles == vertex).any(axis=1))
        result[around] = (
            SurfacePart.BASAL if present[vertex, SurfacePart.BASAL] else regions[around[0]]
        )
    return result


def _openings(graph: DualGraph, regions: Integers, name: str) -> tuple[str, ...]:
    """Notes on cavities with several openings; a surface without base or epicardium is refused."""
    for region, part in ((SurfacePart.OUTER, "epicardium"), (SurfacePart.BASAL, "base")):
        if not (regions == region).any():
            raise InputError(
                f"{name}: no {part} found around the cavities; give the surface's parts one by one"
            )
    notes = []
    for region in (SurfacePart.FIRST, SurfacePart.SECOND):
        loops = boundary_loops(graph.triangles[regions == region])
        if len(loops) > 1:
            loops.sort(key=lambda loop: -loop_length(graph.vertices, loop))
            volume = _millilitres(graph, regions == region)
            base, *valves = (place(graph.vertices[loop].mean(axis=0)) for loop in loops)
            notes.append(
                f"surface: the cavity of {volume:.3g} ml has {len(loops)} openings: the longest, "
                f"about {base}, is taken as the base, the others as valves ({', '.join(valves)})"
            )
    return tuple(notes)
