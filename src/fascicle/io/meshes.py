"""Meshes in VTK, VTU, VTP, OBJ, STL, PLY and Gmsh files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.io.atomic import atomic_path

VTK_FORMATS = (".vtk", ".vtu", ".vtp", ".obj", ".stl", ".ply")
GMSH_FORMATS = (".msh",)
PICKLE_FORMATS = (".pkl", ".pickle", ".npy", ".npz")

# VTK's numbers for the cells that are used here, and meshio's names for the same
LINE, POLY_LINE, TRIANGLE, TETRAHEDRON = 3, 4, 5, 10
MESHIO_CELLS = {"line": LINE, "triangle": TRIANGLE, "tetra": TETRAHEDRON}


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
    """

    path: Path
    points: NDArray[np.float64]
    cells: dict[int, NDArray[np.int64]]
    point_data: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    cell_data: dict[int, dict[str, NDArray[np.float64]]] = field(default_factory=dict)

    def require(self, kind: int, name: str) -> NDArray[np.int64]:
        """Cells of one kind.

        Raises
        ------
        InputError
            If the file holds none.
        """
        cells = self.cells.get(kind)
        if cells is None or not len(cells):
            raise InputError(
                f"{self.path}: no {name} in this file ({len(self.points)} points, "
                f"{sum(map(len, self.cells.values()))} cells of other kinds); "
                f"give a mesh that has {name}"
            )
        return cells


def check_file(path: Path, formats: Iterable[str], purpose: str) -> None:
    """Refuse a path that is missing, a folder, a pickle or of another format, in one line."""
    formats = tuple(formats)
    suffix = path.suffix.lower()
    if suffix in PICKLE_FORMATS and suffix not in formats:
        raise InputError(
            f"{path}: {suffix} files can hold a Python pickle, which runs code when opened, and are "
            f"never read; in a Python you trust, save the {purpose} as {formats[0]} instead"
        )
    if not path.exists():
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
    check_file(path, VTK_FORMATS + GMSH_FORMATS, purpose)
    mesh = _read_gmsh(path) if path.suffix.lower() in GMSH_FORMATS else _read_vtk(path)
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
            raise InputError(f"{path}: cells refer to points that are not there; file is truncated")
    return mesh


def _read_vtk(path: Path) -> Mesh:
    import pyvista as pv

    with pv.VtkErrorCatcher(raise_errors=False, send_to_logging=False) as catcher:
        try:
            data: Any = pv.read(path)
        except (ValueError, RuntimeError, OSError, AttributeError, TypeError) as error:
            raise InputError(
                f"{path}: cannot be read ({_one_line(error)}); export it again"
            ) from None
    if catcher.error_events:
        raise InputError(
            f"{path}: truncated or damaged ({_one_line(catcher.error_events[0].alert)}); "
            "export or copy it again"
        )
    if isinstance(data, pv.PolyData):
        cells, index = _polydata_cells(data)
    elif isinstance(data, pv.UnstructuredGrid):
        cells, index = _grid_cells(data)
    else:
        raise InputError(
            f"{path}: holds a {type(data).__name__}, not a mesh of triangles, tetrahedra or lines; "
            "export it as an unstructured grid or polydata"
        )
    cell_data = {
        kind: {name: np.asarray(data.cell_data[name])[rows] for name in data.cell_data}
        for kind, rows in index.items()
    }
    point_data = {name: np.asarray(data.point_data[name]) for name in data.point_data}
    return Mesh(path, np.asarray(data.points, dtype=float), cells, point_data, cell_data)


Cells = tuple[dict[int, NDArray[np.int64]], dict[int, NDArray[np.int64]]]


def _polydata_cells(data: Any) -> Cells:
    """Triangles and line segments of a polydata, and the cell that each stands for."""
    cells, index = {}, {}
    lines = data.n_lines
    if lines:
        cells[LINE], index[LINE] = _segments(*_offsets(data.GetLines()), data.n_verts)
    if data.GetPolys().GetNumberOfCells():
        offsets, connectivity = _offsets(data.GetPolys())
        first = data.n_verts + lines
        index[TRIANGLE] = first + np.flatnonzero(np.diff(offsets) == 3)
        starts = offsets[:-1][np.diff(offsets) == 3]
        cells[TRIANGLE] = connectivity[starts[:, None] + np.arange(3)]
    return cells, index


def _grid_cells(data: Any) -> Cells:
    cells, index = {}, {}
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
    import contextlib
    import io

    import meshio

    try:
        with contextlib.redirect_stdout(io.StringIO()):
            data = meshio.read(path)
    except (meshio.ReadError, ValueError, KeyError, IndexError, AssertionError, OSError) as error:
        raise InputError(
            f"{path}: truncated or not a Gmsh file ({_one_line(error)}); export it again"
        ) from None
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
    return Mesh(path, points, cells, dict(data.point_data), cell_data)


def _one_line(error: object) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__


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
    with atomic_path(path) as temporary:
        grid.save(temporary)


def write_surface(path: Path, points: NDArray[np.float64], triangles: NDArray[np.int64]) -> None:
    """Write a triangle surface as VTP, whole or not at all."""
    import pyvista as pv

    surface = pv.PolyData.from_regular_faces(np.asarray(points), triangles)
    with atomic_path(path) as temporary:
        surface.save(temporary)
