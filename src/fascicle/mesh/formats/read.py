"""Mesh files of any format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.core.isolated import read_isolated
from fascicle.mesh.formats.gmsh22 import is_gmsh22, read_gmsh22
from fascicle.mesh.formats.mesh_file import OPENCARP_FORMATS, MeshFile, damaged
from fascicle.mesh.formats.meshio_files import read_meshio
from fascicle.mesh.formats.opencarp import read_opencarp_mesh
from fascicle.mesh.formats.vtk import is_ascii_vtk, read_vtk

VTK_FORMATS = (".vtk", ".vtu", ".vtp", ".obj", ".stl")

MESHIO_FORMATS = (".ply", ".msh")  # VTK's PLY reader crashes on truncated files

MESH_FORMATS = VTK_FORMATS + MESHIO_FORMATS + OPENCARP_FORMATS

# What a complete file has near its end: VTK reads a truncated one as far as it goes.
HEAD, TAIL = 512, 1024  # bytes

# A binary STL is a header, the number of triangles, and so many bytes for each of them.
STL_HEADER, STL_TRIANGLE = 84, 50  # bytes


def read_mesh(path: Path | str, purpose: str = "mesh") -> MeshFile:
    """Read a mesh file of any supported format.

    Raises
    ------
    InputError
        If the file is missing, of another format, truncated or otherwise unreadable, empty, or
        has coordinates that are not finite.
    """
    path = Path(path)
    check_file(path, MESH_FORMATS, purpose)
    if path.suffix.lower() in OPENCARP_FORMATS:
        return read_opencarp_mesh(path, purpose)
    _check_complete(path)
    if path.suffix.lower() == ".msh" and is_gmsh22(content := path.read_bytes()):
        mesh = read_gmsh22(path, content)
    else:
        mesh = MeshFile.of_parts(path, read_isolated(read_by_library, path))
    if not len(mesh.points):
        raise InputError(f"{path}: no points could be read; the file is empty or truncated")
    bad = np.flatnonzero(~np.isfinite(mesh.points).all(axis=1))
    if bad.size:
        raise InputError(
            f"{path}: {bad.size} of {len(mesh.points)} points have coordinates that are not finite "
            f"(first: point {bad[0]}); correct or remove them"
        )
    for cells in mesh.cells.values():
        if cells.size and (cells.min() < 0 or cells.max() >= len(mesh.points)):
            raise InputError(
                f"{path}: cells refer to points that are not there; export or copy it again"
            )
    return mesh


def read_by_library(path: Path) -> dict[str, Any]:
    """Parts of a mesh file that a library reads, which may crash."""
    read = read_vtk if path.suffix.lower() in VTK_FORMATS else read_meshio
    return read(path).parts


def _check_complete(path: Path) -> None:
    """Refuse files that lack the end which their format requires."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEAD)
        file.seek(max(0, size - TAIL))
        tail = file.read()
    promised = {
        ".vtu": ("</VTKFile>", b"</VTKFile>" in tail),
        ".vtp": ("</VTKFile>", b"</VTKFile>" in tail),
        ".stl": ("as many triangles as announced", _stl_is_whole(head, tail, size)),
        ".obj": ("line end", tail[-1:].isspace()),
        ".vtk": ("line end", tail[-1:].isspace() or not is_ascii_vtk(head)),
    }
    end, complete = promised.get(path.suffix.lower(), ("", True))
    if size == 0:
        raise InputError(f"{path}: the file is empty; export or copy it again")
    if not complete:
        raise damaged(path, f"no {end} at its end")


def _stl_is_whole(head: bytes, tail: bytes, size: int) -> bool:
    announced = int.from_bytes(head[STL_HEADER - 4 : STL_HEADER], "little")
    fits = len(head) >= STL_HEADER and size >= STL_HEADER + STL_TRIANGLE * announced
    return (fits and any(tail)) or b"endsolid" in tail.lower()
