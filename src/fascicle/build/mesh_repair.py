"""Repairs of a file's tetrahedra: orientation, crumbs, voids, contact, pieces that are joined."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from fascicle.build.labelled_files import Anatomy
from fascicle.build.segmentation import largest_pieces
from fascicle.build.surface_repair import (
    LARGEST_CRUMB,
    SampledDistance,
    oriented_outwards,
    small_pieces,
)
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import ENDOCARDIA, LabelledMesh, LabelledSurface
from fascicle.mesh.checks import first_places, place
from fascicle.mesh.measures import closed_volume, signed_volumes
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.meshing import Interface, tetrahedralise
from fascicle.mesh.topology import (
    boundary_triangles,
    components_of,
    faces_in_order,
    merged_vertices,
    pieces_of,
    places_in,
    unique_edges,
    without_unused_vertices,
)


def repaired_mesh(mesh: MeshFile) -> tuple[MeshFile, tuple[str, ...]]:
    """Turn tetrahedra that are all inverted, drop crumbs and fill small voids; with notes.

    A crumb is a piece of at most `LARGEST_CRUMB` that shares no face with the rest. A void is a
    closed cavity in the tissue; the tetrahedra that fill it have a neighbour's values in every
    array. Triangles of the file that are no longer on the boundary are left out.
    """
    tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    notes: list[str] = []
    # another program's convention, or the file is mirrored
    if (signed_volumes(mesh.points, tetrahedra) < 0).all():
        tetrahedra = tetrahedra[:, [0, 2, 1, 3]]
        mesh = replace(mesh, cells={**mesh.cells, TETRAHEDRON: tetrahedra})
        notes.append(
            "tetrahedra: all were inverted and have been turned; if left and right are exchanged "
            "in the picture, the file is mirrored"
        )
    before, _ = boundary_triangles(tetrahedra)
    repaired = _with_voids_filled(_without_crumbs(mesh, notes), notes)
    if repaired is mesh or TRIANGLE not in mesh.cells:
        return repaired, tuple(notes)
    after, _ = boundary_triangles(repaired.cells[TETRAHEDRON])
    triangles = mesh.cells[TRIANGLE]
    lost = (places_in(triangles, before) >= 0) & (places_in(triangles, after) < 0)
    return repaired.keeping(TRIANGLE, ~lost), tuple(notes)


def _without_crumbs(mesh: MeshFile, notes: list[str]) -> MeshFile:
    """Drop small pieces that hang by an edge, by a vertex, or not at all."""
    tetrahedra = mesh.cells[TETRAHEDRON]
    piece = components_of(_neighbours(tetrahedra), len(tetrahedra))
    if not (small := small_pieces(piece, mesh.points[tetrahedra])).size:
        return mesh
    dropped = np.isin(piece, small)
    first = np.array([np.argmax(piece == k) for k in small[:3]])
    notes.append(
        f"mesh: pieces of at most {LARGEST_CRUMB:g} mm that share no face with the rest were left "
        f"out: {len(small)}, with {dropped.sum()} of {len(dropped)} tetrahedra (first: "
        f"{first_places(first, mesh.points[tetrahedra[first]])})"
    )
    return mesh.keeping(TETRAHEDRON, ~dropped)


def _neighbours(tetrahedra: Integers) -> Integers:
    """Pairs (k, 2) of tetrahedra that share a face."""
    order, shared = faces_in_order(tetrahedra)
    return np.column_stack([order[:-1][shared], order[1:][shared]]) // 4


def _with_voids_filled(mesh: MeshFile, notes: list[str]) -> MeshFile:
    """Fill closed cavities of at most `LARGEST_CRUMB` with tetrahedra."""
    tetrahedra = mesh.cells[TETRAHEDRON]
    boundary, owner = boundary_triangles(tetrahedra)
    apart, _ = igl.split_nonmanifold(boundary)  # a void may touch another, or the outer surface
    piece = np.asarray(igl.facet_components(apart)[1])
    points, added, rows, volume = mesh.points, [tetrahedra], [np.arange(len(tetrahedra))], 0.0
    point_rows = [np.arange(len(points))]
    for k in small_pieces(piece, mesh.points[boundary]):
        around = boundary[piece == k]
        vertices, triangles = without_unused_vertices(mesh.points, around)
        volume -= closed_volume(vertices, triangles)
        filled, inside, _ = tetrahedralise(
            [Interface(vertices, triangles[:, ::-1])],
            f"{mesh.path}: a void in the tissue about {place(vertices.mean(axis=0))}",
            "fill it, or remesh the tissue",
        )
        new = filled[len(vertices) :]
        number = np.concatenate([np.unique(around), len(points) + np.arange(len(new))])
        points = np.concatenate([points, new])
        added.append(number[inside])
        middle = points[added[-1]].mean(axis=1)
        nearest = cKDTree(mesh.points[around].mean(axis=1)).query(middle)[1]
        rows.append(owner[piece == k][nearest])
        point_rows.append(np.full(len(new), around[0, 0]))
    if len(added) == 1:
        return mesh
    row, at = np.concatenate(rows), np.concatenate(point_rows)
    extended = mesh.keeping(TETRAHEDRON, row)
    first = ", ".join(place(points[inside].mean(axis=(0, 1))) for inside in added[1:4])
    notes.append(
        f"mesh: voids of at most {LARGEST_CRUMB:g} mm in the tissue were filled: {len(added) - 1} "
        f"(first: {first}), {volume:.3g} mm³ in all, with {len(row) - len(tetrahedra)} "
        "tetrahedra that have the fibres and regions of those next to them"
    )
    return replace(
        extended,
        points=points,
        cells={**extended.cells, TETRAHEDRON: np.concatenate(added)},
        point_data={name: values[at] for name, values in mesh.point_data.items()},
    )


def separated_vertices(anatomy: Anatomy) -> Anatomy:
    """Double vertices of the endocardia in which tetrahedra meet without a chain of faces.

    An endocardium touches itself there, so it would not be a disk. Each copy moves a tenth of the
    way into its tetrahedra where these stay positive. Fibres, sheets, regions and labels stay. The
    anatomy is returned as it is if that would take the tissue apart.
    """
    mesh, tetrahedra = anatomy.mesh, anatomy.mesh.tetrahedra.copy()
    if components_of(_neighbours(tetrahedra), len(tetrahedra)).any():
        return anatomy
    boundary, owner = boundary_triangles(tetrahedra)
    labels = mesh.labels[places_in(boundary, mesh.triangles)]
    lined = np.isin(labels, ENDOCARDIA)
    several = np.flatnonzero(np.bincount(igl.split_nonmanifold(boundary)[1]) > 1)
    doubled, parent = [], list(range(len(mesh.vertices)))
    for vertex in np.intersect1d(several, boundary[lined]):
        fans = _fans(mesh.tetrahedra, vertex)
        owners = owner[lined & (boundary == vertex).any(axis=1)]
        if sum(np.isin(fan, owners).any() for fan in fans) < 2:
            continue
        doubled.append(vertex)
        for fan in fans[1:]:
            tetrahedra[fan] = np.where(mesh.tetrahedra[fan] == vertex, len(parent), tetrahedra[fan])
            parent.append(vertex)
    if not doubled:
        return anatomy
    vertices = mesh.vertices[parent]
    for vertex in np.flatnonzero(np.isin(parent, doubled)).tolist():
        _move_inwards(vertices, tetrahedra, vertex)
    triangles, _ = boundary_triangles(tetrahedra)
    labels = mesh.labels[places_in(np.array(parent)[triangles], mesh.triangles)]
    note = (
        f"mesh: vertices in which an endocardium touched itself were doubled: {len(doubled)} "
        f"(first: {first_places(np.array(doubled), mesh.vertices[doubled])})"
    )
    mesh = LabelledMesh(vertices, tetrahedra, triangles, labels, mesh.regions, mesh.name)
    return replace(anatomy, mesh=mesh, coordinates=None, notes=(*anatomy.notes, note))


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
    vertices, tetrahedra = mesh.vertices, mesh.tetrahedra.copy()
    parent, ends = np.arange(len(tetrahedra)), np.empty((0, 2), dtype=np.int64)
    for edge in bad:
        for fan in _fans(tetrahedra, edge):
            new, unsplit = len(vertices), tetrahedra[fan]
            vertices = np.concatenate([vertices, vertices[edge].mean(axis=0)[None]])
            ends = np.concatenate([ends, edge[None]])
            tetrahedra[fan], second_halves = (
                np.where(unsplit == end, new, unsplit) for end in edge
            )
            tetrahedra = np.concatenate([tetrahedra, second_halves])
            parent = np.concatenate([parent, parent[fan]])
            _move_inwards(vertices, tetrahedra, new)
    triangles, _ = boundary_triangles(tetrahedra)
    original = triangles.copy()  # the triangles before halving
    for k in range(len(ends) - 1, -1, -1):  # later edges may end in earlier midpoints
        for corner in range(3):
            at_midpoint = original[:, corner] == len(mesh.vertices) + k
            at_first_end = (original == ends[k, 0]).any(axis=1)
            original[at_midpoint, corner] = np.where(at_first_end, ends[k, 1], ends[k, 0])[
                at_midpoint
            ]
    note = (
        f"mesh: {len(bad)} of {len(edges)} edges of its boundary had more than two triangles "
        f"(first: {first_places(bad, mesh.vertices[bad])}): the tetrahedra that met in them alone "
        f"were separated ({len(tetrahedra) - len(mesh.tetrahedra)} tetrahedra halved, none removed)"
    )
    labels = mesh.labels[places_in(original, mesh.triangles)]
    regions = None if mesh.regions is None else mesh.regions[parent]
    return replace(
        anatomy,
        mesh=LabelledMesh(vertices, tetrahedra, triangles, labels, regions, mesh.name),
        fibres=None if anatomy.fibres is None else anatomy.fibres[parent],
        sheets=None if anatomy.sheets is None else anatomy.sheets[parent],
        coordinates=None,
        notes=(*anatomy.notes, note),
    )


def _fans(tetrahedra: Integers, corners: Integers) -> list[Integers]:
    """Face-connected groups of the tetrahedra that have a vertex, or an edge (2,)."""
    around = np.flatnonzero(np.isin(tetrahedra, corners).sum(axis=1) == np.size(corners))
    group = components_of(_neighbours(tetrahedra[around]), len(around))
    return [around[group == k] for k in np.unique(group)]


def _move_inwards(vertices: Floats, tetrahedra: Integers, vertex: int) -> None:
    """Move a vertex, in place, a tenth of the way into its tetrahedra if these stay positive."""
    around = tetrahedra[(tetrahedra == vertex).any(axis=1)]
    before = vertices[vertex].copy()
    vertices[vertex] += 0.1 * (vertices[around].mean(axis=(0, 1)) - before)
    if (signed_volumes(vertices, around) <= 0).any():
        vertices[vertex] = before


def count_pieces(mesh: MeshFile) -> int:
    """Number of pieces of a file's tetrahedra that have no common vertices."""
    tetrahedra = mesh.cells[TETRAHEDRON]
    return len(np.unique(pieces_of(tetrahedra, len(mesh.points))[tetrahedra[:, 0]]))


def with_common_vertices(mesh: MeshFile) -> tuple[MeshFile, tuple[str, ...]]:
    """Merge coincident vertices if that joins all pieces of a file; with a note if so."""
    if (count := count_pieces(mesh)) == 1:
        return mesh, ()
    representative = merged_vertices(mesh.points)
    merged = replace(
        mesh, cells={kind: representative[cells] for kind, cells in mesh.cells.items()}
    )
    if count_pieces(merged) > 1:
        return mesh, ()
    doubled = int((representative != np.arange(len(representative))).sum())
    return merged, (f"mesh: {count} pieces were joined at {doubled} vertices in the same places",)


def joined_pieces(
    mesh: LabelledMesh, largest_gap: float = 2.0, widest_channel: float = 12.0
) -> LabelledSurface:
    """Closed surface around pieces that overlap or are at most the largest gap (mm) apart.

    Tissue is where the winding number of a piece's surface is above a half. First each piece
    is closed morphologically by the smallest ball, at most as wide as the widest channel (mm; less
    than half of a mitral annulus), that leaves no channel through it, such as the open apex of
    prolate spheroidal coordinates or elements that were left out; then the gaps between the pieces
    are closed.
    """
    piece = pieces_of(mesh.tetrahedra, len(mesh.vertices))[mesh.triangles[:, 0]]
    box = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    apart: list[Floats] = []
    filled: list[Floats] = []
    for number in np.unique(piece):
        surface = without_unused_vertices(mesh.vertices, mesh.triangles[piece == number])
        sampled = SampledDistance.of(*surface, box, widest_channel / 2)
        closed = _without_channels(sampled, np.arange(widest_channel / 2 + 1))
        apart.append(sampled.values)
        filled.append(sampled.values if closed is None else closed.values)
    both = sampled._replace(values=np.min(filled, axis=0))
    radii = largest_gap / 2 * np.array([1.0, 1.5, 2.0])
    joined = _without_channels(both, radii) or both.closed(float(radii[0]))
    numbered = label(joined.values < 0)[0]
    volumes = np.asarray(np.bincount(numbered.ravel())[1:] * joined.edge**3 / 1e3)
    if volumes.max() < 0.999 * volumes.sum():
        places = np.diag([joined.edge] * 3 + [1.0])
        places[:3, 3] = joined.origin
        raise InputError(
            f"{mesh.name}: its pieces of tissue ({largest_pieces(numbered, volumes, places)}) are "
            f"more than {largest_gap:g} mm apart; keep one piece or join them"
        )
    vertices, triangles = joined.surface()
    before = signed_volumes(mesh.vertices, mesh.tetrahedra).sum() / 1e3
    after = abs(closed_volume(vertices, triangles)) / 1e3
    added = both.edge**3 / 1e3 * float(((both.values < 0) & (np.min(apart, axis=0) >= 0)).sum())
    channels = f" (channels through a piece were filled, {added:.2g} ml)" if added else ""
    note = (
        f"mesh: {len(apart)} pieces that touch without common vertices were joined and meshed "
        f"again: {before:.1f} ml before, {after:.1f} ml after{channels}; fibres, sheets and "
        "regions are those of the nearest tetrahedra"
    )
    unlabelled = np.zeros(len(triangles), dtype=np.int64)
    united = LabelledSurface(vertices, triangles, unlabelled, mesh.name, notes=(note,))
    return oriented_outwards(united)


def _without_channels(tissue: SampledDistance, radii: Floats) -> SampledDistance | None:
    """Tissue closed by the smallest ball (mm) that gives it spherical topology; None if none."""
    for radius in radii:
        closed = tissue.closed(float(radius)) if radius else tissue
        if igl.euler_characteristic(closed.surface()[1]) == 2:
            return closed
    return None
