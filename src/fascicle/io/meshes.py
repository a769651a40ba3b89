"""Meshes in VTK, VTU, VTP, OBJ, STL, PLY, Gmsh and openCARP files."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError, printable
from fascicle.io.atomic import write_text

VTK_FORMATS = (".vtk", ".vtu", ".vtp", ".obj", ".stl")
MESHIO_FORMATS = (".ply", ".msh")  # VTK's PLY reader crashes on truncated files
OPENCARP_FORMATS = (".pts", ".elem")  # either stands for both, and for the `.lon`
PICKLE_FORMATS = (".pkl", ".pickle", ".npy", ".npz")

# What a complete file has near its end: VTK reads a truncated one as far as it goes.
HEAD, TAIL = 512, 1024  # bytes
# A binary STL is a header, the number of triangles, and so many bytes for each of them.
STL_HEADER, STL_TRIANGLE = 84, 50  # bytes

# VTK's numbers for the cells that are used here, and meshio's names for the same
LINE, POLY_LINE, TRIANGLE, TETRAHEDRON = 3, 4, 5, 10
VTK_IGNORED = (0, 1, 2)  # empty cells and lone vertices
MESHIO_CELLS = {"line": LINE, "triangle": TRIANGLE, "tetra": TETRAHEDRON}
GROUP = "gmsh:physical"  # meshio's name for the number of a cell's physical group


@dataclass(frozen=True)
class Mesh:
    """Points and cells of a file, whatever its format.

    Attributes
    ----------
    path : Path
        The file.
    points : (n, 3) array
        Positions, as they stand in the file.
    cells : dict of VTK cell number to (m, k) array
        Point indices of the cells of each kind.
    point_data : dict of name to array
        Arrays with one row a point.
    cell_data : dict of VTK cell number to dict of name to array
        Arrays with one row a cell of that kind.
    others : dict of name to int
        How many cells of kinds that are not used here the file holds as well.
    has_polylines : bool
        Whether a line of the file has become several, which then share its cell data.
    groups : dict of name to (dimension, number)
        Physical groups of a Gmsh file; the cells' numbers are in the cell array `GROUP`.
    """

    path: Path
    points: NDArray[np.float64]
    cells: dict[int, NDArray[np.int64]]
    point_data: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    cell_data: dict[int, dict[str, NDArray[np.float64]]] = field(default_factory=dict)
    others: dict[str, int] = field(default_factory=dict)
    has_polylines: bool = False
    groups: dict[str, tuple[int, int]] = field(default_factory=dict)

    def require(self, kind: int, name: str) -> NDArray[np.int64]:
        """Cells of one kind.

        Raises
        ------
        InputError
            If the file holds none, or a part of the mesh in other cells, which would be missing.
        """
        cells = self.cells.get(kind)
        others = ", ".join(f"{count} {other}" for other, count in self.others.items())
        if cells is None or not len(cells):
            found = f"{len(self.points)} points, other cells: {others or 'none'}"
            raise InputError(
                f"{self.path}: no {name} in this file ({found}); give a mesh that has {name}"
            )
        if self.others and kind != LINE:
            raise InputError(
                f"{self.path}: besides {len(cells)} {name} there are other cells ({others}); "
                f"make the whole mesh of {name}"
            )
        return cells


def check_file(path: Path, formats: Iterable[str], purpose: str) -> None:
    """Refuse a path that is missing, a folder, a pickle or of another format, in one line."""
    formats = tuple(formats)
    suffix = path.suffix.lower()
    if suffix in PICKLE_FORMATS and suffix not in formats:
        raise InputError(
            f"{path}: {suffix} files can hold a Python pickle, which runs code when opened, and "
            f"are never read; in a Python you trust, save the {purpose} as {formats[0]} instead"
        )
    try:
        exists = path.exists()
    except OSError as error:  # a name that is too long, for one
        raise InputError(f"{path}: {error.strerror} ({purpose}); check the path") from None
    if not exists:
        raise InputError(f"{path}: no such file ({purpose}); check the path")
    if not path.is_file():
        raise InputError(f"{path}: is not a file ({purpose}); give the file itself")
    if suffix not in formats:
        raise InputError(
            f"{path}: cannot read '{suffix or 'no suffix'}' as {purpose}; "
            f"use one of {', '.join(formats)}"
        )


def read_mesh(path: Path | str, purpose: str = "mesh") -> Mesh:
    """Read a mesh file of any supported format.

    Raises
    ------
    InputError
        If the file is missing, of another format, truncated or otherwise unreadable, empty, or
        has coordinates that are not finite.
    """
    path = Path(path)
    check_file(path, VTK_FORMATS + MESHIO_FORMATS + OPENCARP_FORMATS, purpose)
    if path.suffix.lower() in OPENCARP_FORMATS:
        from fascicle.io.opencarp_mesh import read_opencarp_mesh  # which needs Mesh from here

        return read_opencarp_mesh(path, purpose)
    _check_complete(path)
    if path.suffix.lower() == ".msh":
        mesh = _read_gmsh(path)
    else:
        mesh = _read_meshio(path) if path.suffix.lower() in MESHIO_FORMATS else _read_vtk(path)
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


def _check_complete(path: Path) -> None:
    """Refuse files without the end that their format promises."""
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
        ".vtk": ("line end", tail[-1:].isspace() or not _is_ascii_vtk(head)),
    }
    end, complete = promised.get(path.suffix.lower(), ("", True))
    if size == 0:
        raise InputError(f"{path}: the file is empty; export or copy it again")
    if not complete:
        raise InputError(
            f"{path}: truncated or damaged (no {end} at its end); export or copy it again"
        )


def _stl_is_whole(head: bytes, tail: bytes, size: int) -> bool:
    announced = int.from_bytes(head[STL_HEADER - 4 : STL_HEADER], "little")
    fits = len(head) >= STL_HEADER and size >= STL_HEADER + STL_TRIANGLE * announced
    return (fits and any(tail)) or b"endsolid" in tail.lower()


def _is_ascii_vtk(content: bytes) -> bool:
    """Whether the third line of a legacy VTK file says that numbers follow as text."""
    return [line.strip().upper() for line in content.split(b"\n", 3)[2:3]] == [b"ASCII"]


def _read_vtk(path: Path) -> Mesh:
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
    return Mesh(path, points, cells, point_data, cell_data, others, has_polylines)


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
    if _is_ascii_vtk(content):
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
                complaints.append(_one_line(re.sub(r"^\s*\w+ \(0x\w+\): ", "", text)))


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


def _read_gmsh(path: Path) -> Mesh:
    from fascicle.io.gmsh22 import is_gmsh22, read_gmsh22  # which needs Mesh from here

    content = path.read_bytes()
    return read_gmsh22(path, content) if is_gmsh22(content) else _read_meshio(path)


def _read_meshio(path: Path) -> Mesh:
    import meshio

    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            # meshio.read would leave the program when it cannot read a file
            data = meshio.gmsh.read(path) if path.suffix.lower() == ".msh" else _read_ply(path)
    except (
        meshio.ReadError, ValueError, LookupError, ArithmeticError, AssertionError, OSError,
        EOFError, TypeError, AttributeError, RuntimeError, MemoryError, struct.error,
    ) as error:  # fmt: skip
        found = _one_line(error)
        raise InputError(
            f"{path}: truncated or damaged ({found}); export or copy it again"
        ) from None
    if "not closed" in printed.getvalue():  # of a section of a Gmsh file
        found = _one_line(printed.getvalue())
        raise InputError(f"{path}: truncated or damaged ({found}); export or copy it again")
    cells: dict[int, NDArray[np.int64]] = {}
    cell_data: dict[int, dict[str, NDArray[np.float64]]] = {}
    for name, kind in MESHIO_CELLS.items():
        blocks = [i for i, block in enumerate(data.cells) if block.type == name]
        if blocks:
            cells[kind] = np.concatenate([data.cells[i].data for i in blocks]).astype(np.int64)
            cell_data[kind] = {
                key: np.concatenate([np.asarray(arrays[i]) for i in blocks])
                for key, arrays in data.cell_data.items()
            }
    points = np.asarray(data.points, dtype=float)
    if points.shape[1] != 3:
        raise InputError(f"{path}: points have {points.shape[1]} coordinates; 3 are needed")
    others = {
        block.type: len(block.data)
        for block in data.cells
        if block.type not in MESHIO_CELLS and block.type != "vertex"
    }
    groups = {name: (int(of), int(number)) for name, (number, of) in data.field_data.items()}
    return Mesh(path, points, cells, dict(data.point_data), cell_data, others, groups=groups)


def _read_ply(path: Path) -> Any:
    """Read a PLY file by meshio, which has to be helped with some."""
    import meshio

    content = path.read_bytes()
    if b"end_header" not in content:  # meshio would look for it forever
        raise ValueError("no end_header")
    # half the world writes vertex_index, which meshio does not know
    content = re.sub(rb" vertex_index(?=\s)", b" vertex_indices", content, count=1)
    data = meshio.ply.read(io.BytesIO(content))
    announced = dict(re.findall(rb"element (vertex|face) (\d+)", content.split(b"end_header")[0]))
    found = {b"vertex": len(data.points), b"face": sum(len(block.data) for block in data.cells)}
    for element, number in announced.items():
        if int(number) != found[element]:
            raise ValueError(f"{found[element]} of {int(number)} elements '{element.decode()}'")
    return data


def _one_line(error: object) -> str:
    text = " ".join(str(error).split())[:160] or type(error).__name__
    return printable(text)


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
