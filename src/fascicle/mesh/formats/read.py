"""Mesh files of any format: VTK, VTU, VTP, OBJ, STL, PLY, Gmsh and openCARP."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.core.isolated import read_isolated
from fascicle.mesh.checks import refuse
from fascicle.mesh.formats.cut import cut_into_tetrahedra
from fascicle.mesh.formats.mesh_file import OPENCARP_FORMATS, MeshFile, damaged
from fascicle.mesh.formats.meshio_files import gmsh22_header, read_gmsh22, read_meshio
from fascicle.mesh.formats.opencarp import read_opencarp_mesh
from fascicle.mesh.formats.vtk import is_ascii_vtk, read_vtk

VTK_FORMATS = (".vtk", ".vtu", ".vtp", ".obj", ".stl")
MESH_FORMATS = (*VTK_FORMATS, ".ply", ".msh", *OPENCARP_FORMATS)


def read_mesh(path: Path | str, purpose: str = "mesh") -> MeshFile:
    """Read a mesh file of any supported format.

    InputError is that the file is missing, of another format, truncated or otherwise unreadable,
    empty, or has coordinates that are not finite. Hexahedra, wedges and pyramids become tetrahedra.
    """
    path = Path(path)
    check_file(path, MESH_FORMATS, purpose)
    if path.suffix.lower() in OPENCARP_FORMATS:
        return read_opencarp_mesh(path, purpose)
    _check_complete(path)
    if path.suffix.lower() == ".msh" and gmsh22_header(content := path.read_bytes()):
        mesh: MeshFile = read_gmsh22(path, content)
    else:
        mesh = read_isolated(read_vtk if path.suffix.lower() in VTK_FORMATS else read_meshio, path)
    if not len(mesh.points):
        raise InputError(f"{path}: no points could be read; the file is empty or truncated")
    bad = np.asarray(~np.isfinite(mesh.points).all(axis=1))
    fault = "points have coordinates that are not finite"
    refuse(str(path), bad, fault, "correct or remove them", mesh.points)
    for cells in mesh.cells.values():
        if cells.size and (cells.min() < 0 or cells.max() >= len(mesh.points)):
            raise damaged(path, "cells refer to points that are not there")
    return cut_into_tetrahedra(mesh)


def _check_complete(path: Path) -> None:
    """Refuse files without their format's end: VTK reads a truncated one as far as it goes."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(512)
        file.seek(max(0, size - 1024))
        tail = file.read()
    # 50 bytes a triangle after the header of 80 and their number, or text
    triangles = size >= 84 and size >= 84 + 50 * int.from_bytes(head[80:84], "little")
    whole_stl = (triangles and any(tail)) or b"endsolid" in tail.lower()
    promised = {
        ".vtu": ("</VTKFile>", b"</VTKFile>" in tail),
        ".vtp": ("</VTKFile>", b"</VTKFile>" in tail),
        ".stl": ("as many triangles as announced", whole_stl),
        ".obj": ("line end", tail[-1:].isspace()),
        ".vtk": ("line end", tail[-1:].isspace() or not is_ascii_vtk(head)),
    }
    end, complete = promised.get(path.suffix.lower(), ("", True))
    if size == 0:
        raise InputError(f"{path}: the file is empty; export or copy it again")
    if not complete:
        raise damaged(path, f"no {end} at its end")
