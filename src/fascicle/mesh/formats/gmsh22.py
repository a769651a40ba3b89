"""Gmsh files of format 2.

meshio mixes up element data beside cells of several kinds in this format, and takes no data of some
elements only, as Gmsh writes fibres of tetrahedra that lie beside triangles. The format is that of
the Gmsh reference manual, section "MSH file format version 2 (Legacy)".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import one_line
from fascicle.mesh.formats.mesh_file import GROUP, LINE, TETRAHEDRON, TRIANGLE, MeshFile, damaged

HEADER = re.compile(rb"\$MeshFormat\s+2(?:\.\d+)?\s+([01])\s+8\s*\n")
# Gmsh's number of an element type: its name and how many nodes it has
TYPES = {
    1: ("line", 2), 2: ("triangle", 3), 3: ("quadrangle", 4), 4: ("tetrahedron", 4),
    5: ("hexahedron", 8), 6: ("prism", 6), 7: ("pyramid", 5), 8: ("line3", 3), 9: ("triangle6", 6),
    10: ("quadrangle9", 9), 11: ("tetrahedron10", 10), 15: ("point", 1),
}  # fmt: skip
USED = {1: LINE, 2: TRIANGLE, 4: TETRAHEDRON}
POINT = 15
INT, FLOAT = 4, 8  # bytes
LARGEST_VALUE = 9  # components of a tensor


# Elements by Gmsh's number of their type; a row each: number, physical group (0: none), nodes
_Elements = dict[int, Integers]


class _Content:
    """The bytes of a file and how far they were read."""

    def __init__(self, content: bytes, start: int, is_binary: bool) -> None:
        self.content, self.at, self.is_binary = content, start, is_binary

    def line(self) -> str:
        end = self.content.find(b"\n", self.at)
        if end < 0:
            raise ValueError("ends within a section")
        line, self.at = self.content[self.at : end], end + 1
        return line.decode("utf-8", "replace").strip()

    def count(self) -> int:
        count = int(self.line())
        if not 0 <= count <= len(self.content):  # each takes a byte at least
            raise ValueError(f"announces {count} items")
        return count

    def ints(self, count: int) -> Integers:
        if count < 0 or self.at + INT * count > len(self.content):
            raise ValueError("ends within a section")
        values = np.frombuffer(self.content, "<i4", count, self.at)
        self.at += INT * count
        return values.astype(np.int64)

    def table(self, rows: int, columns: int) -> Floats:
        """Rows of one whole number and so many others (rows, 1 + columns)."""
        if not self.is_binary:
            lines = [self.line() for _ in range(rows)]
            numbers = np.array(" ".join(lines).split(), dtype=float)
            return numbers.reshape(rows, 1 + columns)
        row = np.dtype([("id", "<i4"), ("values", "<f8", (columns,))])
        if self.at + row.itemsize * rows > len(self.content):
            raise ValueError("ends within a section")
        read = np.frombuffer(self.content, row, rows, self.at)
        self.at += row.itemsize * rows
        return np.column_stack([read["id"].astype(float), read["values"]])

    def end(self, section: str) -> None:
        line = self.line() or self.line()  # in a binary file a line end comes first
        if line != f"$End{section}":
            raise ValueError(f"no $End{section} where it should be")


def is_gmsh22(content: bytes) -> bool:
    """Whether these are the first bytes of a Gmsh file of format 2."""
    return HEADER.match(content) is not None


def read_gmsh22(path: Path, content: bytes) -> MeshFile:
    """Read a Gmsh file of format 2, text or binary.

    Returns
    -------
    MeshFile
        Physical groups are in the cell array `GROUP` and in ``groups``. Element data are cell
        arrays of the kinds that have any, not a number where an element has none.

    Raises
    ------
    InputError
        If the file is truncated or damaged.
    """
    try:
        return _parsed(path, content)
    except (ValueError, IndexError, OverflowError, MemoryError) as error:
        raise damaged(path, one_line(error)) from None


def _parsed(path: Path, content: bytes) -> MeshFile:
    header = HEADER.match(content)
    if header is None:
        raise ValueError("no header of format 2")
    is_binary = header[1] == b"1"
    reader = _Content(content, header.end(), is_binary)
    if is_binary and reader.ints(1)[0] != 1:
        raise ValueError("byte order of another machine")
    reader.end("MeshFormat")
    nodes: Floats | None = None
    elements: _Elements = {}
    groups: dict[str, tuple[int, int]] = {}
    data: dict[str, dict[str, Floats]] = {"NodeData": {}, "ElementData": {}}
    while content[reader.at :].strip():
        section = reader.line()
        if not section:
            continue
        name = section[1:]
        if section[0] != "$":
            raise ValueError(f"'{section[:40]}' where a section should start")
        if name == "PhysicalNames":
            groups = _read_groups(reader)
        elif name == "Nodes":
            nodes = reader.table(reader.count(), 3)
        elif name == "Elements":
            elements = (_binary_elements if is_binary else _text_elements)(reader, reader.count())
        elif name in data:
            title, table = _read_data(reader)
            data[name][title] = table
        else:
            reader.at = content.index(b"$End" + name.encode(), reader.at)
        reader.end(name)
    if nodes is None or not elements:
        raise ValueError("no nodes or no elements")
    return _assembled(path, nodes, elements, groups, data)


def _read_groups(reader: _Content) -> dict[str, tuple[int, int]]:
    groups = {}
    for _ in range(reader.count()):
        dimension, number, name = reader.line().split(maxsplit=2)
        groups[name.strip('"')] = (int(dimension), int(number))
    return groups


def _text_elements(reader: _Content, count: int) -> _Elements:
    by_shape: dict[tuple[int, int], list[str]] = {}
    for _ in range(count):
        line = reader.line()
        shape = line.split(maxsplit=3)[1:3]
        by_shape.setdefault((int(shape[0]), int(shape[1])), []).append(line)
    parts = []
    for (kind, tags), lines in by_shape.items():
        numbers = np.array(" ".join(lines).split(), dtype=np.int64)
        table = numbers.reshape(len(lines), 3 + tags + _corners(kind))
        parts.append((kind, tags, np.delete(table, (1, 2), axis=1)))
    return _joined(parts)


def _binary_elements(reader: _Content, count: int) -> _Elements:
    parts = []
    while count > 0:
        kind, rows, tags = map(int, reader.ints(3))
        if not 0 < rows <= count or tags < 0:
            raise ValueError(f"a block of {rows} elements with {tags} tags")
        columns = 1 + tags + _corners(kind)
        parts.append((kind, tags, reader.ints(rows * columns).reshape(rows, columns)))
        count -= rows
    return _joined(parts)


def _corners(kind: int) -> int:
    if kind not in TYPES:
        raise ValueError(f"unknown element type {kind}")
    return TYPES[kind][1]


def _joined(parts: list[tuple[int, int, Integers]]) -> _Elements:
    """Elements by type, from tables of number, tags and nodes; the first tag is the group."""
    tables: dict[int, list[Integers]] = {}
    for kind, tags, table in parts:
        group = table[:, 1] if tags else np.zeros(len(table), np.int64)
        rows = np.column_stack([table[:, 0], group, table[:, 1 + tags :]])
        tables.setdefault(kind, []).append(rows)
    return {kind: np.concatenate(of_kind) for kind, of_kind in tables.items()}


def _read_data(reader: _Content) -> tuple[str, Floats]:
    """Name of an array, and its rows: number of the node or element, and the values."""
    names = [reader.line().strip('"') for _ in range(reader.count())]
    for _ in range(reader.count()):
        reader.line()  # the time
    integers = [int(reader.line()) for _ in range(reader.count())]
    if not names or len(integers) < 3 or not 0 < integers[1] <= LARGEST_VALUE or integers[2] < 0:
        raise ValueError("data without a name or size")
    if integers[2] > len(reader.content):
        raise ValueError(f"announces {integers[2]} values")
    return names[0], reader.table(integers[2], integers[1])


def _assembled(
    path: Path,
    points: Floats,
    elements: _Elements,
    groups: dict[str, tuple[int, int]],
    data: dict[str, dict[str, Floats]],
) -> MeshFile:
    ids = points[:, 0].astype(np.int64)
    cells, cell_data, others = {}, {}, {}
    for kind, table in elements.items():
        if kind not in USED:
            if kind != POINT:
                others[TYPES[kind][0]] = len(table)
            continue
        number, group, nodes = table[:, 0], table[:, 1], table[:, 2:]
        place = _places(nodes, ids)
        if (place < 0).any():
            raise ValueError(f"no node {nodes[place < 0][0]}")
        cells[USED[kind]] = place
        cell_data[USED[kind]] = {GROUP: group.astype(float)} | _arrays(data["ElementData"], number)
    point_data = _arrays(data["NodeData"], ids)
    return MeshFile(path, points[:, 1:].copy(), cells, point_data, cell_data, others, groups=groups)


def _places(wanted: Integers, numbers: Integers) -> Integers:
    """Where each number stands among others; -1 where it does not."""
    order = np.argsort(numbers, kind="stable")
    at = np.searchsorted(numbers[order], wanted)
    place = order[np.minimum(at, len(order) - 1)]
    return np.where(numbers[place] == wanted, place, -1)


def _arrays(tables: dict[str, Floats], ids: Integers) -> dict[str, Floats]:
    """Values of each table in the order of these numbers, without tables that have none of them."""
    arrays = {}
    for name, table in tables.items():
        place = _places(ids, table[:, 0].astype(np.int64)) if len(table) else np.full(len(ids), -1)
        if (place >= 0).any():
            values = np.where((place >= 0)[:, None], table[place, 1:], np.nan)
            arrays[name] = values[:, 0] if values.shape[1] == 1 else values
    return arrays
