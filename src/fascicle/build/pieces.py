"""Joining pieces of tissue that touch without common vertices."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
from scipy.ndimage import label

from fascicle.build.segmentation import largest_pieces
from fascicle.build.surface_repair import MERGED, SampledDistance, oriented_outwards
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh, LabelledSurface
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, MeshFile
from fascicle.mesh.measures import closed_volume, signed_volumes
from fascicle.mesh.topology import merged_vertices, pieces_of, without_unused_vertices

LARGEST_GAP = 2.0  # mm, between pieces, that is filled
WIDEST_CHANNEL = 12.0  # mm, less than half of a mitral annulus


def count_pieces(mesh: MeshFile) -> int:
    """Number of pieces of a file's tetrahedra that have no common vertices."""
    tetrahedra = mesh.cells[TETRAHEDRON]
    return len(np.unique(pieces_of(tetrahedra, len(mesh.points))[tetrahedra[:, 0]]))


def with_common_vertices(mesh: MeshFile) -> tuple[MeshFile, tuple[str, ...]]:
    """Merge coincident vertices if that joins all pieces of a file; with a note if so."""
    if (count := count_pieces(mesh)) == 1:
        return mesh, ()
    extent = float(np.ptp(mesh.points, axis=0).max())
    same = merged_vertices(mesh.points, MERGED * extent)
    merged = replace(mesh, cells={kind: same[cells] for kind, cells in mesh.cells.items()})
    if count_pieces(merged) > 1:
        return mesh, ()
    doubled = int((same != np.arange(len(same))).sum())
    return merged, (f"mesh: {count} pieces were joined at {doubled} vertices in the same places",)


def joined_pieces(mesh: LabelledMesh) -> LabelledSurface:
    """Closed surface around pieces that overlap or are at most `LARGEST_GAP` apart.

    Tissue is where the winding number of a piece's surface is above a half. First each piece
    is closed morphologically by the smallest ball of at most `WIDEST_CHANNEL` that leaves no
    channel through it, such as the open apex of prolate spheroidal coordinates or elements that
    were left out; then the gaps between the pieces are closed.
    """
    piece = pieces_of(mesh.tetrahedra, len(mesh.vertices))[mesh.triangles[:, 0]]
    box = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    apart: list[Floats] = []
    filled: list[Floats] = []
    for number in np.unique(piece):
        surface = without_unused_vertices(mesh.vertices, mesh.triangles[piece == number])
        sampled = SampledDistance.of(*surface, box, WIDEST_CHANNEL / 2)
        closed = _without_channels(sampled, np.arange(WIDEST_CHANNEL / 2 + 1))
        apart.append(sampled.values)
        filled.append(sampled.values if closed is None else closed.values)
    both = sampled._replace(values=np.min(filled, axis=0))
    radii = LARGEST_GAP / 2 * np.array([1.0, 1.5, 2.0])
    whole = _without_channels(both, radii) or both.closed(float(radii[0]))
    numbered = label(whole.values < 0)[0]
    volumes = np.asarray(np.bincount(numbered.ravel())[1:] * whole.edge**3 / 1e3)
    if volumes.max() < 0.999 * volumes.sum():
        places = np.diag([whole.edge] * 3 + [1.0])
        places[:3, 3] = whole.origin
        raise InputError(
            f"{mesh.name}: its pieces of tissue ({largest_pieces(numbered, volumes, places)}) are "
            f"more than {LARGEST_GAP:g} mm apart; keep one piece or join them"
        )
    vertices, triangles = whole.surface()
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
    return oriented_outwards(
        LabelledSurface(vertices, triangles, unlabelled, mesh.name, notes=(note,))
    )


def _without_channels(tissue: SampledDistance, radii: Floats) -> SampledDistance | None:
    """Tissue closed by the first ball (mm) that leaves a spherical topology; None if none does."""
    for radius in radii:
        closed = tissue.closed(float(radius)) if radius else tissue
        if igl.euler_characteristic(closed.surface()[1]) == 2:
            return closed
    return None
