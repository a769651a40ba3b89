"""Reading a closed surface whose triangles or points have labels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fascicle.build.label_borders import labels_from_points
from fascicle.build.surface_label_arrays import surface_groups
from fascicle.core.errors import InputError
from fascicle.core.files import check_file
from fascicle.heart.label_names import (
    LABEL_NAMES,
    array_of_labels,
    labels_by_number,
    labels_of,
    no_such_array,
    whole_numbers,
)
from fascicle.heart.labelled_surface import LabelledSurface
from fascicle.heart.validate import check_units
from fascicle.mesh.formats.mesh_file import GROUP, TRIANGLE, MeshFile
from fascicle.mesh.formats.read import read_mesh

TEXT_FORMATS = (".txt", ".csv", ".dat")
WELD = 1e-6  # of the largest extent; points of an STL file closer than this are one


def has_labels(mesh: MeshFile, array: str | None = None, labels_file: Path | None = None) -> bool:
    """Whether there are labels: a file of them, a named array, or one of `LABEL_NAMES`."""
    return labels_file is not None or array is not None or _found(mesh, None) is not None


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
        As it stands in the file; `fascicle.build.repair.prepared_surface` checks and repairs it.
        Labels of points are brought to triangles by
        `fascicle.build.label_borders.labels_from_points`.

    Raises
    ------
    InputError
        If it cannot be read, is not in mm, or has no labels, or unknown ones.
    """
    return labelled_surface(read_mesh(path, "labelled surface"), array, names, labels_file)


def labelled_surface(
    mesh: MeshFile,
    array: str | None = None,
    names: Mapping[str, int] | None = None,
    labels_file: Path | str | None = None,
) -> LabelledSurface:
    """The labelled surface of a file that was read already; see `read_labelled_surface`."""
    check_units(str(mesh.path), mesh.points)
    triangles = mesh.require(TRIANGLE, "triangles")
    groups: dict[int, str] = {}
    if labels_file is not None:
        source, values = str(labels_file), _read_numbers(Path(labels_file))
        on_triangles = _is_of_triangles(mesh, values, source)
    else:
        source, values, on_triangles, groups = _array(mesh, array)
    own = {} if names is None else labels_by_number(names)
    labels = labels_of(source, values, own, groups)
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


def _found(mesh: MeshFile, array: str | None) -> tuple[str, bool] | None:
    """Name of the array of labels, and whether it is of triangles; those come first."""
    of_triangles = mesh.cell_data.get(TRIANGLE, {})
    name = array_of_labels(of_triangles, array)
    if array is None and name == GROUP and len(np.unique(of_triangles[GROUP])) == 1:
        name = None  # the whole surface is one physical group, or none, and tells nothing
    if name is not None:
        return name, True
    name = array_of_labels(mesh.point_data, array)
    return None if name is None else (name, False)


def _array(
    mesh: MeshFile, array: str | None
) -> tuple[str, NDArray[np.int64], bool, dict[int, str]]:
    """Where the labels stand, the labels, whether they are of triangles, and names of groups."""
    of_triangles = mesh.cell_data.get(TRIANGLE, {})
    found = _found(mesh, array)
    if found is None:
        there = {*mesh.point_data, *of_triangles}
        if array is not None:
            raise no_such_array(mesh.path, array, there)
        raise InputError(
            f"{mesh.path}: no labels: no array called {', '.join(LABEL_NAMES[:-1])} on triangles "
            f"or points (arrays: {', '.join(sorted(there)) or 'none'}); name the array "
            "(--label-array) or give a file of labels (--labels-file)"
        )
    name, on_triangles = found
    source = f"{mesh.path}: array '{name}'"
    values = whole_numbers(source, (of_triangles if on_triangles else mesh.point_data)[name])
    groups = surface_groups(mesh) if name == GROUP else {}
    return source, values, on_triangles, groups


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


def _is_of_triangles(mesh: MeshFile, values: NDArray[np.int64], source: str) -> bool:
    triangles, points = len(mesh.cells[TRIANGLE]), len(mesh.points)
    welded = len(np.unique(_welded(mesh.points, mesh.cells[TRIANGLE])[2]))
    if len(values) not in (triangles, points):
        raise InputError(
            f"{source}: {len(values)} labels, but {mesh.path} has {triangles} triangles and "
            f"{points} points ({welded} different); give one a triangle or point"
        )
    return len(values) == triangles
