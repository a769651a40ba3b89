"""Tetrahedra inside a closed labelled surface; those of a file meshed again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.endocardia import cleaned_labels
from fascicle.build.labelled_files import Anatomy
from fascicle.build.surface_checks import check_edge_length, wall_thickness
from fascicle.build.surface_meshing import remeshed_surface
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.memory import available_memory
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.measures import closed_volume, principal_axes, quality
from fascicle.mesh.meshing import NOTHING, Interface, remeshed_tetrahedra, tetrahedralise
from fascicle.mesh.topology import boundary_triangles, places_in


def mesh_surface(
    surface: LabelledSurface, edge_length: float, progress: StageProgress = no_progress
) -> LabelledMesh:
    """Fill a closed labelled surface, as `prepared_surface` gives it, with tetrahedra.

    Mmg remeshes the surface and keeps the borders between labels, Netgen fills it, and Mmg brings
    the inside to the edge length (mm), whose mean is kept within 5 %, while the surface stays. The
    same surface gives the same mesh.
    """
    check_edge_length(wall_thickness(surface), edge_length, surface.name)
    check_memory(surface, edge_length)
    progress(0, 3)
    remeshed = remeshed_surface(surface, edge_length)
    progress(1, 3)
    vertices, tetrahedra, _ = tetrahedralise(
        [Interface(remeshed.vertices, remeshed.triangles, 1, NOTHING)],
        f"{surface.name}: the inside of the surface with edges of {edge_length:g} mm",
        "give a shorter edge length, or smooth the surface",
        maxh=edge_length,
    )
    progress(2, 3)
    mesh = _remeshed_inside(remeshed, vertices, tetrahedra, hsiz=edge_length)
    # coarse borders can touch themselves
    mesh = replace(mesh, labels=cleaned_labels(mesh.vertices, mesh.triangles, mesh.labels))
    progress(3, 3)
    return mesh


def check_memory(surface: LabelledSurface, edge_length: float) -> None:
    """Refuse an edge length (mm) whose mesh would not fit in the memory that is free."""
    if not (np.isfinite(edge_length) and edge_length > 0):
        raise InputError(f"edge length: {edge_length:g} mm; it must be above 0")
    # measured on a heart of 145 ml: 2.0 (1 mm) to 2.4 (3 mm) vertices in a cube of that side, and
    # 1.6 GB for 292,000 vertices
    vertices = 2.2 * closed_volume(surface.vertices, surface.triangles) / edge_length**3
    needed, free = 6e3 * vertices, available_memory()
    if needed > free:
        fitting = edge_length * (needed / free) ** (1 / 3)
        raise InputError(
            f"{surface.name}: an edge length of {edge_length:g} mm would give about "
            f"{vertices:.2g} vertices, for which meshing needs {needed / 1e9:.1f} GB and "
            f"{free / 1e9:.1f} GB are free; give {np.ceil(fitting * 100) / 100:.2f} mm or more"
        )


def _remeshed_inside(
    surface: LabelledSurface | LabelledMesh,
    vertices: Floats,
    tetrahedra: Integers,
    **options: float,
) -> LabelledMesh:
    """Mesh the inside of a surface again by Mmg; its vertices are the first of the tetrahedra's."""
    positions, refined, triangles, labels = remeshed_tetrahedra(
        vertices, tetrahedra, surface.triangles, surface.labels, **options
    )
    boundary, _ = boundary_triangles(refined)
    at = places_in(boundary, triangles)
    if at.min() < 0:
        raise RuntimeError("the boundary is not the surface that was to stay")
    return LabelledMesh(positions, refined, boundary, labels[at], name=surface.name)


def remeshed_anatomy(anatomy: Anatomy) -> Anatomy:
    """Mesh the inside of labelled tetrahedra again, with edges as long as they were.

    The boundary stays. Fibres and sheets are axes without a sign: the new one is the principal axis
    of the mean of f fᵀ over the four nearest tetrahedra, weighted by the inverse of their distance.
    A region is that of the nearest tetrahedron. Endocardia and labels do not change.
    """
    mesh = anatomy.mesh
    new = _remeshed_inside(mesh, mesh.vertices, mesh.tetrahedra, optim=1)
    before, after = (quality(each.vertices, each.tetrahedra).angles.min() for each in (mesh, new))
    centres = [each.vertices[each.tetrahedra].mean(axis=1) for each in (mesh, new)]
    distance, near = cKDTree(centres[0]).query(centres[1], k=4)
    weights = 1 / (distance + 1e-9)  # an unchanged tetrahedron outweighs all others
    note = (
        f"mesh: its inside was meshed again and its surface kept: {len(mesh.tetrahedra)} "
        f"tetrahedra before, {len(new.tetrahedra)} after; smallest dihedral angle {before:.1f} "
        f"degrees before, {after:.1f} after; fibres, sheets and regions are those of the nearest "
        "tetrahedra"
    )
    return replace(
        anatomy,
        mesh=replace(new, regions=None if mesh.regions is None else mesh.regions[near[:, 0]]),
        fibres=None if anatomy.fibres is None else mean_axes(anatomy.fibres[near], weights),
        sheets=None if anatomy.sheets is None else mean_axes(anatomy.sheets[near], weights),
        coordinates=None,
        notes=(*anatomy.notes, note),
        own_mesh=False,
    )


def mean_axes(directions: Floats, weights: Floats) -> Floats:
    """Mean axes (n, 3) of unit vectors (n, k, 3) with weights (n, k), whose signs do not count.

    Each has the sign of the first direction.
    """
    axes = principal_axes(np.sqrt(weights)[..., None] * directions)
    sign = np.sign(np.einsum("ni,ni->n", axes, directions[:, 0]))
    return np.asarray(axes * np.where(sign == 0, 1, sign)[:, None])
