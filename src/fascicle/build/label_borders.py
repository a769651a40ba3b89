"""Borders between the labels of a surface: clean loops, without islands, teeth and pinches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fascicle.heart.labelled_surface import BASAL, Label
from fascicle.mesh.measures import triangle_normals
from fascicle.mesh.topology import interior_edges

ENDOCARDIAL = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
ISLAND = 0.05  # of the area with this label; smaller pieces apart from the rest are mistakes
ROUNDS = 20  # of cleaning; each leaves less to do, and real surfaces need two or three


def labels_from_points(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], at_points: NDArray[np.int64]
) -> NDArray[np.int64]:
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


def _commonest(corners: NDArray[np.int64], counted: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The label that most of the counted corners have, the lowest of equals, shape (m,)."""
    kinds = np.array(sorted(Label), dtype=np.int64)
    votes = ((corners[:, :, None] == kinds) & counted[:, :, None]).sum(axis=1)
    return np.asarray(kinds[votes.argmax(axis=1)])


def _border_cost(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], labels: NDArray[np.int64]
) -> tuple[float, float]:
    """Length of border from endocardium to epicardium, and bluntness of the base's borders."""
    edges, across, _ = interior_edges(triangles)
    one, other = labels[across].T
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    touch = (one != other) & ~np.isin(one, BASAL) & ~np.isin(other, BASAL)
    rim = np.isin(one, BASAL) != np.isin(other, BASAL)
    normals = triangle_normals(vertices, triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    cosine = np.einsum("ij,ij->i", normals[across[:, 0]], normals[across[:, 1]])
    return float(length[touch].sum()), float((cosine * length)[rim].sum() / length[rim].sum())


def cleaned_labels(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], labels: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Labels without small islands, teeth and pinches.

    An island, a piece with less than a twentieth of its label's area, takes the label that it
    borders on longest; a basal one only if it borders on one label alone, since an annulus may be
    small. A tooth, a triangle with two neighbours of the base, becomes base, and so do the
    triangles around a vertex where an endocardium touches itself.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        The closed surface (mm), each edge shared by two triangles.
    labels : (m,) array
        A `Label` for each triangle.
    """
    edges, across, _ = interior_edges(triangles)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    area = np.linalg.norm(triangle_normals(vertices, triangles), axis=1)
    labels = labels.copy()
    for _ in range(ROUNDS):
        before = labels.copy()
        _drown_islands(labels, across, length, area)
        _cut_teeth(labels, across)
        for label in ENDOCARDIAL:
            _open_pinches(labels, triangles, edges, across, label)
        if (labels == before).all():
            break
    return labels


def _drown_islands(
    labels: NDArray[np.int64],
    across: NDArray[np.int64],
    length: NDArray[np.float64],
    area: NDArray[np.float64],
) -> None:
    """Give small pieces the label around them, in place."""
    same = labels[across[:, 0]] == labels[across[:, 1]]
    graph = coo_array((np.ones(same.sum()), across[same].T), shape=(len(labels),) * 2)
    count, piece = connected_components(graph, directed=False)
    of_piece = np.zeros(count, dtype=np.int64)
    of_piece[piece] = labels
    areas = np.bincount(piece, area, count)
    whole = np.bincount(of_piece, areas)
    border = np.zeros((count, max(Label) + 1))
    for here, there in ((0, 1), (1, 0)):
        rows = across[~same]
        np.add.at(border, (piece[rows[:, here]], labels[rows[:, there]]), length[~same])
    islands = (areas < ISLAND * whole[of_piece]) & border.any(axis=1)
    islands &= ~np.isin(of_piece, BASAL) | ((border > 0).sum(axis=1) == 1)
    labels[:] = np.where(islands, border.argmax(axis=1), of_piece)[piece]


def _cut_teeth(labels: NDArray[np.int64], across: NDArray[np.int64]) -> None:
    """Give triangles that reach into the base with two edges its label, in place."""
    for label in BASAL:
        around = np.zeros(len(labels), dtype=np.int64)
        for here, there in ((0, 1), (1, 0)):
            np.add.at(around, across[:, here], labels[across[:, there]] == label)
        labels[(around >= 2) & ~np.isin(labels, BASAL)] = label


def _open_pinches(
    labels: NDArray[np.int64],
    triangles: NDArray[np.int64],
    edges: NDArray[np.int64],
    across: NDArray[np.int64],
    label: Label,
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
