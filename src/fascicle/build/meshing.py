"""Meshing a closed labelled surface: triangles of a given edge length, tetrahedra inside."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.endocardia import cleaned_labels
from fascicle.build.labelled_files import Anatomy
from fascicle.build.surface_checks import check_edge_length, wall_thickness
from fascicle.build.surface_repair import closed_surface, compacted, oriented_outwards
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.isolated import available_memory
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.checks import first_places
from fascicle.mesh.measures import (
    closed_volume,
    edge_lengths,
    mean_edge_length,
    principal_axes,
    quality,
    self_intersections,
    triangle_areas,
)
from fascicle.mesh.meshing import Interface, remeshed_tetrahedra, remeshed_triangles, tetrahedralise
from fascicle.mesh.topology import boundary_triangles, places_in


def mesh_surface(
    surface: LabelledSurface, edge_length: float, progress: StageProgress = no_progress
) -> LabelledMesh:
    """Fill a closed labelled surface, as `prepared_surface` gives it, with tetrahedra.

    Mmg remeshes the surface and keeps the borders between labels, Netgen fills it, and Mmg brings
    the inside to the edge length (mm), whose mean is kept within 5 %, while the surface stays.
    Equal surfaces give equal meshes.
    """
    check_edge_length(wall_thickness(surface), edge_length, surface.name)
    check_memory(surface, edge_length)
    return filled(surface, edge_length, progress)


def filled(
    surface: LabelledSurface, edge_length: float, progress: StageProgress = no_progress
) -> LabelledMesh:
    """Mesh as `mesh_surface` does, even with fewer than two elements across a wall."""
    progress(0, 3)
    remeshed = remeshed_surface(surface, edge_length)
    progress(1, 3)
    vertices, tetrahedra, _ = tetrahedralise(
        [Interface(remeshed.vertices, remeshed.triangles)],
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
    """Remesh the inside of a surface by Mmg; its vertices are the first of the tetrahedra's."""
    positions, refined, triangles, labels = remeshed_tetrahedra(
        vertices, tetrahedra, surface.triangles, surface.labels, **options
    )
    boundary, _ = boundary_triangles(refined)
    if (at := places_in(boundary, triangles)).min() < 0:
        raise RuntimeError("the boundary is not the surface that was to stay")
    return LabelledMesh(positions, refined, boundary, labels[at], name=surface.name)


def remeshed_anatomy(anatomy: Anatomy) -> Anatomy:
    """Mesh the inside of labelled tetrahedra again, with edges of the old lengths.

    The boundary, endocardia and labels stay; fibres, sheets and regions are `carried_over`.
    """
    mesh = anatomy.mesh
    new = _remeshed_inside(mesh, mesh.vertices, mesh.tetrahedra, optim=1)
    before, after = (
        quality(labelled.vertices, labelled.tetrahedra).angles.min() for labelled in (mesh, new)
    )
    note = (
        f"mesh: its inside was meshed again and its surface kept: {len(mesh.tetrahedra)} "
        f"tetrahedra before, {len(new.tetrahedra)} after; smallest dihedral angle {before:.1f} "
        f"degrees before, {after:.1f} after; fibres, sheets and regions are those of the nearest "
        "tetrahedra"
    )
    return replace(carried_over(anatomy, new), notes=(*anatomy.notes, note))


def carried_over(anatomy: Anatomy, new: LabelledMesh) -> Anatomy:
    """Carry an anatomy over to other tetrahedra, with properties of the nearest old ones.

    Regions are those of the nearest. Fibres and sheets are axes without a sign: the new axis is the
    principal axis of the mean of f fᵀ over the four nearest, weighted by the inverse distance.
    """
    regions = anatomy.mesh.regions
    centres = [mesh.vertices[mesh.tetrahedra].mean(axis=1) for mesh in (anatomy.mesh, new)]
    distance, near = cKDTree(centres[0]).query(centres[1], k=4)
    weights = 1 / (distance + 1e-9)  # an unchanged tetrahedron outweighs all others
    return replace(
        anatomy,
        mesh=replace(new, regions=None if regions is None else regions[near[:, 0]]),
        fibres=None if anatomy.fibres is None else mean_axes(anatomy.fibres[near], weights),
        sheets=None if anatomy.sheets is None else mean_axes(anatomy.sheets[near], weights),
        coordinates=None,
        own_mesh=False,
    )


def mean_axes(directions: Floats, weights: Floats) -> Floats:
    """Mean axes (n, 3) of unit vectors (n, k, 3) with weights (n, k), whose signs do not count.

    A mean axis has the sign of the first direction.
    """
    axes = principal_axes(np.sqrt(weights)[..., None] * directions)
    sign = np.sign(np.einsum("ni,ni->n", axes, directions[:, 0]))
    return np.asarray(axes * np.where(sign == 0, 1, sign)[:, None])


def remeshed_surface(surface: LabelledSurface, edge_length: float) -> LabelledSurface:
    """Remesh triangles to a mean edge length; the borders between labels stay.

    A first pass removes the noise of a surface from marching cubes. It keeps sharp edges, without
    which the narrow end of the right cavity would be folded; the second keeps the borders between
    labels alone (angle=0), as edges would keep badly shaped triangles. Mmg's mean length differs
    from the size that it is given, so the size is corrected iteratively. Mmg stays much
    closer to the surface than it must: on a heart the volume changes by 0.02 %, walls by 0.06 mm at
    2 mm.
    """
    smooth = _remeshed(
        without_short_edges(surface, 0.3 * edge_length),
        hmin=0.77 * edge_length,
        hmax=1.43 * edge_length,
        hausd=0.1 * edge_length,
        angle=1,
    )
    size, best, error = 1.05 * edge_length, smooth, np.inf
    for _ in range(6):  # two or three are enough
        trial = _remeshed(smooth, hsiz=size, hausd=0.4 * edge_length, angle=0)
        ratio = mean_edge_length(trial.vertices, trial.triangles) / edge_length
        if abs(ratio - 1) < error:
            best, error = trial, abs(ratio - 1)
        if error < 0.01:
            break
        # slivers that Mmg leaves must not drive the size of all the others away
        size = edge_length * float(np.clip(size / ratio / edge_length, 0.75, 1.35))
    best = oriented_outwards(compacted(best))
    if len(cuts := self_intersections(best.vertices, best.triangles)):
        at = first_places(cuts, best.vertices[best.triangles[cuts]])
        raise InputError(
            f"{surface.name}: with edges of {edge_length:g} mm the surface cuts itself in "
            f"{len(cuts)} pairs of triangles (first: {at}); give a shorter edge length, or smooth "
            "the surface there"
        )
    return best


def _remeshed(surface: LabelledSurface, **options: float) -> LabelledSurface:
    new = remeshed_triangles(surface.vertices, surface.triangles, surface.labels, **options)
    return LabelledSurface(*new, surface.name)


def without_short_edges(surface: LabelledSurface, shortest: float) -> LabelledSurface:
    """Merge the two ends of every shorter edge (mm) where the surface stays a manifold.

    It does where the ends have no common neighbour but the corners of the edge's two triangles (the
    link condition; Dey et al. 1999, Publ Inst Math 66:23-45). Mmg alone does not do as well where
    edges are as long as walls are thick: at 8 of 12 mm helix angles at the endocardium are off by
    up to 4.6 instead of 1.1 degrees.
    """
    while True:
        edges = np.asarray(igl.edges(surface.triangles))
        length = edge_lengths(surface.vertices, edges)
        short = edges[np.argsort(length, kind="stable")[: int((length < shortest).sum())]]
        target = _merge_targets(surface.triangles, short)
        moved = target != np.arange(len(target))
        if not moved.any():
            return surface
        vertices = surface.vertices.copy()
        vertices[target[moved]] = (vertices[target[moved]] + vertices[moved]) / 2
        triangles = target[surface.triangles]
        keep = (np.diff(np.sort(triangles, axis=1), axis=1) != 0).all(axis=1)
        shorter = LabelledSurface(vertices, triangles[keep], surface.labels[keep], surface.name)
        surface = compacted(shorter)


def _merge_targets(triangles: Integers, edges: Integers) -> Integers:
    """Vertex that each vertex is merged into; the collapsed edges do not touch one another."""
    near: dict[int, set[int]] = {int(vertex): set() for vertex in np.unique(edges)}
    for corners in triangles[np.isin(triangles, edges).any(axis=1)].tolist():
        for vertex in corners:
            if vertex in near:
                near[vertex].update(corners)
    target = np.arange(int(triangles.max()) + 1)
    busy: set[int] = set()
    for kept, lost in edges.tolist():
        around = near[kept] | near[lost]
        if busy.isdisjoint(around) and len(near[kept] & near[lost]) == 4:  # two of them the ends
            target[lost] = kept
            busy |= around
    return target


def subdivided(surface: LabelledSurface, edge_length: float) -> tuple[LabelledSurface, str]:
    """Refine and smooth a coarse surface: Loop subdivision, corrected for its shrinking.

    Loop's surface (1987, thesis, University of Utah) does not pass through the vertices that it
    comes from: thin walls would shrink. So each vertex is first moved by its distance from that
    surface (one step of progressive interpolation, Cheng et al. 2009, J Comput Sci Technol
    24:39-46; more make a flat base undulate), or by half of it where walls would intersect. Then
    the finer surface is moved along its normals, by hundredths of a mm, to restore the volume. The
    mean edge is then at most two edge lengths. The second result is a note for the user.
    """
    coarse = closed_surface(surface)
    before = mean_edge_length(coarse.vertices, coarse.triangles)
    levels = int(np.ceil(np.log2(before / (2.0 * edge_length))))
    # two levels approximate where a vertex ends, to a few percent
    limit = igl.loop(coarse.vertices, coarse.triangles, 2)[0][: len(coarse.vertices)]
    volume = closed_volume(coarse.vertices, coarse.triangles)
    for share in (1.0, 0.5, 0.0):
        moved = coarse.vertices + share * (coarse.vertices - np.asarray(limit, dtype=float))
        finer, parts = igl.loop(moved, coarse.triangles, levels)
        triangles = np.asarray(parts, dtype=np.int64)
        vertices = np.asarray(finer, dtype=float)
        for _ in range(3):  # Newton steps along the normals; each leaves a thousandth of the error
            missing = volume - closed_volume(vertices, triangles)
            normals = np.asarray(igl.per_vertex_normals(vertices, triangles))
            vertices = vertices + missing / triangle_areas(vertices, triangles).sum() * normals
        if not len(self_intersections(vertices, triangles)):
            break
    labels = np.repeat(coarse.labels, 4**levels)  # four consecutive triangles for each
    note = (
        f"surface: its triangles of {before:.3g} mm are coarse for edges of {edge_length:g} mm; "
        f"subdivided {levels} times (Loop) to a smooth one of "
        f"{mean_edge_length(vertices, triangles):.3g} mm; volume {volume / 1e3:.1f} ml before, "
        f"{closed_volume(vertices, triangles) / 1e3:.1f} ml after"
    )
    return replace(coarse, vertices=vertices, triangles=triangles, labels=labels), note
