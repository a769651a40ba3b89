"""Readers of PLY, VTU and Gmsh files: by meshio, but for Gmsh's format 2, which is read here.

VTK's PLY reader crashes on truncated files, so meshio reads these. In Gmsh's format 2 (Gmsh
reference manual, "MSH file format version 2 (Legacy)") meshio mixes up element data if there are
cells of several kinds, and refuses data that only some elements have, such as fibres of tetrahedra
in a file with triangles.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, one_line
from fascicle.core.isolated import DAMAGED
from fascicle.mesh.mesh_file import (
    CELL_CORNERS,
    GROUP,
    LINE,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    MeshFile,
    damaged,
)

# Element types by Gmsh's number: name, number of nodes, and VTK's cell type (None: not read). Of
# quadratic ones the corners are read, which come first.
GMSH_ELEMENTS = {
    1: ("line", 2, LINE), 2: ("triangle", 3, TRIANGLE), 3: ("quad", 4, QUADRANGLE),
    4: ("tetra", 4, TETRAHEDRON), 5: ("hexahedron", 8, 12), 6: ("wedge", 6, 13),
    7: ("pyramid", 5, 14), 8: ("line3", 3, None), 9: ("triangle6", 6, TRIANGLE),
    10: ("quad9", 9, QUADRANGLE), 11: ("tetra10", 10, TETRAHEDRON), 12: ("hexahedron27", 27, 12),
    13: ("wedge18", 18, 13), 14: ("pyramid14", 14, 14), 15: ("vertex", 1, None),
    16: ("quad8", 8, QUADRANGLE), 17: ("hexahedron20", 20, 12), 18: ("wedge15", 15, 13),
    19: ("pyramid13", 13, 14),
}  # fmt: skip


def read_meshio(path: Path) -> MeshFile:
    """Read a Gmsh file of format 4, a PLY or a VTU file by meshio."""
    import meshio

    faults = (*DAMAGED, meshio.ReadError, MemoryError, SyntaxError, struct.error, zlib.error)
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            # meshio.read would exit the program if it could not read the file
            readers = {".msh": meshio.gmsh.read, ".vtu": meshio.vtu.read, ".ply": _read_ply}
            data = readers[path.suffix.lower()](path)
    except faults as error:
        raise damaged(path, one_line(error)) from None
    if "not closed" in printed.getvalue():  # meshio's warning about a section of a Gmsh file
        raise damaged(path, one_line(printed.getvalue()))
    cells: dict[int, Integers] = {}
    cell_data: dict[int, dict[str, Floats]] = {}
    used = {name: kind for name, _, kind in GMSH_ELEMENTS.values() if kind is not None}
    for kind, corners in CELL_CORNERS.items():
        if blocks := [i for i, block in enumerate(data.cells) if used.get(block.type) == kind]:
            nodes = [data.cells[i].data[:, :corners] for i in blocks]
            cells[kind] = np.concatenate(nodes).astype(np.int64)
            cell_data[kind] = {
                key: np.concatenate([np.asarray(arrays[i]) for i in blocks])
                for key, arrays in data.cell_data.items()
            }
    points = np.asarray(data.points, dtype=float)
    if points.shape[1] != 3:
        raise InputError(f"{path}: points have {points.shape[1]} coordinates; 3 are needed")
    other_cells = {
        block.type: len(block.data) for block in data.cells if block.type not in (*used, "vertex")
    }
    groups = {
        name: (int(values[1]), int(values[0])) for name, values in data.field_data.items()
        if path.suffix.lower() == ".msh"
    }  # fmt: skip
    return MeshFile(
        path, points, cells, dict(data.point_data), cell_data, other_cells, groups=groups
    )


def _read_ply(path: Path) -> Any:
    """Read a PLY file by meshio, with checks and a correction that it needs."""
    import meshio

    content = path.read_bytes()
    if b"end_header" not in content:  # meshio would look for it forever
        raise ValueError("no end_header")
    # many programs write vertex_index, which meshio does not know
    content = re.sub(rb" vertex_index(?=\s)", b" vertex_indices", content, count=1)
    # nor does it know edges, which follow the faces, as of a wire frame
    faces = content.find(b"element face")
    edges = re.compile(rb"element edge \d+\s*\n(property [^\n]*\n)*").search(content, faces)
    if faces > 0 and edges:
        content = content[: edges.start()] + content[edges.end() :]
    data = meshio.ply.read(io.BytesIO(content))
    announced = dict(re.findall(rb"element (vertex|face) (\d+)", content.split(b"end_header")[0]))
    counts = {b"vertex": len(data.points), b"face": sum(len(block.data) for block in data.cells)}
    for element, number in announced.items():
        if int(number) != counts[element]:
            raise ValueError(f"{counts[element]} of {int(number)} elements '{element.decode()}'")
    return data


def gmsh22_header(content: bytes) -> re.Match[bytes] | None:
    """Match of the header of a Gmsh file of format 2; its group is 1 in a binary file."""
    return re.match(rb"\$MeshFormat\s+2(?:\.\d+)?\s+([01])\s+8\s*\n", content)


def read_gmsh22(path: Path, content: bytes) -> MeshFile:
    """Read a Gmsh file of format 2, text or binary.

    Physical groups are in the cell array `GROUP` and in ``groups``. Element data become cell arrays
    of the kinds of cells that have any, NaN for elements without.
    """
    try:
        return _parsed(path, content)
    except (ValueError, LookupError, OverflowError, MemoryError) as error:
        raise damaged(path, one_line(error)) from None


def _parsed(path: Path, content: bytes) -> MeshFile:
    """Parse a Gmsh file of format 2; ValueError and the like if it is damaged."""
    header = gmsh22_header(content)
    is_binary = header is not None and header[1] == b"1"
    nodes, elements = np.empty((0, 4)), list[tuple[int, Integers]]()
    groups: dict[str, tuple[int, int]] = {}
    data: dict[str, dict[str, Floats]] = {"NodeData": {}, "ElementData": {}}
    for name, body in _sections(content):
        if name == "MeshFormat" and is_binary and body.split(b"\n")[1][:4] != b"\1\0\0\0":
            raise ValueError("byte order of another machine")
        if name == "PhysicalNames":
            for line in _counted(body)[1].decode("utf-8", "replace").strip().splitlines():
                dimension, number, group = line.split(maxsplit=2)
                groups[group.strip().strip('"')] = (int(dimension), int(number))
        elif name == "Nodes":
            nodes = _table(*_counted(body), 3, is_binary)
        elif name == "Elements":
            elements = (_binary_elements if is_binary else _text_elements)(*_counted(body))
        elif name in data:
            title, table = _read_data(body, is_binary)
            data[name][title] = table
    if not len(nodes) or not elements:
        raise ValueError("no nodes or no elements")
    ids = nodes[:, 0].astype(np.int64)
    cells, cell_data, other_cells = dict[int, Integers](), {}, dict[str, int]()
    for element, rows in elements:
        type_name, _, kind = GMSH_ELEMENTS[element]
        if kind is None and type_name != "vertex":
            other_cells[type_name] = other_cells.get(type_name, 0) + len(rows)
    for kind, corners in CELL_CORNERS.items():
        of_kind = [rows[:, : 2 + corners] for e, rows in elements if GMSH_ELEMENTS[e][2] == kind]
        if of_kind:
            rows = np.concatenate(of_kind)
            cells[kind] = _places(rows[:, 2:], ids)
            if (absent := cells[kind] < 0).any():
                raise ValueError(f"no node {rows[:, 2:][absent][0]}")
            arrays = {GROUP: rows[:, 1].astype(float)} | _arrays(data["ElementData"], rows[:, 0])
            cell_data[kind] = arrays
    point_data = _arrays(data["NodeData"], ids)
    return MeshFile(
        path, nodes[:, 1:].copy(), cells, point_data, cell_data, other_cells, groups=groups
    )


def _sections(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Name and body of each section of a Gmsh file."""
    position = 0
    while content[position:].strip():
        start = re.compile(rb"\s*\$(\w+)\s*?\n").match(content, position)
        if start is None:
            raise ValueError(f"no section where one should start (byte {position})")
        end = b"$End" + start[1]
        end_position = content.find(end, start.end())
        position = content.find(b"\n", end_position) + 1 or len(content)
        if end_position < 0 or content[end_position:position].strip() != end:
            raise ValueError("ends within a section")
        yield start[1].decode(), content[start.end() : end_position]


def _lines(body: bytes, count: int) -> tuple[list[str], bytes]:
    """First `count` lines of a section's body, and the remaining bytes."""
    *lines, remainder = body.split(b"\n", max(count, 0))
    if len(lines) != count:
        raise ValueError("ends within a section")
    return [line.decode("utf-8", "replace").strip() for line in lines], remainder


def _counted(body: bytes) -> tuple[int, bytes]:
    """Number in the first line of a section's body, and the remaining bytes."""
    (count,), remainder = _lines(body, 1)
    return int(count), remainder


def _table(rows: int, body: bytes, columns: int, is_binary: bool) -> Floats:
    """Table (rows, 1 + columns) whose rows are an integer and `columns` floating-point numbers."""
    if not is_binary:
        return np.array(body.decode("ascii").split(), dtype=float).reshape(rows, 1 + columns)
    row = np.dtype([("id", "<i4"), ("values", "<f8", (columns,))])
    if not 0 <= len(body) - rows * row.itemsize <= 2:  # a line end may follow
        raise ValueError(f"announces {rows} rows")
    read = np.frombuffer(body, row, rows)
    return np.column_stack([read["id"].astype(float), read["values"]])


def _untagged(table: Integers, tags: int) -> Integers:
    """Rows of number, group and nodes of elements, from rows of number, tags and nodes.

    The group is the first tag, or 0 without tags.
    """
    group = table[:, 1] if tags else np.zeros(len(table), dtype=np.int64)
    return np.column_stack([table[:, 0], group, table[:, 1 + tags :]]).astype(np.int64)


def _text_elements(count: int, body: bytes) -> list[tuple[int, Integers]]:
    """Type of each block of elements, with the numbers, groups and nodes of the elements."""
    by_shape: dict[tuple[int, int], list[str]] = {}
    lines = body.decode("ascii").strip().splitlines()
    if len(lines) != count:
        raise ValueError(f"announces {count} elements, {len(lines)} follow")
    for line in lines:
        kind, tags = line.split(maxsplit=3)[1:3]
        by_shape.setdefault((int(kind), int(tags)), []).append(line)
    parts = []
    for (element_type, n), rows in by_shape.items():
        numbers = np.array(" ".join(rows).split(), dtype=np.int64)
        table = numbers.reshape(len(rows), 3 + n + GMSH_ELEMENTS[element_type][1])
        parts.append((element_type, _untagged(np.delete(table, (1, 2), axis=1), n)))
    return parts


def _binary_elements(count: int, body: bytes) -> list[tuple[int, Integers]]:
    """Blocks of elements as of `_text_elements`, from a binary file."""
    parts, at = [], 0
    while count > 0:
        kind, rows, tags = map(int, np.frombuffer(body, "<i4", 3, at))
        if not 0 < rows <= count or tags < 0:
            raise ValueError(f"a block of {rows} elements with {tags} tags")
        columns = 1 + tags + GMSH_ELEMENTS[kind][1]
        table = np.frombuffer(body, "<i4", rows * columns, at + 12).reshape(rows, columns)
        parts.append((kind, _untagged(table, tags)))
        at += 12 + table.nbytes
        count -= rows
    return parts


def _read_data(body: bytes, is_binary: bool) -> tuple[str, Floats]:
    """Name of an array, and its rows: number of the node or element, and the values."""
    tags = []
    for _ in range(3):  # string tags, real tags (the time) and integer tags
        count, body = _counted(body)
        lines, body = _lines(body, count)
        tags.append(lines)
    names, _, (_, components, rows, *_) = tags
    if not 0 < int(components) <= 9:
        raise ValueError(f"data of {components} components")
    return names[0].strip('"'), _table(int(rows), body, int(components), is_binary)


def _places(ids: Integers, numbers: Integers) -> Integers:
    """Position of each of `ids` in `numbers`; -1 if it is absent."""
    order = np.argsort(numbers, kind="stable")
    at = np.searchsorted(numbers[order], ids)
    place = order[np.minimum(at, len(order) - 1)]
    return np.where(numbers[place] == ids, place, -1)


def _arrays(tables: dict[str, Floats], ids: Integers) -> dict[str, Floats]:
    """Values of each table in the order of `ids`; tables with none of these are left out."""
    arrays = {}
    for name, table in tables.items():
        place = _places(ids, table[:, 0].astype(np.int64)) if len(table) else np.full(len(ids), -1)
        if (place >= 0).any():
            values = np.where((place >= 0)[:, None], table[place, 1:], np.nan)
            arrays[name] = values[:, 0] if values.shape[1] == 1 else values
    return arrays
