"""Labels of a surface whose borders are clean loops."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.labelled_surface import BASAL, Label
from fascicle.mesh.measures import edge_lengths, triangle_areas, triangle_normals, unit
from fascicle.mesh.topology import components_of, interior_edges

ENDOCARDIAL = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
SMALL = 0.05  # of the area with this label; smaller pieces apart from the rest are mistakes
ROUNDS = 20  # of cleaning; each leaves less to do, and real surfaces need two or three


def labels_from_points(vertices: Floats, triangles: Integers, at_points: Integers) -> Integers:
    """Labels of triangles from those of their corners.

    Whether the points on the edge of the base are labelled as base or as what lies below differs
    between programs, so two rules are tried: basal is a triangle with any basal corner, or one with
    three. Both lead the border along points, where a majority of corners would lead it to and fro.
    The rule that keeps endocardium and epicardium apart is taken; between equals, the one whose
    borders of the base lie on the sharper edges.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        The closed surface (mm).
    at_points : (n,) array
        A `Label` for each vertex.

    Returns
    -------
    (m,) array
        A `Label` for each triangle.
    """
    corners = at_points[triangles]
    basal = np.isin(corners, BASAL)
    candidates = []
    for is_base in (basal.any(axis=1), basal.all(axis=1)):
        counted = np.where(np.asarray(is_base)[:, None], basal, ~basal)
        candidates.append(_commonest(corners, counted))
    return min(candidates, key=lambda labels: _border_cost(vertices, triangles, labels))


def _commonest(corners: Integers, counted: Booleans) -> Integers:
    """The label that most of the counted corners have, the lowest of equals, shape (m,)."""
    kinds = np.array(sorted(Label), dtype=np.int64)
    votes = ((corners[:, :, None] == kinds) & counted[:, :, None]).sum(axis=1)
    return np.asarray(kinds[votes.argmax(axis=1)])


def _border_cost(vertices: Floats, triangles: Integers, labels: Integers) -> tuple[float, float]:
    """Length of border from endocardium to epicardium, and bluntness of the base's borders."""
    edges, across, _ = interior_edges(triangles)
    one, other = labels[across].T
    length = edge_lengths(vertices, edges)
    touch = (one != other) & ~np.isin(one, BASAL) & ~np.isin(other, BASAL)
    rim = np.isin(one, BASAL) != np.isin(other, BASAL)
    normals = unit(triangle_normals(vertices, triangles))
    cosine = np.einsum("ij,ij->i", normals[across[:, 0]], normals[across[:, 1]])
    return float(length[touch].sum()), float((cosine * length)[rim].sum() / length[rim].sum())


def cleaned_labels(vertices: Floats, triangles: Integers, labels: Integers) -> Integers:
    """Labels without small components, spurs and non-manifold vertices.

    A component with less than a twentieth of its label's area takes the label that it borders on
    longest; a basal one only if it borders on one label alone, since an annulus may be small. A
    spur, a triangle with two neighbours of the base, becomes base, and so do the triangles around a
    vertex where an endocardium touches itself.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        The closed surface (mm), each edge shared by two triangles.
    labels : (m,) array
        A `Label` for each triangle.
    """
    edges, across, _ = interior_edges(triangles)
    length = edge_lengths(vertices, edges)
    area = triangle_areas(vertices, triangles)
    labels = labels.copy()
    for _ in range(ROUNDS):
        before = labels.copy()
        _remove_small_components(labels, across, length, area)
        _remove_spurs(labels, across)
        for label in ENDOCARDIAL:
            _split_non_manifold_vertices(labels, triangles, edges, across, label)
        if (labels == before).all():
            break
    return labels


def _remove_small_components(
    labels: Integers, across: Integers, length: Floats, area: Floats
) -> None:
    """Give small pieces the label around them, in place."""
    same = labels[across[:, 0]] == labels[across[:, 1]]
    piece = components_of(across[same], len(labels))
    count = piece.max() + 1
    of_piece = np.zeros(count, dtype=np.int64)
    of_piece[piece] = labels
    areas = np.bincount(piece, area, count)
    whole = np.bincount(of_piece, areas)
    border = np.zeros((count, max(Label) + 1))
    for here, there in ((0, 1), (1, 0)):
        rows = across[~same]
        np.add.at(border, (piece[rows[:, here]], labels[rows[:, there]]), length[~same])
    small = (areas < SMALL * whole[of_piece]) & border.any(axis=1)
    small &= ~np.isin(of_piece, BASAL) | ((border > 0).sum(axis=1) == 1)
    labels[:] = np.where(small, border.argmax(axis=1), of_piece)[piece]


def _remove_spurs(labels: Integers, across: Integers) -> None:
    """Give triangles that reach into the base with two edges its label, in place."""
    for label in BASAL:
        around = np.zeros(len(labels), dtype=np.int64)
        for here, there in ((0, 1), (1, 0)):
            np.add.at(around, across[:, here], labels[across[:, there]] == label)
        labels[(around >= 2) & ~np.isin(labels, BASAL)] = label


def _split_non_manifold_vertices(
    labels: Integers, triangles: Integers, edges: Integers, across: Integers, label: Label
) -> None:
    """Give the triangles around a vertex where the border passes twice another label, in place."""
    inside = labels[across] == label
    rim = edges[inside[:, 0] != inside[:, 1]]
    passes = np.bincount(rim.ravel(), minlength=int(triangles.max()) + 1)
    for vertex in np.flatnonzero(passes > 2):
        star = np.flatnonzero((triangles == vertex).any(axis=1))
        others = labels[star][labels[star] != label]
        basal = others[np.isin(others, BASAL)]
        kinds = basal if basal.size else others
        labels[star] = np.where(labels[star] == label, np.bincount(kinds).argmax(), labels[star])
