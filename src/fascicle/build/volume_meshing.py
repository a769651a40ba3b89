"""Tetrahedra inside a closed labelled surface; those of a file repaired and meshed again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.endocardia import cleaned_labels
from fascicle.build.labelled_files import Anatomy
from fascicle.build.surface_checks import check_edge_length, place, wall_thickness
from fascicle.build.surface_meshing import remeshed_surface
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.memory import available_memory
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.measures import closed_volume, principal_axes, quality, signed_volumes
from fascicle.mesh.meshing import NOTHING, Interface, remeshed_tetrahedra, tetrahedralise
from fascicle.mesh.topology import boundary_triangles, components_of, places_in, unique_edges


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


def repaired_edges(anatomy: Anatomy) -> Anatomy:
    """Separate tetrahedra that share only an edge, if there are few such edges.

    Four or more triangles of the boundary meet in such an edge, so the boundary is not a surface.
    Each group of face-connected tetrahedra around the edge gets a separate midpoint of it, moved a
    little into the group, and its tetrahedra are halved there. No tissue is removed, and the groups
    stay joined at the edge's ends. Fibres, sheets, regions and labels are inherited. The anatomy is
    returned as it is if nothing is to be repaired, or more than one edge in a thousand.
    """
    mesh = anatomy.mesh
    edges, count = unique_edges(mesh.triangles)
    bad = edges[count > 2]
    if not len(bad) or len(bad) > max(2.0, 1e-3 * len(edges)):
        return anatomy
    vertices, tetrahedra = mesh.vertices, mesh.tetrahedra
    parent, ends = np.arange(len(tetrahedra)), np.empty((0, 2), dtype=np.int64)
    for edge in bad:
        fans = _fans(tetrahedra, edge)
        around = np.concatenate(fans)
        kept, halves = np.delete(tetrahedra, around, axis=0), []
        for fan in fans:
            new, middle = len(vertices), _middle(vertices, tetrahedra[fan], edge)
            vertices = np.concatenate([vertices, middle[None]])
            ends = np.concatenate([ends, edge[None]])
            halves += [np.where(tetrahedra[fan] == end, new, tetrahedra[fan]) for end in edge]
        order = np.concatenate([each for fan in fans for each in (fan, fan)])
        tetrahedra = np.concatenate([kept, *halves])
        parent = np.concatenate([np.delete(parent, around), parent[order]])
    triangles, _ = boundary_triangles(tetrahedra)
    whole = triangles.copy()  # the triangles that these are parts of
    for k in range(len(ends) - 1, -1, -1):  # the last ones may lie between earlier ones
        for corner in range(3):
            here = whole[:, corner] == len(mesh.vertices) + k
            there = (whole == ends[k, 0]).any(axis=1)
            whole[here, corner] = np.where(there, ends[k, 1], ends[k, 0])[here]
    note = (
        f"mesh: {len(bad)} of {len(edges)} edges of its boundary had more than two triangles (the "
        f"first at {place(mesh.vertices[bad[0]].mean(axis=0))}): the tetrahedra that met in them "
        f"alone were separated ({len(tetrahedra) - len(mesh.tetrahedra)} tetrahedra halved, none "
        "removed)"
    )
    return replace(
        anatomy,
        mesh=LabelledMesh(
            vertices,
            tetrahedra,
            triangles,
            mesh.labels[places_in(whole, mesh.triangles)],
            None if mesh.regions is None else mesh.regions[parent],
            mesh.name,
        ),
        fibres=None if anatomy.fibres is None else anatomy.fibres[parent],
        sheets=None if anatomy.sheets is None else anatomy.sheets[parent],
        notes=(*anatomy.notes, note),
    )


def _fans(tetrahedra: Integers, edge: Integers) -> list[Integers]:
    """Groups of the tetrahedra that have an edge, linked by the faces that have it."""
    around = np.flatnonzero(np.isin(tetrahedra, edge).sum(axis=1) == 2)
    opposite = tetrahedra[around][~np.isin(tetrahedra[around], edge)].reshape(-1, 2)
    _, ring = np.unique(opposite, return_inverse=True)
    ring = ring.reshape(-1, 2)
    group = components_of(ring, int(ring.max()) + 1)[ring[:, 0]]
    return [around[group == k] for k in np.unique(group)]


def _middle(vertices: Floats, fan: Integers, edge: Integers) -> Floats:
    """The middle of an edge, a tenth of the way into its tetrahedra where these stay positive."""
    middle = vertices[edge].mean(axis=0)
    inwards = vertices[fan[~np.isin(fan, edge)]].mean(axis=0) - middle
    trial = np.concatenate([vertices, (middle + 0.1 * inwards)[None]])
    halves = [np.where(fan == end, len(vertices), fan) for end in edge]
    if all((signed_volumes(trial, half) > 0).all() for half in halves):
        return np.asarray(trial[-1])
    return np.asarray(middle)
