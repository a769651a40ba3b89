"""Closed labelled surfaces: what is wrong with one is repaired, or refused with its place."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import replace

import igl
import numpy as np

from fascicle.build.label_cleaning import ENDOCARDIAL, cleaned_labels
from fascicle.build.sides import check_labelled_sides
from fascicle.build.surface_checks import check_edges, oriented_piece, place
from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledSurface, missing_parts
from fascicle.heart.validate import check_units
from fascicle.mesh.intersections import self_intersections
from fascicle.mesh.measures import closed_volume, loop_length, turned_outwards
from fascicle.mesh.meshing import signals_restored
from fascicle.mesh.topology import (
    boundary_loops,
    boundary_triangles,
    directed_edges,
    fan,
    merged_vertices,
    whole_triangles,
    without_unused_vertices,
)

MERGED = 1e-6  # of the largest extent; vertices closer than this are one
LARGEST_HOLE = 20.0  # mm, length of its boundary; 6 mm across, so no valve or vessel is closed over
# Of a surface that is meshed through its cuts: how far the new one may lie from it (0.3 mm on a
# heart), and the edge length inside, both relative to the diagonal, and when to be content with the
# inside: only the boundary is kept.
ENVELOPE = 2e-3
COARSE = 0.05
CONTENT = 100.0  # AMIPS energy; 3 is a regular tetrahedron, the program's own choice 10
PASSES = 5
VOLUME_KEPT = 0.02  # relative change of volume that a repair may make
# How often it is tried: as its program shuffles the triangles, about one time in ten leaves an edge
# in which four triangles of the boundary meet, and the next does not.
SHUFFLES = 4


def prepared_surface(surface: LabelledSurface) -> LabelledSurface:
    """Make a labelled surface fit for meshing, or say what is wrong with it.

    Repeated vertices and triangles, triangles without an area, holes with a boundary of at most
    20 mm, triangles facing the wrong way and small components of labels are repaired. Where parts
    cut through one another, fTetWild meshes the inside and its boundary is taken instead. This
    takes a minute or more, and as fTetWild shuffles the triangles by a seed of its own, that
    boundary differs from run to run (within 0.002 of the diagonal); everything else gives the same
    result every time.

    Parameters
    ----------
    surface : LabelledSurface
        As it was read.

    Returns
    -------
    LabelledSurface
        Closed, in one piece, not cutting itself, and facing outwards; each endocardium in one
        piece.

    Raises
    ------
    InputError
        If it is not in mm, lacks a label, has several pieces, edges shared by more than two
        triangles, or larger holes, cannot be repaired, or has LV and RV exchanged.

    References
    ----------
    Hu et al. 2020, ACM Trans Graph 39(4):117 (fTetWild).
    """
    missing = missing_parts(surface.labels)
    if missing:
        there = ", ".join(str(number) for number in np.unique(surface.labels))
        raise InputError(
            f"{surface.name}: no triangle is labelled {' or '.join(missing)} (labels there: "
            f"{there}); label base 1, epicardium 2, LV 3, RV 4, or say which number is what"
        )
    closed = closed_surface(surface)
    cuts = self_intersections(closed.vertices, closed.triangles)
    if len(cuts):
        closed = _meshed_through(closed, cuts)
    labels = cleaned_labels(closed.vertices, closed.triangles, closed.labels)
    cleaned = replace(closed, labels=labels)
    for label in ENDOCARDIAL:
        _check_one_endocardium(cleaned, label)
    check_labelled_sides(cleaned)
    return cleaned


def closed_surface(surface: LabelledSurface) -> LabelledSurface:
    """Merge repeated vertices, drop broken triangles, close small holes and face outwards.

    Raises
    ------
    InputError
        If it is not in mm, has several pieces, edges shared by more than two triangles, larger
        holes or no inside, or touches itself.
    """
    check_units(surface.name, surface.vertices)
    extent = float(np.ptp(surface.vertices, axis=0).max())
    merged = merged_vertices(surface.vertices, MERGED * extent)[surface.triangles]
    whole = whole_triangles(merged)
    merged_surface = replace(surface, triangles=merged[whole], labels=surface.labels[whole])
    return oriented_outwards(_with_holes_filled(compacted(merged_surface)))


def compacted(surface: LabelledSurface) -> LabelledSurface:
    """Leave out vertices that no triangle has."""
    vertices, triangles = without_unused_vertices(surface.vertices, surface.triangles)
    return replace(surface, vertices=vertices, triangles=triangles)


def _with_holes_filled(surface: LabelledSurface) -> LabelledSurface:
    """Close small holes by a fan of triangles, which take the label of most around them."""
    check_edges(surface.name, surface.vertices, surface.triangles)
    oriented = oriented_piece(surface.name, surface.vertices, surface.triangles)
    loops = boundary_loops(oriented)
    vertices, triangles, labels = [surface.vertices], [oriented], [surface.labels]
    for loop in loops:
        ring = surface.vertices[loop]
        length = loop_length(surface.vertices, loop)
        if length > LARGEST_HOLE:
            raise InputError(
                f"{surface.name}: the surface is not closed: a hole {length:.0f} mm around at "
                f"{place(ring.mean(axis=0))}, {len(loops)} holes in all; close it (holes up to "
                f"{LARGEST_HOLE:g} mm around are closed here)"
            )
        if len(loop) == 3:
            filling = loop[::-1][None]
        else:
            filling = fan(loop, sum(map(len, vertices)))
            vertices.append(ring.mean(axis=0, keepdims=True))
        around = surface.labels[np.isin(surface.triangles, loop).sum(axis=1) >= 2]
        triangles.append(filling)
        labels.append(np.full(len(filling), np.bincount(around).argmax()))
    return replace(
        surface,
        vertices=np.concatenate(vertices),
        triangles=np.concatenate(triangles).astype(np.int64),
        labels=np.concatenate(labels),
    )


def oriented_outwards(surface: LabelledSurface) -> LabelledSurface:
    """Turn the triangles of a closed surface in one piece so that they face outwards.

    Raises
    ------
    InputError
        If it has no inside, several pieces, or touches itself.
    """
    check_edges(surface.name, surface.vertices, surface.triangles)
    triangles = oriented_piece(surface.name, surface.vertices, surface.triangles)
    directed = directed_edges(triangles)
    if len(np.unique(directed, axis=0)) < len(directed):
        raise InputError(
            f"{surface.name}: the surface has no inside (it is one-sided); remesh or repair it"
        )
    bad = np.flatnonzero(~np.asarray(igl.is_vertex_manifold(triangles)).ravel())
    if bad.size:
        raise InputError(
            f"{surface.name}: at {bad.size} vertices the surface touches itself (the first at "
            f"{place(surface.vertices[bad[0]])}); draw the parts apart there"
        )
    return replace(surface, triangles=turned_outwards(surface.vertices, triangles))


def _meshed_through(surface: LabelledSurface, cuts: Integers) -> LabelledSurface:
    """The boundary of tetrahedra that fill a surface which cuts itself, with its labels."""
    for _ in range(SHUFFLES):
        try:
            return _boundary_of_filling(surface)
        except InputError as error:
            found = str(error).removeprefix(f"{surface.name}: ")
    at = place(surface.vertices[surface.triangles[cuts[0, 0]]].mean(axis=0))
    raise InputError(
        f"{surface.name}: {len(np.unique(cuts))} triangles cut through one another (the first at "
        f"{at}), and the repair failed: {found}; remesh the surface there"
    )


def _boundary_of_filling(surface: LabelledSurface) -> LabelledSurface:
    """Fill it once, and refuse a boundary that is no better; the caller says of which surface."""
    import pytetwild

    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), signals_restored():
        # it leaves a file (__tracked_surface.stl) where it runs
        vertices, tetrahedra = pytetwild.tetrahedralize(
            np.ascontiguousarray(surface.vertices, dtype=np.float64),
            np.ascontiguousarray(surface.triangles, dtype=np.int32),
            edge_length_fac=COARSE,
            epsilon=ENVELOPE,
            stop_energy=CONTENT,
            num_opt_iter=PASSES,
            simplify=False,  # which took nine tenths of the time
            quiet=True,
        )
    if not len(tetrahedra):
        raise InputError("nothing was left")
    triangles, _ = boundary_triangles(tetrahedra)
    vertices = np.asarray(vertices, dtype=float)
    middle = vertices[triangles].mean(axis=1)
    _, nearest, _ = igl.point_mesh_squared_distance(middle, surface.vertices, surface.triangles)
    labels = surface.labels[nearest]
    boundary = oriented_outwards(
        compacted(LabelledSurface(vertices, triangles, labels, surface.name))
    )
    before, after = (closed_volume(s.vertices, s.triangles) for s in (surface, boundary))
    change = after / before - 1
    if abs(change) > VOLUME_KEPT:
        raise InputError(f"the volume changed by {change:+.0%}")
    left = self_intersections(boundary.vertices, boundary.triangles)
    if len(left):
        at = place(boundary.vertices[boundary.triangles[left[0, 0]]].mean(axis=0))
        raise InputError(f"the new one still cuts itself (at {at})")
    return boundary


def _check_one_endocardium(surface: LabelledSurface, label: Label) -> None:
    name = f"{surface.name}: {label.words}"
    triangles = oriented_piece(name, surface.vertices, surface.having(label))
    if not boundary_loops(triangles):
        raise InputError(f"{name}: the surface is closed; it must be open at the base")
