"""VTK, VTU, VTP, OBJ and STL files."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, check_installed, one_line
from fascicle.core.files import MADE_WITH, atomic_path
from fascicle.mesh.mesh_file import (
    CELL_CORNERS,
    LINE,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    VERTEX,
    MeshFile,
    damaged,
)


def read_vtk(path: Path) -> MeshFile:
    """Read a VTK, VTU, VTP, OBJ or STL file by VTK's own reader.

    It may crash, or take any amount of memory: call it by `fascicle.core.isolated`. This
    function does not import PyVista, whose readers log complaints where they cannot be collected,
    and without which a child process starts 0.1 s sooner.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkAppendFilter

    reader = _vtk_reader(path)
    with _vtk_complaints() as complaints:
        reader.Update()
        data = reader.GetOutput()
    if complaints or data is None:
        raise damaged(path, complaints[0] if complaints else "nothing could be read")
    if not (data.IsA("vtkPolyData") or data.IsA("vtkUnstructuredGrid")):
        raise InputError(
            f"{path}: holds a {data.GetClassName().removeprefix('vtk')}, not a mesh of triangles, "
            "tetrahedra or lines; export it as an unstructured grid or polydata"
        )
    if data.IsA("vtkPolyData"):
        as_grid = vtkAppendFilter()
        as_grid.AddInputData(data)
        with _vtk_complaints():
            as_grid.Update()
            data = as_grid.GetOutput()
    try:
        cells, index, other_cells = _cells(data)
        arrays = _named_arrays(data.GetCellData()).items()
        cell_data = {k: {name: v[rows] for name, v in arrays} for k, rows in index.items()}
    except (IndexError, ValueError):
        raise damaged(path, "its list of cells contradicts itself") from None
    positions = data.GetPoints()  # None in a file that holds none
    points = np.empty((0, 3)) if positions is None else vtk_to_numpy(positions.GetData())
    lines = index.get(LINE, np.empty(0))
    return MeshFile(
        path, points.astype(float), cells, _named_arrays(data.GetPointData()), cell_data,
        other_cells, has_polylines=np.unique(lines).size < lines.size,
    )  # fmt: skip


def _named_arrays(fields: Any) -> dict[str, NDArray[Any]]:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    arrays = {}
    for k in range(fields.GetNumberOfArrays()):
        array = fields.GetArray(k)  # None for one of texts
        if array is not None and array.GetName() is not None:
            arrays[str(array.GetName())] = vtk_to_numpy(array)
    return arrays


def _vtk_reader(path: Path) -> Any:
    from vtkmodules.vtkIOGeometry import vtkOBJReader, vtkSTLReader
    from vtkmodules.vtkIOLegacy import vtkDataSetReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    kinds: dict[str, Any] = {
        ".vtk": vtkDataSetReader,
        ".vtu": vtkXMLUnstructuredGridReader,
        ".vtp": vtkXMLPolyDataReader,
        ".obj": vtkOBJReader,
        ".stl": vtkSTLReader,
    }
    reader = kinds[path.suffix.lower()]()
    content = path.read_bytes() if path.suffix.lower() == ".vtk" else b""
    if [line.strip().upper() for line in content.split(b"\n", 3)[2:3]] == [b"ASCII"]:
        # VTK accepts a file that ends within its last array; with an empty array after that one it
        # notices
        content += b"\n\nFIELD end 0\n"
        reader.ReadFromInputStringOn()
        reader.SetBinaryInputString(content, len(content))
    else:
        reader.SetFileName(str(path))
    if path.suffix.lower() == ".vtk":
        for kind in ("Scalars", "Vectors", "Normals", "Tensors", "TCoords", "Fields"):
            getattr(reader, f"ReadAll{kind}On")()
    return reader


@contextlib.contextmanager
def _vtk_complaints() -> Iterator[list[str]]:
    """Collect the errors and warnings of VTK, which prints them and raises nothing."""
    from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow

    window, before = vtkStringOutputWindow(), vtkOutputWindow.GetInstance()
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    complaints: list[str] = []
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    vtkOutputWindow.SetInstance(window)
    try:
        yield complaints
    finally:
        vtkOutputWindow.SetInstance(before)
        vtkLogger.SetStderrVerbosity(verbosity)
        printed = window.GetOutput()
        if isinstance(printed, bytes):  # a message that quotes a binary file
            printed = printed.decode(errors="replace")
        # "ERROR: In vtkX.cxx, line 7", then "vtkX (0x55aa): what happened"
        for text in re.split(r"^\w+: In .*, line \d+$", printed, flags=re.MULTILINE):
            # the range of an array with an inf in it cannot be read back; it is not needed
            if text.strip() and "InformationKey" not in text:
                complaints.append(one_line(re.sub(r"^\s*\w+ \(0x\w+\): ", "", text)))


def _cells(grid: Any) -> tuple[dict[int, Integers], dict[int, Integers], dict[str, int]]:
    """Cells of the kinds used here, the row in the file of each, and counts of other kinds.

    A line of several points becomes as many segments as it has.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkVersion
    from vtkmodules.vtkCommonDataModel import vtkCellTypes

    if not grid.GetNumberOfCells():  # a file may hold points alone
        return {}, {}, {}
    version = vtkVersion.GetVTKMajorVersion(), vtkVersion.GetVTKMinorVersion()
    kinds = vtk_to_numpy(grid.GetCellTypes() if version >= (9, 6) else grid.GetCellTypesArray())
    linear = np.arange(256)  # kind of the corners of quadratic cells
    linear[22:30] = TRIANGLE, QUADRANGLE, TETRAHEDRON, 12, 13, 14, QUADRANGLE, 12
    linear[32:35] = 13, 12, TRIANGLE
    kinds = linear[kinds]
    start = vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64)
    points = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).astype(np.int64)
    if (np.diff(start)[kinds == 1] != 1).any():  # lone vertices, or kinds that lost a digit
        raise ValueError("vertices of several points")
    cells, index = {}, {}
    for kind, corners in CELL_CORNERS.items():
        if kind != LINE and (rows := np.flatnonzero(kinds == kind)).size:
            cells[kind] = points[start[rows][:, None] + np.arange(corners)]
            index[kind] = rows
    is_line = np.isin(kinds, (LINE, 4))  # 4: several segments in one
    if is_line.any():
        cell = np.repeat(np.arange(len(kinds)), np.diff(start))
        inside = (cell[:-1] == cell[1:]) & is_line[cell[:-1]]
        cells[LINE] = np.column_stack([points[:-1], points[1:]])[inside]
        index[LINE] = cell[:-1][inside]
    ignored = (0, 1, 2)  # empty cells and lone vertices
    unused = kinds[~np.isin(kinds, (4, *CELL_CORNERS, *ignored))]
    other_kinds, counts = np.unique(unused, return_counts=True)
    names = (vtkCellTypes.GetClassNameFromTypeId(kind) for kind in other_kinds.tolist())
    other_cells = {
        name.removeprefix("vtk"): int(count) for name, count in zip(names, counts, strict=True)
    }
    return cells, index, other_cells


def write_grid(
    path: Path,
    points: Floats,
    cells: Integers,
    kind: int,
    point_data: Mapping[str, NDArray[Any]] | None = None,
    cell_data: Mapping[str, NDArray[Any]] | None = None,
    note: str = "",
) -> None:
    """Write cells of one kind, such as `TETRAHEDRON`, as VTU, whole or not at all.

    Points (n, 3) are in mm, cells (m, k) their indices; arrays have one row a point, or a cell.
    A note is the name of an array of the field data: not all readers take texts.
    """
    import meshio

    name = {VERTEX: "vertex", LINE: "line", TRIANGLE: "triangle", TETRAHEDRON: "tetra"}[kind]
    of_cells = {key: [np.asarray(values)] for key, values in (cell_data or {}).items()}
    mesh = meshio.Mesh(np.asarray(points), [(name, cells)], dict(point_data or {}), of_cells)
    with atomic_path(path) as temporary:
        meshio.vtu.write(temporary, mesh)  # as base64, so the output is text
        text = temporary.read_text("utf-8")
        if note:  # meshio reads field data, but does not write them
            array = f'<DataArray type="Float64" Name="{note}" NumberOfTuples="1" format="ascii">'
            field = f"<FieldData>{array}1</DataArray></FieldData>"
            text = text.replace("<Piece", f"{field}\n<Piece", 1)
        temporary.write_text(f"{text}<!-- {MADE_WITH} -->\n", "utf-8")


def pyvista_grid(
    points: Floats,
    cells: Integers,
    kind: int,
    point_data: Mapping[str, NDArray[Any]],
    cell_data: Mapping[str, NDArray[Any]],
) -> Any:
    """Mesh of `write_grid` as `pyvista.UnstructuredGrid`, with units in the arrays' names."""
    check_installed("pyvista", "an object of PyVista")
    import pyvista as pv

    units = (("activation", "ms"), ("length", "mm"), ("lead_field_", "kohm"))
    grid = pv.UnstructuredGrid({kind: cells}, np.asarray(points))
    for arrays, named_values in ((grid.point_data, point_data), (grid.cell_data, cell_data)):
        for name, values in named_values.items():
            unit = next((f"_{unit}" for begin, unit in units if name.startswith(begin)), "")
            arrays[name + unit] = values
    return grid


def pyvista_blocks(grids: Mapping[str, Any]) -> Any:
    """Datasets by their names as `pyvista.MultiBlock`."""
    import pyvista as pv

    return pv.MultiBlock(dict(grids))
