"""The endocardia of a labelled mesh: disks in register with it, open at the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fascicle.build.label_borders import cleaned_labels
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import oriented_into_cavity
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.topology import boundary_loops

FLAT = 1e-9  # area over squared sides from which on a triangle is as bad as can be


@dataclass(frozen=True)
class EndocardialSurface:
    """One endocardium, in register with the mesh that it comes from.

    Attributes
    ----------
    vertices : (n, 3) array
        Positions (mm), exactly those of the mesh's vertices.
    triangles : (m, 3) array
        Vertex indices, counter-clockwise seen from inside the cavity.
    mesh_vertex : (n,) array
        Which vertex of the mesh each is.
    valve : (m,) array of bool
        Triangles that close a valve's opening: no tissue is there.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    mesh_vertex: NDArray[np.int64]
    valve: NDArray[np.bool_]


def endocardia(mesh: LabelledMesh) -> tuple[EndocardialSurface, EndocardialSurface]:
    """Take the endocardia from a mesh's boundary.

    Islands, teeth and pinches of the labels are cleaned first. Where an endocardium has several
    openings, as the mitral and the aortic one with tissue between them, all but the longest are
    closed by triangles between their vertices, chosen for their shape.

    Parameters
    ----------
    mesh : LabelledMesh
        With both endocardia labelled.

    Returns
    -------
    lv, rv : EndocardialSurface
        Each a disk with one boundary loop.

    Raises
    ------
    InputError
        If a label is missing, or an endocardium is not in one piece, or has a handle.
    """
    labels = cleaned_labels(mesh.vertices, mesh.triangles, mesh.labels)
    return (
        _endocardium(mesh, labels, Label.LV_ENDOCARDIUM, "LV"),
        _endocardium(mesh, labels, Label.RV_ENDOCARDIUM, "RV"),
    )


def _endocardium(
    mesh: LabelledMesh, labels: NDArray[np.int64], label: Label, side: str
) -> EndocardialSurface:
    name = f"{mesh.name}: {side} endocardium"
    own = mesh.triangles[labels == label]
    if not len(own):
        raise InputError(f"{name}: no triangle of the boundary has label {label}; label it")
    mesh_vertex, local = np.unique(own, return_inverse=True)
    vertices, tissue = mesh.vertices[mesh_vertex], local.reshape(-1, 3).astype(np.int64)
    loops = sorted(boundary_loops(tissue), key=lambda loop: _length(vertices[loop]))
    caps = [_cap(vertices, loop) for loop in loops[:-1]]
    triangles = np.concatenate([tissue, *caps])
    valve = np.arange(len(triangles)) >= len(tissue)
    return EndocardialSurface(
        vertices, oriented_into_cavity(vertices, triangles, name), mesh_vertex, valve
    )


def _length(points: NDArray[np.float64]) -> float:
    """Length of a closed line."""
    return float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum())


def _cap(vertices: NDArray[np.float64], loop: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles between the vertices of a loop, the best shaped ones in all.

    By dynamic programming over stretches of the loop: the best cap of the stretch from i to j has a
    triangle i, k, j and the best caps of i to k and of k to j.
    """
    points = vertices[loop]
    count = len(loop)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), dtype=np.int64)
    for span in range(2, count):
        for i in range(count - span):
            j = i + span
            between = np.arange(i + 1, j)
            bad = _badness(points[i], points[between], points[j])
            totals = cost[i, between] + cost[between, j] + bad
            best = int(totals.argmin())
            middle[i, j], cost[i, j] = between[best], totals[best]
    triangles, stretches = [], [(0, count - 1)]
    while stretches:
        i, j = stretches.pop()
        if j - i >= 2:
            k = int(middle[i, j])
            triangles.append((j, k, i))
            stretches += [(i, k), (k, j)]
    return np.asarray(loop[np.array(triangles)], dtype=np.int64)


def _badness(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sum of the squared sides over the area: 4√3 for a regular triangle, huge for a flat one."""
    sides = ((b - a) ** 2).sum(axis=-1) + ((c - b) ** 2).sum(axis=-1) + ((c - a) ** 2).sum()
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2
    return np.asarray(sides / np.maximum(area, FLAT * sides))
