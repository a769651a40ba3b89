"""Gmsh and PLY files, by meshio."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, one_line
from fascicle.mesh.formats.mesh_file import LINE, TETRAHEDRON, TRIANGLE, MeshFile, damaged

MESHIO_CELLS = {"line": LINE, "triangle": TRIANGLE, "tetra": TETRAHEDRON}


def read_meshio(path: Path) -> MeshFile:
    """Read a Gmsh or PLY file by meshio."""
    import meshio

    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            # meshio.read would leave the program when it cannot read a file
            data = meshio.gmsh.read(path) if path.suffix.lower() == ".msh" else _read_ply(path)
    except (
        meshio.ReadError, ValueError, LookupError, ArithmeticError, AssertionError, OSError,
        EOFError, TypeError, AttributeError, RuntimeError, MemoryError, struct.error,
        NameError,  # of what its Gmsh reader has not met in the file
    ) as error:  # fmt: skip
        raise damaged(path, one_line(error)) from None
    if "not closed" in printed.getvalue():  # of a section of a Gmsh file
        raise damaged(path, one_line(printed.getvalue()))
    cells: dict[int, Integers] = {}
    cell_data: dict[int, dict[str, Floats]] = {}
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
    return MeshFile(path, points, cells, dict(data.point_data), cell_data, others, groups=groups)


def _read_ply(path: Path) -> Any:
    """Read a PLY file by meshio, after two corrections that it needs."""
    import meshio

    content = path.read_bytes()
    if b"end_header" not in content:  # meshio would look for it forever
        raise ValueError("no end_header")
    # many programs write vertex_index, which meshio does not know
    content = re.sub(rb" vertex_index(?=\s)", b" vertex_indices", content, count=1)
    data = meshio.ply.read(io.BytesIO(content))
    announced = dict(re.findall(rb"element (vertex|face) (\d+)", content.split(b"end_header")[0]))
    found = {b"vertex": len(data.points), b"face": sum(len(block.data) for block in data.cells)}
    for element, number in announced.items():
        if int(number) != found[element]:
            raise ValueError(f"{found[element]} of {int(number)} elements '{element.decode()}'")
    return data
