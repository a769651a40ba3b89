"""Reading a closed surface whose triangles or points have labels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fascicle.anatomy.borders import labels_from_points
from fascicle.errors import InputError
from fascicle.geometry.surface import Label, LabelledSurface
from fascicle.geometry.validate import check_units
from fascicle.io.meshes import TRIANGLE, Mesh, check_file, read_mesh

DEFAULT_ARRAY = "class"
TEXT_FORMATS = (".txt", ".csv", ".dat")
WELD = 1e-6  # of the largest extent; points of an STL file closer than this are one
# Shorter names of labels
ALIASES = {
    "lv": Label.LV_ENDOCARDIUM,
    "rv": Label.RV_ENDOCARDIUM,
    "epi": Label.EPICARDIUM,
    **{label.name.lower(): label for label in Label},
}
MAPPING_EXAMPLE = "base=1 epicardium=2 lv=3 rv=4"


def has_labels(mesh: Mesh, array: str | None = None, labels_file: Path | None = None) -> bool:
    """Whether there are labels: a file of them, a named array, or one that can be labels."""
    return labels_file is not None or array is not None or bool(_candidates(mesh))


def read_labelled_surface(
    path: Path | str,
    array: str | None = None,
    names: Mapping[str, int] | None = None,
    labels_file: Path | str | None = None,
) -> LabelledSurface:
    """Read a surface and the labels of its triangles.

    Parameters
    ----------
    path : Path
        A VTP, VTU, VTK, STL, OBJ, PLY or Gmsh file of triangles, in mm.
    array : str, optional
        Name of the array of labels, one a triangle or one a point. If it is not given: ``class``,
        or else the only one with whole numbers.
    names : mapping of str to int, optional
        Which number in the file stands for which label, as ``{"lv": 3}``; names are those of
        `Label` in small letters, ``lv``, ``rv`` and ``epi``. Those not named have `Label`'s number.
    labels_file : Path, optional
        A text file with one whole number a triangle or point, in the order of the surface file,
        instead of an array in it; STL files hold none.

    Returns
    -------
    LabelledSurface
        As it stands in the file; `fascicle.anatomy.closed.prepared_surface` checks and repairs it.
        Labels of points are brought to triangles by
        `fascicle.anatomy.borders.labels_from_points`.

    Raises
    ------
    InputError
        If it cannot be read, is not in mm, or has no labels, or unknown ones.
    """
    mesh = read_mesh(path, "labelled surface")
    check_units(str(mesh.path), mesh.points)
    triangles = mesh.require(TRIANGLE, "triangles")
    if labels_file is not None:
        source, values = str(labels_file), _read_numbers(Path(labels_file))
        on_triangles = _is_of_triangles(mesh, values, source)
    else:
        source, values, on_triangles = _array(mesh, array)
    if len(values) != (len(triangles) if on_triangles else len(mesh.points)):
        raise InputError(f"{source}: {len(values)} labels for {len(triangles)} triangles")
    labels = _translated(values, names, source)
    vertices, welded, kept = _welded(mesh.points, triangles)
    if not on_triangles:
        at_vertices = np.empty(len(vertices), dtype=np.int64)
        at_vertices[kept] = labels
        labels = labels_from_points(vertices, welded, at_vertices)
    return LabelledSurface(vertices, welded, labels, str(mesh.path))


def _welded(
    points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Points without repetitions, triangles of them, and the new number of each point."""
    extent = float(np.ptp(points, axis=0).max())
    pairs = cKDTree(points).query_pairs(WELD * extent, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    return points[first], group.astype(np.int64)[triangles], group.astype(np.int64)


def _whole(values: NDArray[np.float64]) -> bool:
    """Whether an array is one column of whole numbers."""
    numbers = np.asarray(values)
    if numbers.ndim != 1 or not np.issubdtype(numbers.dtype, np.number):
        return False
    return bool(np.isfinite(numbers).all() and (numbers == np.round(numbers)).all())


def _candidates(mesh: Mesh) -> list[tuple[str, NDArray[np.float64], bool]]:
    """Arrays of whole numbers: name, values, and whether they are of triangles."""
    of_triangles = mesh.cell_data.get(TRIANGLE, {})
    found = [(name, values, True) for name, values in of_triangles.items() if _whole(values)]
    found += [(name, values, False) for name, values in mesh.point_data.items() if _whole(values)]
    named = [candidate for candidate in found if candidate[0] == DEFAULT_ARRAY]
    return named[:1] or found


def _array(mesh: Mesh, array: str | None) -> tuple[str, NDArray[np.int64], bool]:
    """Where the labels stand, the labels, and whether they are of triangles."""
    there = {**mesh.point_data, **mesh.cell_data.get(TRIANGLE, {})}
    listed = ", ".join(sorted(there)) or "none"
    if array is not None:
        if array not in there:
            raise InputError(
                f"{mesh.path}: no array '{array}' on triangles or points; there are: {listed}"
            )
        values, on_triangles = there[array], array in mesh.cell_data.get(TRIANGLE, {})
        if not _whole(values):
            raise InputError(
                f"{mesh.path}: array '{array}' must hold one whole number each, the label; "
                f"there are: {listed}"
            )
        return f"{mesh.path}: array '{array}'", values.astype(np.int64), on_triangles
    candidates = _candidates(mesh)
    if not candidates:
        raise InputError(
            f"{mesh.path}: no labels: no array of whole numbers on triangles or points (arrays: "
            f"{listed}); give a file of labels, one a triangle, or name the array"
        )
    if len(candidates) > 1:
        raise InputError(
            f"{mesh.path}: which array holds the labels? Of whole numbers are "
            f"{', '.join(name for name, _, _ in candidates)}; name one"
        )
    name, values, on_triangles = candidates[0]
    return f"{mesh.path}: array '{name}'", values.astype(np.int64), on_triangles


def _read_numbers(path: Path) -> NDArray[np.int64]:
    """Whole numbers of a text file, one a line or separated by commas or blanks."""
    check_file(path, TEXT_FORMATS, "labels")
    try:
        words = path.read_text(encoding="utf-8").replace(",", " ").split()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a text file") from None
    for place, word in enumerate(words):
        if not word.lstrip("+-").isdecimal():
            raise InputError(
                f"{path}: entry {place + 1} is '{word[:20]}'; give one whole number a triangle or "
                "point, and no heading"
            )
    return np.array(words, dtype=np.int64)


def _is_of_triangles(mesh: Mesh, values: NDArray[np.int64], source: str) -> bool:
    triangles, points = len(mesh.cells[TRIANGLE]), len(mesh.points)
    welded = len(np.unique(_welded(mesh.points, mesh.cells[TRIANGLE])[2]))
    if len(values) not in (triangles, points):
        raise InputError(
            f"{source}: {len(values)} labels, but {mesh.path} has {triangles} triangles and "
            f"{points} points ({welded} different); give one a triangle or point"
        )
    return len(values) == triangles


def _translated(
    values: NDArray[np.int64], names: Mapping[str, int] | None, source: str
) -> NDArray[np.int64]:
    """The `Label` that each number stands for."""
    label_of = _numbering(names)
    known = np.array(sorted(label_of), dtype=np.int64)
    strange, count = np.unique(values[~np.isin(values, known)], return_counts=True)
    if strange.size:
        listed = ", ".join(f"{v} ({n} times)" for v, n in zip(strange, count, strict=True))
        meant = ", ".join(f"{n} {Label(label_of[n]).name.lower()}" for n in sorted(label_of))
        raise InputError(
            f"{source}: unknown labels: {listed}; known are {meant}; say which number is what, as "
            f"{MAPPING_EXAMPLE}"
        )
    labels = np.array([label_of[number] for number in known.tolist()], dtype=np.int64)
    return np.asarray(labels[np.searchsorted(known, values)])


def _numbering(names: Mapping[str, int] | None) -> dict[int, Label]:
    """The label of each number: the caller's, and `Label`'s own where they leave it free."""
    given: dict[int, Label] = {}
    for name, number in (names or {}).items():
        label = ALIASES.get(name.lower())
        if label is None:
            raise InputError(f"label '{name}': unknown; names are {', '.join(ALIASES)}")
        if given.get(number, label) != label:
            raise InputError(f"label number {number} is given two meanings; give each number one")
        given[number] = label
    own = {int(label): label for label in Label if label not in given.values()}
    return {**own, **given}
