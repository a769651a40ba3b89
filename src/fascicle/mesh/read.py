"""Mesh files of any format; hexahedra, wedges and pyramids are cut into tetrahedra."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError, check_installed
from fascicle.core.files import check_file
from fascicle.core.isolated import read_isolated
from fascicle.mesh.checks import refuse
from fascicle.mesh.mesh_file import OPENCARP_FORMATS, SOLIDS, TETRAHEDRON, MeshFile, damaged
from fascicle.mesh.meshio_files import gmsh22_header, read_gmsh22, read_meshio
from fascicle.mesh.opencarp import read_opencarp_mesh
from fascicle.mesh.vtk import is_ascii_vtk, read_vtk

MESH_FORMATS = (".vtk", ".vtu", ".vtp", ".obj", ".stl", ".ply", ".msh", *OPENCARP_FORMATS)


def read_mesh(path: Path | str, purpose: str = "mesh") -> MeshFile:
    """Read a mesh file of any supported format.

    Hexahedra, wedges and pyramids are cut into tetrahedra.

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
    return cut_into_tetrahedra(mesh)


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
        ".vtu": ("</VTKFile>", b"</VTKFile>" in tail),
        ".vtp": ("</VTKFile>", b"</VTKFile>" in tail),
        ".stl": ("as many triangles as announced", complete_stl),
        ".obj": ("line end", tail[-1:].isspace()),
        ".vtk": ("line end", tail[-1:].isspace() or not is_ascii_vtk(head)),
    }
    end, complete = endings.get(path.suffix.lower(), ("", True))
    if size == 0:
        raise InputError(f"{path}: the file is empty; export or copy it again")
    if not complete:
        raise damaged(path, f"no {end} at its end")


def cut_into_tetrahedra(mesh: MeshFile) -> MeshFile:
    """Cut the hexahedra, wedges and pyramids of a file into tetrahedra, which inherit their data.

    VTK orders the corners of a cell by their numbers (Schroeder, Geveci and Malaterre 2004,
    "Compatible triangulations of spatial decompositions", IEEE Visualization), so neighbours agree
    on the diagonal of their common face. Corners that coincide, as at an apex, are allowed. The
    tetrahedra of inverted cells are reversed. InputError if a cell is flat or folded, so that its
    tetrahedra do not all have a positive volume.
    """
    solids = {kind: cells for kind, cells in mesh.cells.items() if kind in SOLIDS and len(cells)}
    if not solids:
        return mesh
    check_installed("pyvista", f"{mesh.path}: cutting its cells into tetrahedra")
    tetrahedra = [mesh.cells.get(TETRAHEDRON, np.empty((0, 4), dtype=np.int64))]
    other_cells = {kind: cells for kind, cells in mesh.cells.items() if kind not in SOLIDS}
    arrays = {kind: mesh.cell_data.get(kind, {}) for kind in solids}
    if len(tetrahedra[0]):
        arrays[TETRAHEDRON] = mesh.cell_data.get(TETRAHEDRON, {})
    names = set.intersection(*map(set, arrays.values()))
    rows = {name: [arrays[TETRAHEDRON][name]] if len(tetrahedra[0]) else [] for name in names}
    for kind, cells in solids.items():
        parts, parent = _parts(mesh, kind, cells)
        tetrahedra.append(parts)
        for name in names:
            rows[name].append(arrays[kind][name][parent])
    count = ", ".join(f"{len(cells)} {SOLIDS[kind][0]}" for kind, cells in solids.items())
    kept = {kind: values for kind, values in mesh.cell_data.items() if kind not in SOLIDS}
    note = f"mesh: {count} were cut into {sum(map(len, tetrahedra[1:]))} tetrahedra"
    return replace(
        mesh,
        cells={**other_cells, TETRAHEDRON: np.concatenate(tetrahedra)},
        cell_data={
            **kept, TETRAHEDRON: {name: np.concatenate(values) for name, values in rows.items()}
        },
        notes=(*mesh.notes, note),
    )  # fmt: skip


def _parts(mesh: MeshFile, kind: int, cells: Integers) -> tuple[Integers, Integers]:
    """Tetrahedra (m, 4) that cells of one kind are cut into, and the cell (m,) of each."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
    from vtkmodules.vtkFiltersGeneral import vtkDataSetTriangleFilter

    grid, points, cell_array = vtkUnstructuredGrid(), vtkPoints(), vtkCellArray()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(mesh.points)))
    corners = numpy_to_vtkIdTypeArray(np.ascontiguousarray(cells, dtype=np.int64).ravel())
    cell_array.SetData(cells.shape[1], corners)
    grid.SetPoints(points)
    grid.SetCells(kind, cell_array)
    number: Any = numpy_to_vtk(np.arange(len(cells)))
    number.SetName("cell")
    grid.GetCellData().AddArray(number)
    cutter = vtkDataSetTriangleFilter()
    cutter.TetrahedraOnlyOn()
    cutter.SetInputData(grid)
    cutter.Update()
    output = cutter.GetOutput()
    connections = vtk_to_numpy(output.GetCells().GetConnectivityArray())
    parts = connections.reshape(-1, 4).astype(np.int64)
    parent = vtk_to_numpy(output.GetCellData().GetArray("cell")).astype(np.int64)
    ordered = np.sort(parts, axis=1)
    distinct = (np.diff(ordered, axis=1) > 0).all(axis=1)  # without coinciding corners
    parts, parent = parts[distinct], parent[distinct]
    origin, a, b, c = (mesh.points[parts[:, k]] for k in range(4))
    volume = np.einsum("ij,ij->i", a - origin, np.cross(b - origin, c - origin))
    low, high = np.full(len(cells), np.inf), np.full(len(cells), -np.inf)
    np.minimum.at(low, parent, volume)
    np.maximum.at(high, parent, volume)
    refuse(
        str(mesh.path),
        ~((low > 0) | (high < 0)),
        f"{SOLIDS[kind][0]} are flat or folded, so that no tetrahedra of positive volume fill them",
        "correct the order of their corners, or remesh them",
        mesh.points,
        cells,
    )
    turned = high[parent] < 0
    parts[turned] = parts[turned][:, [0, 2, 1, 3]]
    return parts, parent
