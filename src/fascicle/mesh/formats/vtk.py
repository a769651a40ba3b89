"""VTK, VTU, VTP, OBJ and STL files."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, one_line
from fascicle.core.files import write_text
from fascicle.core.isolated import Limits
from fascicle.mesh.formats.mesh_file import (
    LINE,
    POLY_LINE,
    TETRAHEDRON,
    TRIANGLE,
    VTK_IGNORED,
    MeshFile,
    damaged,
)

VERTICES, STRIP, POLYGON = 2, 6, 7  # VTK's numbers of cells that are not used
XML_FORMATS = (".vtu", ".vtp")
STATED = re.compile(rb'NumberOf(Points|Cells|Verts|Lines|Strips|Polys)\s*=\s*"\s*(\d+)')
SMALLEST_ITEM = 8  # bytes; a point takes 12 at least, a cell 9
LONGEST_NUMBER = 20  # digits
OTHER_NAMES = {POLYGON: "polygons", STRIP: "triangle strips"}


def read_vtk(path: Path) -> MeshFile:
    """Read a VTK, VTU, VTP, OBJ or STL file by VTK's own reader.

    It may crash, or take any amount of memory: call it by `fascicle.core.isolated`. Nothing here
    imports PyVista, so that a child process starts 0.1 s sooner.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy

    _check_stated_counts(path)
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
    try:
        cells, index, others = _cells(*_listed(data))
        cell_arrays = _named_arrays(data.GetCellData())
        cell_data = {
            kind: {name: values[rows] for name, values in cell_arrays.items()}
            for kind, rows in index.items()
        }
    except (IndexError, ValueError):
        raise damaged(path, "its list of cells contradicts itself") from None
    positions = data.GetPoints()  # None in a file that holds none
    points = np.empty((0, 3)) if positions is None else vtk_to_numpy(positions.GetData())
    lines = index.get(LINE, np.empty(0))
    has_polylines = np.unique(lines).size < lines.size
    return MeshFile(
        path, points.astype(float), cells, _named_arrays(data.GetPointData()), cell_data, others,
        has_polylines,
    )  # fmt: skip


def _check_stated_counts(path: Path) -> None:
    """Refuse an XML file that states more points or cells than a file of its size may hold."""
    if path.suffix.lower() not in XML_FORMATS:
        return  # others state sizes too, but VTK compares them with the file, or memory is limited
    most = Limits.of(path).memory / SMALLEST_ITEM
    for what, number in STATED.findall(path.read_bytes()):
        if len(number) > LONGEST_NUMBER or int(number) > most:
            raise InputError(
                f"{path}: states {number[:LONGEST_NUMBER].decode()} {what.decode().lower()}, and a "
                f"file of {path.stat().st_size / 2**20:.3g} MB may hold {most:.2g}; it is damaged, "
                "export it again"
            )


def _named_arrays(fields: Any) -> dict[str, NDArray[Any]]:
    """Arrays of numbers by their names."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    arrays = {}
    for k in range(fields.GetNumberOfArrays()):
        array = fields.GetArray(k)  # None for one of texts
        if array is not None and array.GetName() is not None:
            arrays[str(array.GetName())] = vtk_to_numpy(array)
    return arrays


def _vtk_reader(path: Path) -> Any:
    """VTK's own reader: pyvista's would log complaints where they cannot be collected."""
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
    if is_ascii_vtk(content):
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
        if isinstance(printed, bytes):  # it quotes a file that is no text
            printed = printed.decode(errors="replace")
        # "ERROR: In vtkX.cxx, line 7", then "vtkX (0x55aa): what happened"
        for text in re.split(r"^\w+: In .*, line \d+$", printed, flags=re.MULTILINE):
            # the range of an array with an inf in it cannot be read back; it is not needed
            if text.strip() and "InformationKey" not in text:
                complaints.append(one_line(re.sub(r"^\s*\w+ \(0x\w+\): ", "", text)))


def _listed(data: Any) -> tuple[Integers, Integers, Integers]:
    """VTK's number of the kind of each cell (m,), where its points start (m + 1,), all points."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    is_grid = data.IsA("vtkUnstructuredGrid")
    lists = {0: data.GetCells()} if is_grid else {
        VERTICES: data.GetVerts(), POLY_LINE: data.GetLines(),
        POLYGON: data.GetPolys(), STRIP: data.GetStrips(),
    }  # fmt: skip
    none = np.empty(0, np.int64)
    kinds, sizes, points = [none], [none], [none]
    for number, cells in lists.items():
        if cells is not None and cells.GetNumberOfCells():  # a file may hold points alone
            sizes.append(np.diff(vtk_to_numpy(cells.GetOffsetsArray()).astype(np.int64)))
            points.append(vtk_to_numpy(cells.GetConnectivityArray()).astype(np.int64))
            kinds.append(np.full(len(sizes[-1]), number))
    kind, size = np.concatenate(kinds), np.concatenate(sizes)
    kind[(kind == POLYGON) & (size == 3)] = TRIANGLE
    start = np.concatenate([[0], np.cumsum(size)])
    return _kinds(data) if is_grid else kind, start, np.concatenate(points)


def _kinds(grid: Any) -> Integers:
    """VTK's number of the kind of each cell of an unstructured grid."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkVersion

    version = vtkVersion.GetVTKMajorVersion(), vtkVersion.GetVTKMinorVersion()
    kinds = grid.GetCellTypes() if version >= (9, 6) else grid.GetCellTypesArray()
    return np.empty(0, np.int64) if kinds is None else vtk_to_numpy(kinds).astype(np.int64)


def _cells(
    kinds: Integers, start: Integers, points: Integers
) -> tuple[dict[int, Integers], dict[int, Integers], dict[str, int]]:
    """Cells of the kinds used here, the cell of the file that each stands for, and other kinds.

    A line of several points becomes as many segments as it has.
    """
    from vtkmodules.vtkCommonDataModel import vtkCellTypes

    cells, index = {}, {}
    for kind, corners in ((TRIANGLE, 3), (TETRAHEDRON, 4)):
        rows = np.flatnonzero(kinds == kind)
        if rows.size:
            cells[kind] = points[start[rows][:, None] + np.arange(corners)]
            index[kind] = rows
    is_line = np.isin(kinds, (LINE, POLY_LINE))
    if is_line.any():
        cell = np.repeat(np.arange(len(kinds)), np.diff(start))
        inside = (cell[:-1] == cell[1:]) & is_line[cell[:-1]]
        cells[LINE] = np.column_stack([points[:-1], points[1:]])[inside]
        index[LINE] = cell[:-1][inside]
    used = (LINE, POLY_LINE, TRIANGLE, TETRAHEDRON, *VTK_IGNORED)
    found, counts = np.unique(kinds[~np.isin(kinds, used)], return_counts=True)
    names = (OTHER_NAMES.get(k, vtkCellTypes.GetClassNameFromTypeId(k)) for k in found.tolist())
    others = {
        name.removeprefix("vtk"): int(count) for name, count in zip(names, counts, strict=True)
    }
    return cells, index, others


def write_grid(
    path: Path,
    points: Floats,
    cells: Integers,
    kind: int,
    point_data: dict[str, Floats] | None = None,
    cell_data: dict[str, Floats] | None = None,
) -> None:
    """Write cells of one kind as a compressed VTU file, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    points, cells : (n, 3) and (m, k) arrays
        Positions (mm) and point indices.
    kind : int
        VTK's number of that kind of cell, such as `TETRAHEDRON`.
    point_data, cell_data : dict of name to array, optional
        Arrays with one row a point, or a cell.
    """
    import pyvista as pv

    grid = pv.UnstructuredGrid({kind: cells}, np.asarray(points))
    grid.point_data.update(point_data or {})
    grid.cell_data.update(cell_data or {})
    _save(grid, path)


def write_surface(
    path: Path,
    points: Floats,
    triangles: Integers,
    cell_data: dict[str, NDArray[np.generic]] | None = None,
) -> None:
    """Write a triangle surface as VTP, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    points, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and point indices.
    cell_data : dict of name to array, optional
        Arrays with one row a triangle.
    """
    import pyvista as pv

    surface = pv.PolyData.from_regular_faces(np.asarray(points), triangles)
    surface.cell_data.update(cell_data or {})
    _save(surface, path)


def _save(data: Any, path: Path) -> None:
    """Write by way of memory: on a full disk VTK crashes, and Python raises an error."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    is_surface = path.suffix == ".vtp"
    writer: Any = vtkXMLPolyDataWriter() if is_surface else vtkXMLUnstructuredGridWriter()
    writer.SetInputData(data)
    writer.SetDataModeToBinary()  # as base64, so the output is text
    writer.WriteToOutputStringOn()
    writer.Write()
    write_text(path, writer.GetOutputString())


def is_ascii_vtk(content: bytes) -> bool:
    """Whether the third line of a legacy VTK file says that numbers follow as text."""
    return [line.strip().upper() for line in content.split(b"\n", 3)[2:3]] == [b"ASCII"]
