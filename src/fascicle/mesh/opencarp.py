"""The text files of openCARP: `.pts`, `.elem`, `.lon`, `.surf` and `.vtx`.

The formats are those of the openCARP user manual (Plank et al., Comput. Methods Programs Biomed.
208, 106223, 2021): every file but `.lon` starts with the number of lines that follow, which may be
missing, indices count from 0, and lengths are in µm.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError, printable
from fascicle.core.files import check_file, write_text
from fascicle.mesh.mesh_file import LINE, OPENCARP_FORMATS, TETRAHEDRON, TRIANGLE, MeshFile, damaged

# Names of elements: VTK's number of those that are used here and how many nodes they have, or what
# the others are
OPENCARP_ELEMENTS: dict[str, tuple[int, int] | str] = {
    "Ln": (LINE, 2), "Tr": (TRIANGLE, 3), "Tt": (TETRAHEDRON, 4),
    "Cx": "connections", "Qd": "quadrangles", "Py": "pyramids", "Pr": "prisms", "Hx": "hexahedra",
    "Oc": "octahedra",
}  # fmt: skip


def opencarp_file(path: Path | str, suffix: str) -> Path:
    """Path of one file of a mesh, given its stem or any of its files."""
    path = Path(path)
    if path.suffix.lower() in (*OPENCARP_FORMATS, ".lon"):
        path = path.with_suffix("")
    return path.with_name(path.name + suffix)


def read_opencarp_mesh(path: Path | str, purpose: str = "mesh") -> MeshFile:
    """Read `.pts` and `.elem`, and `.lon` where there is one, given any of them or their stem.

    Coordinates are in µm and become mm; those that span less than 3000 are taken to be in mm
    already: 3 mm is less than any ventricle or Purkinje network, 3000 mm more than any torso.
    Cell arrays are ``region`` (the tags), ``fibre`` and ``sheet``, as far as the files have them.
    """
    file = opencarp_file(path, ".pts")
    points = _table(file, _counted_lines(file, purpose), (3,))
    if float(np.ptp(points, axis=0).max()) >= 3000.0:
        points = points / 1000
    elements = opencarp_file(path, ".elem")
    lines = _counted_lines(elements, purpose)
    by_type: dict[str, list[int]] = {}
    for row, line in enumerate(lines):
        by_type.setdefault(line.lstrip()[:2], []).append(row)
    cells, cell_data, other_cells = {}, dict[int, dict[str, Floats]](), {}
    for code, rows_of_type in by_type.items():
        if (element := OPENCARP_ELEMENTS.get(code)) is None:
            raise InputError(
                f"{elements}: element {rows_of_type[0]} is of an unknown type "
                f"'{printable(code)}'; the types are {', '.join(OPENCARP_ELEMENTS)}"
            )
        if isinstance(element, str):
            other_cells[element] = len(rows_of_type)
            continue
        kind, corners = element
        text = [lines[row].lstrip()[2:] for row in rows_of_type]
        numbers = _indices(elements, text, corners, len(points))
        cells[kind] = np.ascontiguousarray(numbers[:, :corners])
        tags = numbers[:, corners:].astype(float)
        cell_data[kind] = {"region": tags[:, 0]} if tags.size else {}
    if opencarp_file(path, ".lon").exists():
        directions = _read_directions(opencarp_file(path, ".lon"), len(lines))
        for code, rows in by_type.items():
            if not isinstance(element := OPENCARP_ELEMENTS[code], str):
                cell_data[element[0]] |= {name: v[rows] for name, v in directions.items()}
    return MeshFile(elements, points, cells, {}, cell_data, other_cells)


def _read_directions(path: Path, count: int) -> dict[str, Floats]:
    """Fibres and sheets of all elements from a `.lon` file."""
    lines = _lines(path, "fibres")
    # a file without the number of vectors has the vectors themselves in the first line
    header = {3: "1", 6: "2"}.get(len(lines[0].split())) or lines.pop(0)
    if header.strip() not in ("1", "2"):
        raise InputError(
            f"{path}: the first line is '{_start(header)}'; it must be the number of vectors in a "
            "line: 1 (fibre) or 2 (fibre and sheet)"
        )
    if len(lines) != count:
        raise InputError(
            f"{path}: {len(lines)} lines of fibres for {count} elements; give one a line for each "
            "element, or remove the file"
        )
    names = ("fibre", "sheet")[: int(header)]
    table = _table(path, lines, (3 * len(names),))
    return {name: table[:, 3 * k : 3 * k + 3] for k, name in enumerate(names)}


def read_surf(path: Path, points: int) -> Integers:
    """Read the triangles (k, 3) of a `.surf` file, for a mesh with this number of points."""
    lines = _counted_lines(path, "surface")
    bad = next((row for row, line in enumerate(lines) if line.split()[:1] != ["Tr"]), None)
    if bad is not None:
        raise InputError(
            f"{path}: triangle {bad} is '{_start(lines[bad])}'; every line must be a triangle "
            "('Tr' and three indices)"
        )
    triangles = _indices(path, [line.lstrip()[2:] for line in lines], 3, points)
    return np.ascontiguousarray(triangles[:, :3])


def read_vtx(path: Path, points: int) -> Integers:
    """Read the vertex numbers (k,) of a `.vtx` file, for a mesh with this number of points."""
    text = _counted_lines(path, "vertices", has_domain=True)
    return _indices(path, text, 1, points, tagged=False)[:, 0]


def read_lengths(path: Path) -> Floats:
    """Read a `.dat` file of one length (µm) an element, as mm."""
    return np.asarray(_table(path, _lines(path, "lengths"), (1,))[:, 0] / 1000)


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
    return text.rstrip().split("\n")


def _counted_lines(path: Path, purpose: str, has_domain: bool = False) -> list[str]:
    """Lines after the count and perhaps a domain, if they are as many as the count says.

    Where the first line holds other than one number, the file has no count.
    """
    lines, domains = _lines(path, purpose), ("intra", "extra")
    counted = len(lines[0].split()) == 1 and lines[0].strip() not in domains
    count = lines.pop(0).strip() if counted else ""
    if has_domain and (domain := lines.pop(0).strip() if lines else "") not in domains:
        raise InputError(
            f"{path}: the second line is '{_start(domain)}'; it must be 'intra' or 'extra'"
        )
    if not lines or (counted and count != str(len(lines))):
        raise damaged(path, f"the first line is '{_start(count)}', and {len(lines)} lines follow")
    return lines


def _table(path: Path, lines: list[str], columns: tuple[int, ...]) -> Floats:
    if not all(line.strip() for line in lines):
        raise damaged(path, "a line without numbers")
    try:
        table = np.loadtxt(lines, ndmin=2, comments=None)
    except ValueError as error:
        raise damaged(path, _start(str(error).split(";")[0])) from None
    if len(table) != len(lines) or table.shape[1] not in columns:
        needed = " or ".join(map(str, columns))
        actual = f"{len(table)} lines with {table.shape[1]} numbers"
        raise damaged(path, f"{actual}; need {len(lines)} with {needed}")
    if (bad := np.flatnonzero(~np.isfinite(table).all(axis=1))).size:
        raise InputError(
            f"{path}: {bad.size} of {len(table)} lines hold numbers that are not finite (first: "
            f"'{_start(lines[bad[0]])}'); correct them"
        )
    return np.asarray(table, dtype=float)


def _indices(
    path: Path, lines: list[str], corners: int, points: int, tagged: bool = True
) -> Integers:
    """Point indices, `corners` a line, and a tag where there is one."""
    table = _table(path, lines, (corners, corners + 1) if tagged else (corners,))
    # beyond 2^53 not every whole number is a float, and no index is so large
    if len(bad := np.argwhere((table != np.round(table)) | (np.abs(table) > 2.0**53))):
        raise InputError(f"{path}: {table[tuple(bad[0])]:g} is not a whole number; correct it")
    numbers = table.astype(np.int64)
    nodes = numbers[:, :corners]
    if (outside := nodes[(nodes < 0) | (nodes >= points)]).size:
        raise InputError(
            f"{path}: {outside.size} indices are out of range (first: {outside[0]}); the mesh has "
            f"points 0 to {points - 1}"
        )
    return numbers


def _start(text: str) -> str:
    """Start of a line, fit for a message of one line."""
    return printable(" ".join(text.split())[:60])


def write_vtx(path: Path, indices: Integers) -> None:
    """Write point indices (k,) of the intracellular domain as a `.vtx` file."""
    write_text(path, f"{len(indices)}\nintra\n" + _rows("%d", indices))


def write_surf(path: Path, triangles: Integers) -> None:
    """Write triangles (k, 3) of a mesh as a `.surf` file."""
    write_text(path, f"{len(triangles)}\n" + _rows("Tr %d %d %d", triangles))


def write_opencarp_mesh(
    stem: Path, points: Floats, code: str, cells: Integers, tags: Integers | None = None
) -> None:
    """Write ``<stem>.pts`` and ``<stem>.elem``: points (n, 3) in mm, and cells (m, k) with tags.

    The code is openCARP's name of the cells, such as ``"Tt"`` for tetrahedra; default tags are 1.
    """
    tags = tags if tags is not None else np.ones(len(cells), dtype=np.int64)
    positions = _rows("%.6f %.6f %.6f", points * 1000)
    write_text(opencarp_file(stem, ".pts"), f"{len(points)}\n{positions}")
    text = _rows(" ".join([code, *["%d"] * (cells.shape[1] + 1)]), np.column_stack([cells, tags]))
    write_text(opencarp_file(stem, ".elem"), f"{len(cells)}\n{text}")


def write_directions(path: Path, axes: list[Floats]) -> None:
    """Write one or more unit vectors (m, 3) a cell as a `.lon` file."""
    text = _rows(" ".join(["%.15f"] * (3 * len(axes))), np.hstack(axes))
    write_text(path, f"{len(axes)}\n{text}")


def write_values(path: Path, values: Floats) -> None:
    """Write one number (n,) a node or a cell as a `.dat` file, in openCARP's units."""
    write_text(path, _rows("%.6f", values))


def _rows(form: str, values: Floats | Integers) -> str:
    """Text with one line for each row of `values`, in this printf format."""
    text = io.StringIO()
    np.savetxt(text, values, fmt=form)
    return text.getvalue()
