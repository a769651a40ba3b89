"""Tetrahedra of a given edge length inside a closed labelled surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fascicle.build.label_cleaning import cleaned_labels
from fascicle.build.surface_remeshing import remeshed_surface
from fascicle.build.wall_thickness import check_edge_length, wall_thickness
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.memory import available_memory
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.measures import closed_volume
from fascicle.mesh.meshing import (
    NOTHING,
    Interface,
    as_float64,
    as_int32,
    signals_restored,
    tetrahedralise,
)
from fascicle.mesh.topology import boundary_triangles, places_in

# Vertices in a cube with the edge length's side (measured: 2.0 at 1 mm, 2.2 at 2 mm, 2.4 at 3 mm on
# a heart of 145 ml; the more the larger the share of the surface), and what they need at the peak
# (measured at 1 mm: 1.6 GB for 292,000).
VERTICES_PER_CUBE = 2.2
MEMORY_PER_VERTEX = 6e3  # bytes

TISSUE = 1  # Netgen's number of what is inside
STAGES = 3


def mesh_surface(
    surface: LabelledSurface, edge_length: float, progress: StageProgress = no_progress
) -> LabelledMesh:
    """Fill a closed labelled surface with tetrahedra.

    MMG remeshes the surface at the edge length and keeps the borders between labels (Dapogny et
    al., J. Comput. Phys. 262:358, 2014), Netgen fills it (Schöberl, Comput. Vis. Sci. 1:41, 1997),
    and MMG brings the inside to the edge length while the surface stays. The same surface gives the
    same mesh.

    Parameters
    ----------
    surface : LabelledSurface
        Closed and facing outwards, as `fascicle.build.surface_repair.prepared_surface` gives it.
    edge_length : float
        Mean length of the tetrahedra's edges (mm), kept within 5 %.
    progress : StageProgress
        Called with the steps done and in all.

    Raises
    ------
    InputError
        If the edge length is too coarse for the walls or too fine for the memory, or the surface
        cannot be filled.
    """
    check_edge_length(wall_thickness(surface), edge_length, surface.name)
    check_memory(surface, edge_length)
    progress(0, STAGES)
    remeshed = remeshed_surface(surface, edge_length)
    progress(1, STAGES)
    vertices, tetrahedra, _ = tetrahedralise(
        [Interface(remeshed.vertices, remeshed.triangles, TISSUE, NOTHING)],
        f"{surface.name}: the inside of the surface with edges of {edge_length:g} mm",
        "give a shorter edge length, or smooth the surface",
        maxh=edge_length,
    )
    progress(2, STAGES)
    mesh = _refined(remeshed, vertices, tetrahedra, edge_length)
    progress(STAGES, STAGES)
    return mesh


def check_memory(surface: LabelledSurface, edge_length: float) -> None:
    """Refuse an edge length whose mesh would not fit in the memory that is free.

    Raises
    ------
    InputError
        With the vertices expected, the memory needed and free, and the edge length that fits.
    """
    if not (np.isfinite(edge_length) and edge_length > 0):
        raise InputError(f"edge length: {edge_length:g} mm; it must be above 0")
    volume = closed_volume(surface.vertices, surface.triangles)
    vertices = VERTICES_PER_CUBE * volume / edge_length**3
    needed, free = MEMORY_PER_VERTEX * vertices, available_memory()
    if needed > free:
        fitting = edge_length * (needed / free) ** (1 / 3)
        raise InputError(
            f"{surface.name}: an edge length of {edge_length:g} mm would give about "
            f"{vertices:.2g} vertices, for which meshing needs {needed / 1e9:.1f} GB and "
            f"{free / 1e9:.1f} GB are free; give {np.ceil(fitting * 100) / 100:.2f} mm or more"
        )


def _refined(
    surface: LabelledSurface, vertices: Floats, tetrahedra: Integers, edge_length: float
) -> LabelledMesh:
    """The same boundary with tetrahedra of the edge length, and its labels."""
    mesh = remeshed_inside(surface, vertices, tetrahedra, hsiz=edge_length)
    labels = cleaned_labels(mesh.vertices, mesh.triangles, mesh.labels)
    return replace(mesh, labels=labels)  # coarse borders can touch themselves


def remeshed_inside(
    surface: LabelledSurface | LabelledMesh,
    vertices: Floats,
    tetrahedra: Integers,
    **options: float,
) -> LabelledMesh:
    """Mesh the inside of a boundary again by Mmg; the boundary and its labels stay.

    Parameters
    ----------
    surface : LabelledSurface or LabelledMesh
        The boundary of the tetrahedra, its vertices first among theirs.
    vertices, tetrahedra : (n, 3) and (m, 4) arrays
        Positions (mm) and vertex indices.
    **options
        Mmg's: ``hsiz``, the edge length (mm), or ``optim=1``, which keeps it as it is.
    """
    import mmgpy

    mesh = mmgpy.MmgMesh3D(as_float64(vertices), as_int32(tetrahedra))
    mesh.set_mesh_size(
        vertices=len(vertices), tetrahedra=len(tetrahedra), triangles=len(surface.triangles)
    )
    mesh.set_vertices(as_float64(vertices))
    mesh.set_tetrahedra(as_int32(tetrahedra))
    mesh.set_triangles(as_int32(surface.triangles), as_int32(surface.labels))
    with signals_restored():
        mesh.remesh(**options, nosurf=1, verbose=-1)
    refined = np.array(mesh.get_tetrahedra(), dtype=np.int64)
    labelled, labels = mesh.get_triangles_with_refs()
    boundary, _ = boundary_triangles(refined)
    positions = np.array(mesh.get_vertices(), dtype=float)
    at = places_in(boundary, np.asarray(labelled, dtype=np.int64))
    if at.min() < 0:
        raise RuntimeError("the boundary is not the surface that was to be kept")
    kept = np.asarray(labels, dtype=np.int64)[at]
    return LabelledMesh(
        vertices=positions, tetrahedra=refined, triangles=boundary, labels=kept, name=surface.name
    )
