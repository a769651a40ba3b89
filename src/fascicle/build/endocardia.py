"""Cleaned labels, whose borders are simple loops, and the endocardia as disks of the mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import oriented_into_cavity
from fascicle.heart.labelled_surface import BASAL, ENDOCARDIA, Label, LabelledMesh
from fascicle.mesh.checks import first_places
from fascicle.mesh.measures import (
    best_plane,
    edge_lengths,
    loop_length,
    triangle_areas,
    triangle_normals,
    unit,
)
from fascicle.mesh.meshing import constrained_delaunay
from fascicle.mesh.topology import (
    boundary_loops,
    components_of,
    interior_edges,
    without_unused_vertices,
)


class EndocardialSurface(NamedTuple):
    """Endocardium with vertices (n, 3) exactly those of its mesh (mm), and triangles (m, 3).

    Triangles are counter-clockwise seen from inside the cavity; where `valve` (m,) is true they
    close a valve's opening, without tissue.
    """

    vertices: Floats
    triangles: Integers
    valve: Booleans


def endocardia(mesh: LabelledMesh) -> tuple[EndocardialSurface, EndocardialSurface]:
    """Extract the left and the right endocardium, each a topological disk, from a mesh's boundary.

    Small components, spurs and non-manifold vertices of the labels are cleaned first. Where an
    endocardium has several openings, such as mitral and aortic with tissue between them, all
    but the longest are closed by triangles between their vertices.
    """
    labels = cleaned_labels(mesh.vertices, mesh.triangles, mesh.labels)
    lv, rv = (_endocardium(mesh, labels, label) for label in ENDOCARDIA)
    return lv, rv


def _endocardium(mesh: LabelledMesh, labels: Integers, label: Label) -> EndocardialSurface:
    name = f"{mesh.name}: {label.name[:2]} endocardium"
    if not len(tissue_triangles := mesh.triangles[labels == label]):
        raise InputError(f"{name}: no triangle of the boundary has label {label}; label it")
    vertices, tissue = without_unused_vertices(mesh.vertices, tissue_triangles)
    loops = sorted(boundary_loops(tissue), key=lambda loop: loop_length(vertices, loop))
    parts = [tissue]
    for loop in loops[:-1]:  # closed by constrained Delaunay triangles in its best plane
        points = vertices[loop]
        centre, frame = best_plane(points, np.ones(len(loop)))
        flat = (points - centre) @ frame.T
        cap, missing = constrained_delaunay(flat[:, :2], [np.arange(len(loop))])
        if missing.size:
            raise InputError(
                f"{name}: the edge of an opening crosses itself, seen along its normal (first: "
                f"{first_places(loop[missing], points[missing])}); smooth it"
            )
        parts.append(loop[cap])
    triangles = np.concatenate(parts)
    valve = np.arange(len(triangles)) >= len(tissue)
    return EndocardialSurface(vertices, oriented_into_cavity(vertices, triangles, name), valve)


def labels_from_points(vertices: Floats, triangles: Integers, at_points: Integers) -> Integers:
    """Labels (m,) of the triangles of a closed surface (mm) from those of their corners (n,).

    Programs differ in whether points on the edge of the base are labelled as base, so two rules are
    tried: a triangle is basal if any corner is, or if all three are. Both draw the border along
    points, where a majority vote would zigzag. The rule that better separates endocardium from
    epicardium is taken; if both do, the one whose borders of the base lie on sharper edges.
    """
    corners = at_points[triangles]
    kinds = np.array(sorted(Label), dtype=np.int64)
    basal = np.isin(corners, BASAL)
    candidates = []
    for is_base in (basal.any(axis=1), basal.all(axis=1)):
        counted = np.where(np.asarray(is_base)[:, None], basal, ~basal)
        votes = ((corners[:, :, None] == kinds) & counted[:, :, None]).sum(axis=1)
        candidates.append(np.asarray(kinds[votes.argmax(axis=1)]))  # the lowest label of a tie
    return min(candidates, key=lambda labels: _border_cost(vertices, triangles, labels))


def _border_cost(vertices: Floats, triangles: Integers, labels: Integers) -> tuple[float, float]:
    """Length (mm) of border between endocardium and epicardium, and bluntness of the base's."""
    edges, across = interior_edges(triangles)
    first, second = labels[across].T
    length = edge_lengths(vertices, edges)
    touch = (first != second) & ~np.isin(first, BASAL) & ~np.isin(second, BASAL)
    rim = np.isin(first, BASAL) != np.isin(second, BASAL)
    normals = unit(triangle_normals(vertices, triangles))
    cosine = np.einsum("ij,ij->i", normals[across[:, 0]], normals[across[:, 1]])
    return float(length[touch].sum()), float((cosine * length)[rim].sum() / length[rim].sum())


def cleaned_labels(vertices: Floats, triangles: Integers, labels: Integers) -> Integers:
    """Clean the labels (m,) of a closed surface (mm) of small components, spurs and pinches.

    A component with less than a twentieth of its label's area takes the label that it borders on
    longest; a basal one only if it borders on one label alone, since an annulus may be small. A
    spur, a triangle with two neighbours of the base, becomes base, and so do the triangles around a
    pinch, a vertex where an endocardium touches itself.
    """
    edges, across = interior_edges(triangles)
    length = edge_lengths(vertices, edges)
    area = triangle_areas(vertices, triangles)
    labels = labels.copy()
    for _ in range(20):  # each round leaves less to do; real surfaces need two or three
        before = labels.copy()
        _remove_small_components(labels, across, length, area)
        for label in BASAL:
            beyond = labels[across[:, ::-1]] == label
            around = np.bincount(across.ravel(), beyond.ravel(), len(labels))
            labels[(around >= 2) & ~np.isin(labels, BASAL)] = label
        for label in ENDOCARDIA:
            # relabel the triangles around vertices that the border of the label passes twice
            inside = labels[across] == label
            rim = edges[inside[:, 0] != inside[:, 1]]
            passes = np.bincount(rim.ravel(), minlength=int(triangles.max()) + 1)
            for vertex in np.flatnonzero(passes > 2):
                star = np.flatnonzero((triangles == vertex).any(axis=1))
                around = labels[star][labels[star] != label]
                basal = around[np.isin(around, BASAL)]
                other = np.bincount(basal if basal.size else around).argmax()
                labels[star] = np.where(labels[star] == label, other, labels[star])
        if (labels == before).all():
            break
    return labels


def _remove_small_components(
    labels: Integers, across: Integers, length: Floats, area: Floats
) -> None:
    """Give small components the label around them, in place."""
    same_label = labels[across[:, 0]] == labels[across[:, 1]]
    piece = components_of(across[same_label], len(labels))
    count = piece.max() + 1
    of_piece = np.zeros(count, dtype=np.int64)
    of_piece[piece] = labels
    areas = np.bincount(piece, area, count)
    label_areas = np.bincount(of_piece, areas)
    border = np.zeros((count, max(Label) + 1))
    for side, opposite in ((0, 1), (1, 0)):
        rows = across[~same_label]
        np.add.at(border, (piece[rows[:, side]], labels[rows[:, opposite]]), length[~same_label])
    small = (areas < 0.05 * label_areas[of_piece]) & border.any(axis=1)
    small &= ~np.isin(of_piece, BASAL) | ((border > 0).sum(axis=1) == 1)
    labels[:] = np.where(small, border.argmax(axis=1), of_piece)[piece]
