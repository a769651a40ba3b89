"""Bodies in files: the torso of a heart folder, and the user's own torso and lung surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import igl
import numpy as np

from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.validate import check_units
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.measures import turned_outwards
from fascicle.mesh.topology import boundary_triangles, without_unused_vertices
from fascicle.torso.enclosure import LUNG_EXTENT, TORSO_EXTENT, check_closed, check_within
from fascicle.torso.lungs import LUNG_EDGE
from fascicle.torso.surfaces import Surface, TorsoSurfaces, remeshed
from fascicle.torso.trunk import SKIN_EDGE

MOST_TRIANGLES = 20_000  # of a surface; a finer one makes the mesh larger and nothing more exact


def read_torso_surfaces(
    skin: Path | str, lungs: Sequence[Path | str], mesh: LabelledMesh
) -> TorsoSurfaces:
    """Read the user's own torso.

    Surfaces are welded (STL repeats every point), turned outwards, and remeshed if they are far
    finer than a torso needs. Of a mesh of tetrahedra only the outer surface is used: labels of its
    organs are not, give the lungs as files of their own.

    Parameters
    ----------
    skin : path
        Surface of the torso, closed, in the heart's coordinates (mm); any format of `read_mesh`.
    lungs : sequence of path
        Surfaces of the lungs, likewise.
    mesh : LabelledMesh
        The heart that they must enclose.

    Raises
    ------
    InputError
        If a file cannot be read, holds no surface, or one that is open, in several pieces, not in
        mm or not where a torso's or a lung's is.
    """
    body = _closed_surface(Path(skin), "torso", TORSO_EXTENT, SKIN_EDGE)
    within = tuple(_closed_surface(Path(lung), "lung", LUNG_EXTENT, LUNG_EDGE) for lung in lungs)
    check_within(mesh, body, within, [str(skin), *map(str, lungs)])
    return TorsoSurfaces(body, within)


def _closed_surface(path: Path, purpose: str, extent: tuple[float, float], edge: float) -> Surface:
    surface = _outer_surface(read_mesh(path, purpose), str(path))
    check_units(str(path), surface.vertices, extent)
    check_closed(str(path), surface)
    if len(surface.triangles) > MOST_TRIANGLES:
        surface = remeshed(surface, edge)
        check_closed(str(path), surface)
    return surface


def _outer_surface(mesh: MeshFile, name: str) -> Surface:
    """The triangles of a file, or the boundary of its tetrahedra, welded and turned outwards."""
    if len(mesh.cells.get(TETRAHEDRON, ())):
        triangles, _ = boundary_triangles(mesh.require(TETRAHEDRON, "tetrahedra"))
    else:
        triangles = mesh.require(TRIANGLE, "triangles")
    points, number = np.unique(mesh.points, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[triangles]
    corners = np.sort(triangles, axis=1)
    triangles = triangles[(np.diff(corners, axis=1) > 0).all(axis=1)]
    vertices, triangles = without_unused_vertices(points, triangles)
    oriented, pieces = igl.bfs_orient(triangles)
    if pieces.max() > 0:
        raise InputError(
            f"{name}: the surface falls into {pieces.max() + 1} pieces; keep the outer one"
        )
    return Surface(vertices, turned_outwards(vertices, oriented))
