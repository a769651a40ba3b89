"""Closed labelled surfaces: what is wrong with one is repaired, or refused with its place."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import replace

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fascicle.build.label_borders import ENDOCARDIAL, cleaned_labels
from fascicle.build.wall import check_not_swapped
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import BASAL, NEEDED, Label, LabelledSurface
from fascicle.heart.validate import check_units
from fascicle.mesh.intersections import self_intersections
from fascicle.mesh.topology import boundary_loops, boundary_triangles

WELD = 1e-6  # of the largest extent; vertices closer than this are one
LARGEST_HOLE = 20.0  # mm, length of the rim; 6 mm across, so no valve or vessel is closed over
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

    Repaired are: vertices that are there several times, triangles without an area or there twice,
    holes with a rim of at most 20 mm, triangles facing the wrong way, islands in the labels, and
    parts that cut through one another. The last are meshed by fTetWild (Hu et al., ACM Trans.
    Graph. 39(4):117, 2020), whose boundary is taken instead. This takes a minute or more, and as
    fTetWild shuffles the triangles by a seed of its own, that boundary differs from run to run
    (within 0.002 of the diagonal); everything else gives the same result every time.

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
    """
    check_units(surface.name, surface.vertices)
    _check_labels(surface)
    closed = oriented_outwards(_filled(_welded(surface)))
    cuts = self_intersections(closed.vertices, closed.triangles)
    if len(cuts):
        closed = _meshed_through(closed, cuts)
    labels = cleaned_labels(closed.vertices, closed.triangles, closed.labels)
    cleaned = replace(closed, labels=labels)
    for label in ENDOCARDIAL:
        _check_one_endocardium(cleaned, label)
    check_not_swapped(cleaned)
    return cleaned


def _check_labels(surface: LabelledSurface) -> None:
    missing = [
        label.name.replace("_", " ").lower()
        for label in NEEDED
        if not np.isin(surface.labels, BASAL if label == Label.BASE else (label,)).any()
    ]
    if missing:
        there = ", ".join(str(number) for number in np.unique(surface.labels))
        raise InputError(
            f"{surface.name}: no triangle is labelled {' or '.join(missing)} (labels there: "
            f"{there}); label base 1, epicardium 2, LV 3, RV 4, or say which number is what"
        )


def _welded(surface: LabelledSurface) -> LabelledSurface:
    """One vertex for each place, and each triangle with an area once."""
    extent = float(np.ptp(surface.vertices, axis=0).max())
    pairs = cKDTree(surface.vertices).query_pairs(WELD * extent, output_type="ndarray")
    count = len(surface.vertices)
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    triangles = first[group][surface.triangles]
    ordered = np.sort(triangles, axis=1)
    _, once = np.unique(ordered, axis=0, return_index=True)
    keep = np.zeros(len(triangles), dtype=bool)
    keep[once] = True
    keep &= (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    return compacted(replace(surface, triangles=triangles[keep], labels=surface.labels[keep]))


def compacted(surface: LabelledSurface) -> LabelledSurface:
    """Leave out vertices that no triangle has."""
    used, triangles = np.unique(surface.triangles, return_inverse=True)
    return replace(
        surface,
        vertices=surface.vertices[used],
        triangles=triangles.reshape(-1, 3).astype(np.int64),
    )


def _filled(surface: LabelledSurface) -> LabelledSurface:
    """Close small holes by a fan of triangles, which take the label of most of the rim."""
    _check_edges(surface)
    oriented, pieces = igl.bfs_orient(surface.triangles)
    _check_one_piece(surface, np.asarray(pieces))
    loops = boundary_loops(np.asarray(oriented, dtype=np.int64))
    vertices, triangles, labels = [surface.vertices], [np.asarray(oriented)], [surface.labels]
    for loop in loops:
        rim = surface.vertices[loop]
        length = float(np.linalg.norm(rim - np.roll(rim, -1, axis=0), axis=1).sum())
        if length > LARGEST_HOLE:
            raise InputError(
                f"{surface.name}: the surface is not closed: a hole with a rim of {length:.0f} mm "
                f"at {place(rim.mean(axis=0))}, {len(loops)} holes in all; close it (holes up to "
                f"{LARGEST_HOLE:g} mm are closed here)"
            )
        if len(loop) == 3:
            fan = loop[::-1][None]
        else:
            centre = np.full(len(loop), len(surface.vertices) + sum(map(len, vertices[1:])))
            fan = np.column_stack([np.roll(loop, -1), loop, centre])
            vertices.append(rim.mean(axis=0, keepdims=True))
        around = surface.labels[np.isin(surface.triangles, loop).sum(axis=1) >= 2]
        triangles.append(fan)
        labels.append(np.full(len(fan), np.bincount(around).argmax()))
    return replace(
        surface,
        vertices=np.concatenate(vertices),
        triangles=np.concatenate(triangles).astype(np.int64),
        labels=np.concatenate(labels),
    )


def place(point: NDArray[np.float64]) -> str:
    """A position as it stands in messages."""
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*point)


def _check_edges(surface: LabelledSurface) -> None:
    """Refuse edges that more than two triangles share."""
    edges = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    bad = np.flatnonzero(count > 2)
    if bad.size:
        at = surface.vertices[edges[bad[0]]].mean(axis=0)
        on = np.unique(surface.labels[np.isin(surface.triangles, edges[bad[0]]).sum(axis=1) == 2])
        names = ", ".join(Label(label).name.replace("_", " ").lower() for label in on)
        raise InputError(
            f"{surface.name}: {bad.size} edges belong to more than two triangles (the first, "
            f"of {names}, at {place(at)}); leave out sheets inside the tissue or the cavities"
        )


def _check_one_piece(surface: LabelledSurface, piece: NDArray[np.int64]) -> None:
    sizes = np.bincount(piece)
    if len(sizes) > 1:
        smallest = int(sizes.argmin())
        at = surface.vertices[surface.triangles[piece == smallest]].mean(axis=(0, 1))
        raise InputError(
            f"{surface.name}: the surface falls into {len(sizes)} pieces (the smallest, "
            f"{sizes[smallest]} triangles, at {place(at)}); keep one closed surface"
        )


def _check_vertices(surface: LabelledSurface) -> None:
    """Refuse vertices in which parts of the surface touch."""
    bad = np.flatnonzero(~np.asarray(igl.is_vertex_manifold(surface.triangles)).ravel())
    if bad.size:
        raise InputError(
            f"{surface.name}: at {bad.size} vertices the surface touches itself (the first at "
            f"{place(surface.vertices[bad[0]])}); draw the parts apart there"
        )


def oriented_outwards(surface: LabelledSurface) -> LabelledSurface:
    """Turn the triangles of a closed surface in one piece so that they face outwards.

    Raises
    ------
    InputError
        If it has no inside, several pieces, or touches itself.
    """
    _check_edges(surface)
    oriented, pieces = igl.bfs_orient(surface.triangles)
    _check_one_piece(surface, np.asarray(pieces))
    triangles = np.asarray(oriented, dtype=np.int64)
    directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    if len(np.unique(directed, axis=0)) < len(directed):
        raise InputError(
            f"{surface.name}: the surface has no inside (it is one-sided); remesh or repair it"
        )
    turned = replace(surface, triangles=triangles)
    _check_vertices(turned)
    if enclosed_volume(turned) < 0:
        turned = replace(turned, triangles=np.ascontiguousarray(triangles[:, ::-1]))
    return turned


def enclosed_volume(surface: LabelledSurface) -> float:
    """Volume inside a closed surface (mm³), positive where its triangles face outwards."""
    a, b, c = surface.vertices[surface.triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _meshed_through(surface: LabelledSurface, cuts: NDArray[np.int64]) -> LabelledSurface:
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

    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
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
    middle = np.asarray(vertices)[triangles].mean(axis=1)
    _, nearest, _ = igl.point_mesh_squared_distance(middle, surface.vertices, surface.triangles)
    meshed = LabelledSurface(
        np.asarray(vertices, dtype=float), triangles, surface.labels[nearest], surface.name
    )
    boundary = oriented_outwards(compacted(meshed))
    change = enclosed_volume(boundary) / enclosed_volume(surface) - 1
    if abs(change) > VOLUME_KEPT:
        raise InputError(f"the volume changed by {change:+.0%}")
    left = self_intersections(boundary.vertices, boundary.triangles)
    if len(left):
        at = place(boundary.vertices[boundary.triangles[left[0, 0]]].mean(axis=0))
        raise InputError(f"the new one still cuts itself (at {at})")
    return boundary


def _check_one_endocardium(surface: LabelledSurface, label: Label) -> None:
    name = "LV" if label == Label.LV_ENDOCARDIUM else "RV"
    triangles = surface.having(label)
    _, pieces = igl.bfs_orient(triangles)
    sizes = np.bincount(np.asarray(pieces))
    if len(sizes) > 1:
        second = int(np.argsort(sizes)[-2])
        at = surface.vertices[triangles[np.asarray(pieces) == second]].mean(axis=(0, 1))
        raise InputError(
            f"{surface.name}: the {name} endocardium falls into {len(sizes)} pieces (the second "
            f"largest, {sizes[second]} triangles, at {place(at)}); correct its label"
        )
    if not boundary_loops(triangles):
        raise InputError(
            f"{surface.name}: the {name} endocardium is closed; it must be open at the base"
        )
