"""The endocardia of a labelled mesh: disks in register with it, open at the base."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fascicle.build.label_cleaning import cleaned_labels
from fascicle.build.surface_checks import place
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import oriented_into_cavity
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.measures import best_plane, loop_length
from fascicle.mesh.meshing import constrained_delaunay
from fascicle.mesh.topology import boundary_loops, without_unused_vertices


class EndocardialSurface(NamedTuple):
    """One endocardium, in register with the mesh that it comes from.

    Attributes
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm), exactly those of the mesh's vertices, and vertex indices,
        counter-clockwise seen from inside the cavity.
    valve : (m,) array of bool
        Triangles that close a valve's opening: no tissue is there.
    """

    vertices: Floats
    triangles: Integers
    valve: Booleans


def endocardia(mesh: LabelledMesh) -> tuple[EndocardialSurface, EndocardialSurface]:
    """Take the endocardia from a mesh's boundary.

    Small components, spurs and non-manifold vertices of the labels are cleaned first. Where an
    endocardium has several openings, as the mitral and the aortic one with tissue between them, all
    but the longest are closed by triangles between their vertices.

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
    mesh: LabelledMesh, labels: Integers, label: Label, side: str
) -> EndocardialSurface:
    name = f"{mesh.name}: {side} endocardium"
    own = mesh.triangles[labels == label]
    if not len(own):
        raise InputError(f"{name}: no triangle of the boundary has label {label}; label it")
    vertices, tissue = without_unused_vertices(mesh.vertices, own)
    loops = sorted(boundary_loops(tissue), key=lambda loop: loop_length(vertices, loop))
    caps = [_cap(vertices, loop, name) for loop in loops[:-1]]
    triangles = np.concatenate([tissue, *caps])
    valve = np.arange(len(triangles)) >= len(tissue)
    return EndocardialSurface(vertices, oriented_into_cavity(vertices, triangles, name), valve)


def _cap(vertices: Floats, loop: Integers, name: str) -> Integers:
    """Triangles between the vertices of a loop, constrained Delaunay in its best plane."""
    points = vertices[loop]
    centre, frame = best_plane(points, np.ones(len(loop)))
    triangles, missing = constrained_delaunay(
        ((points - centre) @ frame.T)[:, :2], [np.arange(len(loop))]
    )
    if missing.size:
        raise InputError(
            f"{name}: the edge of an opening crosses itself, seen along its normal, about "
            f"{place(points[missing[0]])}; smooth it"
        )
    return loop[triangles]
