"""The text files of openCARP: `.pts`, `.elem`, `.lon`, `.surf` and `.vtx`.

The formats are those of the openCARP user manual (Plank et al., Comput. Methods Programs Biomed.
208, 106223, 2021): every file but `.lon` starts with the number of lines that follow, indices count
from 0, and lengths are in µm.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, printable
from fascicle.core.files import check_file, write_text
from fascicle.mesh.formats.mesh_file import (
    LINE,
    OPENCARP_FORMATS,
    TETRAHEDRON,
    TRIANGLE,
    MeshFile,
    damaged,
)

MICROMETRES = 1000.0  # per mm
# Coordinates that span less than this are in mm: as µm it would be 3 mm, less than any ventricle
# or tree; as mm it is 3 m, more than any torso.
LARGEST_IN_MM = 3000.0

# VTK's numbers for the elements that are used here, and how many nodes they have
ELEMENTS = {"Ln": (LINE, 2), "Tr": (TRIANGLE, 3), "Tt": (TETRAHEDRON, 4)}
OTHER_ELEMENTS = {
    "Cx": "connections",
    "Qd": "quadrangles",
    "Py": "pyramids",
    "Pr": "prisms",
    "Hx": "hexahedra",
    "Oc": "octahedra",
}
DOMAINS = ("intra", "extra")


class _Block(NamedTuple):
    """Elements of one type: their place in the file, nodes, and tags if there are any."""

    rows: Integers
    nodes: Integers
    tags: Integers | None


def opencarp_file(path: Path | str, suffix: str) -> Path:
    """Path of one file of a mesh, given its stem or any of its files."""
    path = Path(path)
    if path.suffix.lower() in (*OPENCARP_FORMATS, ".lon"):
        path = path.with_suffix("")
    return path.with_name(path.name + suffix)


def read_opencarp_mesh(path: Path | str, purpose: str = "mesh") -> MeshFile:
    """Read `.pts` and `.elem`, and `.lon` where there is one.

    Coordinates are in µm and become mm; those that span less than 3000 are taken to be in mm
    already.

    Parameters
    ----------
    path : path
        The stem (``heart`` for ``heart.pts``, ``heart.elem`` and ``heart.lon``) or one of these.
    purpose : str
        What to call it in an error.

    Returns
    -------
    MeshFile
        Tetrahedra, triangles and lines, with the cell arrays ``region`` (the tags), ``fibre`` and
        ``sheet`` where the files have them; points in mm.

    Raises
    ------
    InputError
        If a file is missing, truncated or damaged, or they contradict one another.
    """
    points = _read_points(opencarp_file(path, ".pts"), purpose)
    elements = opencarp_file(path, ".elem")
    blocks, others, count = _read_elements(elements, purpose, len(points))
    directions: dict[str, Floats] = {}
    if opencarp_file(path, ".lon").exists():
        directions = _read_directions(opencarp_file(path, ".lon"), count)
    cells, cell_data = {}, {}
    for kind, block in blocks.items():
        cells[kind] = block.nodes
        arrays = {name: values[block.rows] for name, values in directions.items()}
        if block.tags is not None:
            arrays["region"] = block.tags.astype(float)
        cell_data[kind] = arrays
    return MeshFile(elements, points, cells, {}, cell_data, others)


def _read_points(path: Path, purpose: str) -> Floats:
    points = _table(path, _counted_lines(path, purpose), (3,))
    extent = float(np.ptp(points, axis=0).max())
    return points if extent < LARGEST_IN_MM else points / MICROMETRES


def _read_elements(
    path: Path, purpose: str, points: int
) -> tuple[dict[int, _Block], dict[str, int], int]:
    """Elements by VTK's number of their kind, counts of other kinds, and of all."""
    lines = _counted_lines(path, purpose)
    by_type: dict[str, list[int]] = {}
    for row, line in enumerate(lines):
        by_type.setdefault(line.lstrip()[:2], []).append(row)
    blocks, others = {}, {}
    for code, rows in by_type.items():
        if code in OTHER_ELEMENTS:
            others[OTHER_ELEMENTS[code]] = len(rows)
            continue
        if code not in ELEMENTS:
            raise InputError(
                f"{path}: line {rows[0] + 2} is of an unknown element type '{printable(code)}'; "
                f"the types are {', '.join((*ELEMENTS, *OTHER_ELEMENTS))}"
            )
        kind, corners = ELEMENTS[code]
        table = _table(path, [lines[row].lstrip()[2:] for row in rows], (corners, corners + 1))
        numbers = _whole(path, table)
        tags = numbers[:, corners] if numbers.shape[1] > corners else None
        nodes = np.ascontiguousarray(numbers[:, :corners])
        _check_range(path, nodes, points)
        blocks[kind] = _Block(np.array(rows), nodes, tags)
    return blocks, others, len(lines)


def _read_directions(path: Path, count: int) -> dict[str, Floats]:
    """Fibres and sheets of all elements from a `.lon` file."""
    header, *lines = _lines(path, "fibres")
    if header.strip() not in ("1", "2"):
        raise InputError(
            f"{path}: the first line is '{_shown(header)}'; it must be the number of vectors in a "
            "line: 1 (fibre) or 2 (fibre and sheet)"
        )
    vectors = int(header)
    if len(lines) != count:
        raise InputError(
            f"{path}: {len(lines)} lines of fibres for {count} elements; give one a line for each "
            "element, or remove the file"
        )
    table = _table(path, lines, (3 * vectors,))
    names = ("fibre", "sheet")[:vectors]
    return {name: table[:, 3 * k : 3 * k + 3] for k, name in enumerate(names)}


def read_surf(path: Path, points: int) -> Integers:
    """Read the triangles of a `.surf` file, as indices of the mesh's points.

    Parameters
    ----------
    path : Path
        The file.
    points : int
        How many points the mesh has.

    Returns
    -------
    (k, 3) array
        Point indices.

    Raises
    ------
    InputError
        If the file is truncated or damaged, has other elements than triangles, or refers to points
        that are not there.
    """
    lines = _counted_lines(path, "surface")
    bad = next((row for row, line in enumerate(lines) if line.split()[:1] != ["Tr"]), None)
    if bad is not None:
        raise InputError(
            f"{path}: line {bad + 2} is '{_shown(lines[bad])}'; every line must be a triangle "
            "('Tr' and three indices)"
        )
    table = _table(path, [line.lstrip()[2:] for line in lines], (3, 4))  # a tag may follow
    triangles = _whole(path, table)[:, :3]
    _check_range(path, triangles, points)
    return np.ascontiguousarray(triangles)


def read_vtx(path: Path | str) -> tuple[Integers, str]:
    """Read the vertex numbers of a `.vtx` file, and its domain (``"intra"`` or ``"extra"``).

    Raises
    ------
    InputError
        If the file is missing, truncated or damaged, or names no domain.
    """
    path = Path(path)
    header, *lines = _lines(path, "vertices")
    domain = lines[0].strip() if lines else ""
    if domain not in DOMAINS:
        raise InputError(
            f"{path}: the second line is '{_shown(domain)}'; it must be 'intra' or 'extra'"
        )
    indices = _whole(path, _table(path, _checked_count(path, header, lines[1:]), (1,)))[:, 0]
    if indices.min() < 0:
        raise InputError(f"{path}: index {indices.min()} is negative; indices count from 0")
    return indices, domain


def read_lengths(path: Path) -> Floats:
    """Read a `.dat` file of one length (µm) an element, as mm."""
    lengths = _table(path, _lines(path, "lengths"), (1,))[:, 0] / MICROMETRES
    return np.asarray(lengths, dtype=float)


def _lines(path: Path, purpose: str) -> list[str]:
    check_file(path, (path.suffix.lower(),), purpose)
    try:
        text = path.read_bytes().decode("ascii")
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: not a text file; give openCARP's text files, not its binary ones"
        ) from None
    if not text.strip():
        raise InputError(f"{path}: the file is empty; export or copy it again")
    if not text.endswith("\n"):  # the last number may have lost digits
        raise damaged(path, "no line end at its end")
    return text.rstrip().split("\n")


def _counted_lines(path: Path, purpose: str) -> list[str]:
    header, *lines = _lines(path, purpose)
    return _checked_count(path, header, lines)


def _checked_count(path: Path, header: str, lines: list[str]) -> list[str]:
    """Lines, if they are as many as the header says."""
    try:
        count = int(header)
    except ValueError:
        found = f"the first line is '{_shown(header)}', not the number of lines that follow"
        raise damaged(path, found) from None
    if count != len(lines) or not lines:
        raise damaged(path, f"the first line announces {count}, but {len(lines)} follow")
    return lines


def _table(path: Path, lines: list[str], columns: tuple[int, ...]) -> Floats:
    empty = next((row for row, line in enumerate(lines) if not line.strip()), None)
    if empty is not None:
        raise damaged(path, f"entry {empty + 1} has no numbers")
    try:
        table = np.loadtxt(lines, ndmin=2, comments=None)
    except ValueError as error:
        raise damaged(path, _shown(str(error).split(";")[0])) from None
    if len(table) != len(lines) or table.shape[1] not in columns:
        wanted = " or ".join(map(str, columns))
        found = f"{len(table)} lines with {table.shape[1]} numbers"
        raise damaged(path, f"{found}; need {len(lines)} with {wanted}")
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size:
        raise InputError(
            f"{path}: {bad.size} of {len(table)} lines hold numbers that are not finite (first: "
            f"'{_shown(lines[bad[0]])}'); correct them"
        )
    return np.asarray(table, dtype=float)


def _whole(path: Path, table: Floats) -> Integers:
    # beyond 2^53 not every whole number is a float, and no index is so large
    bad = np.argwhere((table != np.round(table)) | (np.abs(table) > 2.0**53))
    if len(bad):
        raise InputError(
            f"{path}: {table[tuple(bad[0])]:g} stands where a whole number should; correct it"
        )
    return table.astype(np.int64)


def _check_range(path: Path, nodes: Integers, points: int) -> None:
    bad = nodes[(nodes < 0) | (nodes >= points)]
    if bad.size:
        raise InputError(
            f"{path}: {bad.size} indices are out of range (first: {bad[0]}); the mesh has points 0 "
            f"to {points - 1}"
        )


def _shown(text: str) -> str:
    """Start of a line, fit for a message of one line."""
    return printable(" ".join(text.split())[:60])


COORDINATE, DIRECTION = "%.6f", "%.15f"  # 1e-6 µm


def write_vtx(path: Path, indices: Integers, domain: Literal["intra", "extra"] = "intra") -> None:
    """Write vertex numbers as a `.vtx` file, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    indices : (k,) array
        Point indices.
    domain : {"intra", "extra"}
        Which of openCARP's domains they belong to.
    """
    write_text(path, f"{len(indices)}\n{domain}\n" + rows("%d", indices))


def write_opencarp_mesh(
    stem: Path, points: Floats, code: str, cells: Integers, tags: Integers
) -> None:
    """Write ``<stem>.pts`` and ``<stem>.elem``, each whole or not at all.

    Parameters
    ----------
    stem : Path
        Folder and name of the files, without a suffix.
    points : (n, 3) array
        Positions (mm).
    code : str
        openCARP's name of the cells, such as ``"Tt"`` for tetrahedra.
    cells : (m, k) array
        Point indices.
    tags : (m,) array
        The region of each cell.
    """
    positions = rows(" ".join([COORDINATE] * 3), points * MICROMETRES)
    write_text(opencarp_file(stem, ".pts"), f"{len(points)}\n{positions}")
    text = rows(" ".join([code, *["%d"] * (cells.shape[1] + 1)]), np.column_stack([cells, tags]))
    write_text(opencarp_file(stem, ".elem"), f"{len(cells)}\n{text}")


def write_directions(path: Path, axes: list[Floats]) -> None:
    """Write one or more unit vectors (m, 3) a cell as a `.lon` file, whole or not at all."""
    text = rows(" ".join([DIRECTION] * (3 * len(axes))), np.hstack(axes))
    write_text(path, f"{len(axes)}\n{text}")


def rows(form: str, values: Floats | Integers) -> str:
    """Text with one line for each row of `values`, in this printf format."""
    text = io.StringIO()
    np.savetxt(text, values, fmt=form)
    return text.getvalue()
