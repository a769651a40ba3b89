"""Reading a closed surface whose triangles or points have labels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fascicle.build.file_labels import find_label_array
from fascicle.build.label_cleaning import labels_from_points
from fascicle.build.surface_repair import MERGED
from fascicle.core.arrays import Integers
from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.heart.label_names import LABEL_NAMES, labels_by_number, labels_of, whole_numbers
from fascicle.heart.labelled_surface import LabelledSurface
from fascicle.heart.validate import check_units
from fascicle.mesh.formats.mesh_file import TRIANGLE, MeshFile
from fascicle.mesh.topology import merged_vertices

TEXT_FORMATS = (".txt", ".csv", ".dat")


def has_labels(mesh: MeshFile, array: str | None = None, labels_file: Path | None = None) -> bool:
    """Whether there are labels: a file of them, a named array, or one of `LABEL_NAMES`.

    Parameters
    ----------
    mesh : MeshFile
        A file of triangles.
    array : str, optional
        Name of an array.
    labels_file : Path, optional
        A file of labels.
    """
    if labels_file is not None or array is not None:
        return True
    found = find_label_array(mesh, None)
    # a surface that is all one physical group, or none, has no labels
    return found is not None and (found.groups is None or len(np.unique(found.values)) > 1)


def labelled_surface(
    mesh: MeshFile,
    array: str | None = None,
    names: Mapping[str, int] | None = None,
    labels_file: Path | str | None = None,
) -> LabelledSurface:
    """The surface of a file with the labels of its triangles.

    Parameters
    ----------
    mesh : MeshFile
        A file of triangles, in mm.
    array : str, optional
        Name of the array of labels, one a triangle or one a point, if it is none of
        `fascicle.heart.label_names.LABEL_NAMES`.
    names : mapping of str to int, optional
        Which number in the file stands for which label, as ``{"lv": 3}``; names are what
        `fascicle.heart.label_names.label_of` understands. Those not named have `Label`'s number.
    labels_file : Path, optional
        A text file with one whole number a triangle or point, in the order of the surface file,
        instead of an array in it; STL files hold none.

    Returns
    -------
    LabelledSurface
        As it stands in the file, with repeated points merged. Labels of points are brought to
        triangles by `fascicle.build.label_cleaning.labels_from_points`.

    Raises
    ------
    InputError
        If it is not in mm, or has no labels, or unknown ones.
    """
    check_units(str(mesh.path), mesh.points)
    triangles = mesh.require(TRIANGLE, "triangles")
    groups: Mapping[int, str] = {}
    if labels_file is not None:
        source, values = str(labels_file), _read_numbers(Path(labels_file))
        of_triangles = _is_of_triangles(mesh, values, source)
    else:
        found = find_label_array(mesh, array)
        if found is None:
            there = sorted({*mesh.point_data, *mesh.cell_data.get(TRIANGLE, {})})
            raise InputError(
                f"{mesh.path}: no labels: no array called {', '.join(LABEL_NAMES[:-1])} on "
                f"triangles or points (arrays: {', '.join(there) or 'none'}); name the array "
                "(--label-array) or give a file of labels (--labels-file)"
            )
        source, of_triangles, groups = found.source, found.of_triangles, found.groups or {}
        values = whole_numbers(source, found.values)
    labels = labels_of(source, values, {} if names is None else labels_by_number(names), groups)
    extent = float(np.ptp(mesh.points, axis=0).max())
    used, number = np.unique(merged_vertices(mesh.points, MERGED * extent), return_inverse=True)
    vertices, triangles = mesh.points[used], number[triangles]
    if not of_triangles:
        at_vertices = np.empty(len(vertices), dtype=np.int64)
        at_vertices[number] = labels
        labels = labels_from_points(vertices, triangles, at_vertices)
    return LabelledSurface(vertices, triangles, labels, str(mesh.path))


def _read_numbers(path: Path) -> Integers:
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


def _is_of_triangles(mesh: MeshFile, values: Integers, source: str) -> bool:
    triangles, points = len(mesh.cells[TRIANGLE]), len(mesh.points)
    if len(values) not in (triangles, points):
        raise InputError(
            f"{source}: {len(values)} labels, but {mesh.path} has {triangles} triangles and "
            f"{points} points; give one a triangle or point"
        )
    return len(values) == triangles
