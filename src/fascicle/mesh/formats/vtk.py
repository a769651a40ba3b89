"""VTK, VTU, VTP, OBJ and STL files."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError, one_line
from fascicle.core.files import write_text
from fascicle.mesh.formats.mesh_file import (
    LINE,
    POLY_LINE,
    TETRAHEDRON,
    TRIANGLE,
    VTK_IGNORED,
    MeshFile,
)


def read_vtk(path: Path) -> MeshFile:
    """Read a VTK, VTU, VTP, OBJ or STL file by VTK's own reader."""
    import pyvista as pv

    reader = _vtk_reader(path)
    with _vtk_complaints() as complaints:
        reader.Update()
        output = reader.GetOutput()
    if complaints or output is None:
        found = complaints[0] if complaints else "nothing could be read"
        raise InputError(f"{path}: truncated or damaged ({found}); export or copy it again")
    data: Any = pv.wrap(output)
    others: dict[str, int] = {}
    try:
        if isinstance(data, pv.PolyData):
            cells, index = _polydata_cells(data, others)
        elif isinstance(data, pv.UnstructuredGrid):
            cells, index = _grid_cells(data, others)
        else:
            raise InputError(
                f"{path}: holds a {type(data).__name__}, not a mesh of triangles, tetrahedra or "
                "lines; export it as an unstructured grid or polydata"
            )
        cell_data = {
            kind: {name: np.asarray(data.cell_data[name])[rows] for name in data.cell_data}
            for kind, rows in index.items()
        }
    except IndexError:
        raise InputError(
            f"{path}: damaged (its list of cells contradicts itself); export or copy it again"
        ) from None
    point_data = {name: np.asarray(data.point_data[name]) for name in data.point_data}
    points = np.asarray(data.points, dtype=float)
    lines = index.get(LINE, np.empty(0))
    has_polylines = np.unique(lines).size < lines.size
    return MeshFile(path, points, cells, point_data, cell_data, others, has_polylines)


def _vtk_reader(path: Path) -> Any:
    """VTK's own reader: pyvista's would log complaints where nobody can collect them."""
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
        # VTK takes a file that ends within an array as whole; with an empty array after it the
        # end of the other is noticed
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
    """Collect the errors and warnings of VTK, which prints them where others raise."""
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
            # the range of an array with an inf in it cannot be read back; nobody needs it
            if text.strip() and "InformationKey" not in text:
                complaints.append(one_line(re.sub(r"^\s*\w+ \(0x\w+\): ", "", text)))


Cells = tuple[dict[int, NDArray[np.int64]], dict[int, NDArray[np.int64]]]


def _polydata_cells(data: Any, others: dict[str, int]) -> Cells:
    """Triangles and line segments of a polydata, and the cell that each stands for."""
    cells, index = {}, {}
    lines = data.n_lines
    if lines:
        cells[LINE], index[LINE] = _segments(*_offsets(data.GetLines()), data.n_verts)
    if data.GetPolys().GetNumberOfCells():
        offsets, connectivity = _offsets(data.GetPolys())
        first = data.n_verts + lines
        is_triangle = np.diff(offsets) == 3
        index[TRIANGLE] = first + np.flatnonzero(is_triangle)
        cells[TRIANGLE] = connectivity[offsets[:-1][is_triangle][:, None] + np.arange(3)]
        if not is_triangle.all():
            others["polygons"] = int((~is_triangle).sum())
    if data.GetStrips().GetNumberOfCells():
        others["triangle strips"] = data.GetStrips().GetNumberOfCells()
    return cells, index


def _grid_cells(data: Any, others: dict[str, int]) -> Cells:
    from vtkmodules.vtkCommonDataModel import vtkCellTypes

    cells, index = {}, {}
    if not data.n_cells:  # a file of points alone, as fibres often are
        return {}, {}
    offsets, connectivity = _offsets(data.GetCells())
    kinds = np.asarray(data.celltypes)
    for kind, corners in ((TRIANGLE, 3), (TETRAHEDRON, 4)):
        rows = np.flatnonzero(kinds == kind)
        if rows.size:
            cells[kind] = connectivity[offsets[rows][:, None] + np.arange(corners)]
            index[kind] = rows
    rows = np.flatnonzero((kinds == LINE) | (kinds == POLY_LINE))
    if rows.size:
        sizes = np.diff(offsets)[rows]
        local = np.concatenate([[0], np.cumsum(sizes)])
        flat = np.concatenate([connectivity[offsets[r] : offsets[r + 1]] for r in rows])
        cells[LINE], which = _segments(local, flat, 0)
        index[LINE] = rows[which]
    used = (LINE, POLY_LINE, TRIANGLE, TETRAHEDRON, *VTK_IGNORED)
    for kind, count in zip(
        *np.unique(kinds[~np.isin(kinds, used)], return_counts=True), strict=True
    ):
        name = vtkCellTypes.GetClassNameFromTypeId(int(kind)).removeprefix("vtk")
        others[name] = int(count)
    return cells, index


def _offsets(array: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    return (
        vtk_to_numpy(array.GetOffsetsArray()).astype(np.int64),
        vtk_to_numpy(array.GetConnectivityArray()).astype(np.int64),
    )


def _segments(
    offsets: NDArray[np.int64], connectivity: NDArray[np.int64], first: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Polylines as segments of two points, and the number of the polyline each came from."""
    pairs = np.column_stack([connectivity[:-1], connectivity[1:]])
    line = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    inside = line[:-1] == line[1:]
    return pairs[inside], first + line[:-1][inside]


def write_grid(
    path: Path,
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    kind: int,
    point_data: dict[str, NDArray[np.float64]] | None = None,
    cell_data: dict[str, NDArray[np.float64]] | None = None,
) -> None:
    """Write cells of one kind as a compressed VTU file, whole or not at all."""
    import pyvista as pv

    grid = pv.UnstructuredGrid({kind: cells}, np.asarray(points))
    for name, values in (point_data or {}).items():
        grid.point_data[name] = values
    for name, values in (cell_data or {}).items():
        grid.cell_data[name] = values
    _save(grid, path)


def write_surface(
    path: Path,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    cell_data: dict[str, NDArray[np.generic]] | None = None,
) -> None:
    """Write a triangle surface as VTP, whole or not at all."""
    import pyvista as pv

    surface = pv.PolyData.from_regular_faces(np.asarray(points), triangles)
    for name, values in (cell_data or {}).items():
        surface.cell_data[name] = values
    _save(surface, path)


def _save(data: Any, path: Path) -> None:
    """Let VTK write into memory: on a full disk it crashes, Python says so."""
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
