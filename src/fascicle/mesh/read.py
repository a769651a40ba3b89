"""Mesh files of any format, whose cells are cut into tetrahedra and triangles."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError, check_installed
from fascicle.core.files import check_file
from fascicle.core.isolated import read_isolated
from fascicle.mesh.checks import refuse
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.mesh_file import (
    OPENCARP_FORMATS,
    QUADRANGLE,
    SOLIDS,
    TETRAHEDRON,
    TRIANGLE,
    MeshFile,
    damaged,
)
from fascicle.mesh.meshio_files import gmsh22_header, read_gmsh22, read_meshio
from fascicle.mesh.opencarp import read_opencarp_mesh
from fascicle.mesh.vtk import read_vtk

MESH_FORMATS = (".vtk", ".vtu", ".vtp", ".obj", ".stl", ".ply", ".msh", *OPENCARP_FORMATS)


def read_mesh(path: Path | str, purpose: str = "mesh") -> MeshFile:
    """Read a mesh file of any supported format.

    Hexahedra, wedges and pyramids are cut into tetrahedra, quadrangles into triangles.

    Raises
    ------
    InputError
        If the file is missing, of another format, truncated or otherwise unreadable, empty, or has
        coordinates that are not finite.
    """
    path = Path(path)
    check_file(path, MESH_FORMATS, purpose)
    if path.suffix.lower() in OPENCARP_FORMATS:
        return read_opencarp_mesh(path, purpose)
    _check_complete(path)
    if path.suffix.lower() == ".msh" and gmsh22_header(content := path.read_bytes()):
        mesh: MeshFile = read_gmsh22(path, content)
    else:
        by_meshio = path.suffix.lower() in (".ply", ".msh")
        if path.suffix.lower() == ".vtu":  # meshio reads those written here, VTK all others, too
            by_meshio = find_spec("pyvista") is None
        elif not by_meshio:
            check_installed("pyvista", f"{path}: a mesh in this format")
        mesh = read_isolated(read_meshio if by_meshio else read_vtk, path)
    if not len(mesh.points):
        raise InputError(f"{path}: no points could be read; the file is empty or truncated")
    bad = np.asarray(~np.isfinite(mesh.points).all(axis=1))
    fault = "points have coordinates that are not finite"
    refuse(str(path), bad, fault, "correct or remove them", mesh.points)
    for cells in mesh.cells.values():
        if cells.size and (cells.min() < 0 or cells.max() >= len(mesh.points)):
            raise damaged(path, "cells refer to points that are not there")
    return cut_into_simplices(mesh)


def _check_complete(path: Path) -> None:
    """Refuse truncated files, by the end that their format has; VTK would read them in part."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(512)
        file.seek(max(0, size - 1024))
        tail = file.read()
    # binary: a header of 80 bytes, the number of triangles (4), 50 bytes a triangle; or text
    triangles = size >= 84 and size >= 84 + 50 * int.from_bytes(head[80:84], "little")
    complete_stl = (triangles and any(tail)) or b"endsolid" in tail.lower()
    endings = {
        ".vtu": ("no </VTKFile> at its end", b"</VTKFile>" in tail),
        ".vtp": ("no </VTKFile> at its end", b"</VTKFile>" in tail),
        ".stl": ("not as many triangles as announced", complete_stl),
        # without a count, a face that lost digits looks whole
        ".obj": ("no line end at its end; add one if the file is whole", tail[-1:].isspace()),
    }
    fault, complete = endings.get(path.suffix.lower(), ("", True))
    if size == 0:
        raise InputError(f"{path}: the file is empty; export or copy it again")
    if not complete:
        raise damaged(path, fault)


def cut_into_simplices(mesh: MeshFile) -> MeshFile:
    """Cut hexahedra, wedges and pyramids of a file into tetrahedra, quadrangles into triangles.

    The parts inherit the data of their cell. VTK orders the corners of a cell by their numbers
    (Schroeder, Geveci and Malaterre 2004, "Compatible triangulations of spatial decompositions",
    IEEE Visualization), so neighbours agree on the diagonal of their common face. Corners that
    coincide, as at an apex, are allowed. The tetrahedra of inverted cells are reversed. InputError
    if a cell is flat or folded, so that its tetrahedra do not all have a positive volume.
    """
    if len(quadrangles := mesh.cells.get(QUADRANGLE, ())):
        # VTK cuts off the corner of the largest number, which it adds last
        corners = np.argmax(quadrangles, axis=1)[:, None] + np.array([3, 0, 1, 1, 2, 3])
        corners = np.take_along_axis(quadrangles, corners % 4, axis=1)
        parents = np.repeat(np.arange(len(quadrangles)), 2)
        mesh = _replaced(mesh, [QUADRANGLE], TRIANGLE, corners.reshape(-1, 3), parents)
    solids = {kind: cells for kind, cells in mesh.cells.items() if kind in SOLIDS and len(cells)}
    if not solids:
        return mesh
    check_installed("pyvista", f"{mesh.path}: cutting its cells into tetrahedra")
    import pyvista as pv

    grid = pv.UnstructuredGrid(solids, mesh.points)
    grid.cell_data["parent"] = np.arange(grid.n_cells)
    cut = grid.triangulate()
    parts, parents = cut.cells_dict[TETRAHEDRON].astype(np.int64), cut.cell_data["parent"]
    distinct = (np.diff(np.sort(parts, axis=1), axis=1) > 0).all(axis=1)  # corners may coincide
    parts, parents = parts[distinct], parents[distinct]
    volumes = signed_volumes(mesh.points, parts)
    low, high = np.full(grid.n_cells, np.inf), np.full(grid.n_cells, -np.inf)
    np.minimum.at(low, parents, volumes)
    np.maximum.at(high, parents, volumes)
    folded = np.split(~((low > 0) | (high < 0)), np.cumsum([*map(len, solids.values())]))
    for (kind, cells), bad in zip(solids.items(), folded, strict=False):
        fault = "are flat or folded, so that no tetrahedra of positive volume fill them"
        remedy = "correct the order of their corners, or remesh them"
        refuse(str(mesh.path), bad, f"{SOLIDS[kind]} {fault}", remedy, mesh.points, cells)
    parts = np.where((high[parents] < 0)[:, None], parts[:, [0, 2, 1, 3]], parts)
    count = ", ".join(f"{len(cells)} {SOLIDS[kind]}" for kind, cells in solids.items())
    note = f"mesh: {count} were cut into {len(parts)} tetrahedra"
    mesh = replace(mesh, notes=(*mesh.notes, note))
    return _replaced(mesh, list(solids), TETRAHEDRON, parts, parents)


def _replaced(
    mesh: MeshFile, kinds: list[int], new: int, cells: Integers, parents: Integers
) -> MeshFile:
    """Mesh whose cells of some kinds are replaced by those of a new kind, with their data.

    Parents are rows of the replaced cells, one kind after another.
    """
    count = len(mesh.cells.get(new, ()))
    sources = [new, *kinds] if count else kinds
    arrays = [mesh.cell_data.get(kind, {}) for kind in sources]
    rows = np.concatenate([np.arange(count), count + parents])
    data = {
        name: np.concatenate([values[name] for values in arrays])[rows]
        for name in set.intersection(*map(set, arrays))
    }
    kept = {kind: values for kind, values in mesh.cells.items() if kind not in kinds}
    all_cells = np.concatenate([kept[new], cells]) if count else cells
    return replace(mesh, cells=kept | {new: all_cells}, cell_data=mesh.cell_data | {new: data})
