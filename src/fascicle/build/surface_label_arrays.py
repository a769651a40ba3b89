"""Finding, in the files of a tetrahedral mesh, a label for each triangle of its boundary."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.heart.label_names import (
    Names,
    array_of_labels,
    label_of,
    labels_of,
    no_such_array,
    whole_numbers,
)
from fascicle.heart.labelled_surface import BASAL, NEEDED, Label
from fascicle.mesh.formats.mesh_file import GROUP, OPENCARP_FORMATS, TRIANGLE, MeshFile
from fascicle.mesh.formats.opencarp import opencarp_file, read_surf, read_vtx

UNLABELLED = 0
# Which label a triangle gets that has as many corners of one as of another
PRECEDENCE = (
    Label.LV_ENDOCARDIUM,
    Label.RV_ENDOCARDIUM,
    Label.EPICARDIUM,
    *sorted(set(Label) - set(NEEDED)),
    Label.BASE,
)


class _Labelled(NamedTuple):
    """Triangles with a label each, and where they stand."""

    source: str
    triangles: NDArray[np.int64]
    labels: NDArray[np.int64]


def label_boundary(
    mesh: MeshFile, boundary: NDArray[np.int64], array: str | None, names: Names
) -> NDArray[np.int64] | None:
    """Label each boundary triangle by what the mesh's file, or files beside it, say.

    Parameters
    ----------
    mesh : MeshFile
        What was read.
    boundary : (b, 3) array
        The boundary of its tetrahedra, as indices of its points.
    array : str, optional
        Name of the array of labels, if it is none of
        `fascicle.heart.label_names.LABEL_NAMES`.
    names : mapping of str to Label
        The caller's own names and numbers of labels.

    Returns
    -------
    (b,) array or None
        A `Label` each; None if nothing is labelled.

    Raises
    ------
    InputError
        If labels are missing, unknown or contradictory, or not on the boundary.
    """
    labelled = _labelled_triangles(mesh, array, names)
    if labelled is not None:
        labels = _on_boundary(labelled, boundary)
        source = labelled.source
    else:
        found = _point_votes(mesh, boundary, array, names)
        if found is None:
            return None
        source, votes = found
        labels = _elected(votes[boundary].sum(axis=1))
    _check_all_there(source, labels)
    return labels


def _labelled_triangles(mesh: MeshFile, array: str | None, names: Names) -> _Labelled | None:
    if mesh.path.suffix.lower() in OPENCARP_FORMATS and array is None:
        return _surf_files(mesh, names)
    arrays = mesh.cell_data.get(TRIANGLE, {})
    name = array_of_labels(arrays, array)
    if name is None:
        if array is not None and array not in mesh.point_data:
            raise no_such_array(mesh.path, array, {*arrays, *mesh.point_data})
        return None
    source = f"{mesh.path}: array '{name}'"
    numbers = whole_numbers(source, arrays[name])
    is_group = name == GROUP
    given = numbers != UNLABELLED if is_group else np.ones(len(numbers), dtype=bool)
    if not given.any():
        return None
    labels = labels_of(source, numbers[given], names, surface_groups(mesh) if is_group else {})
    return _Labelled(source, mesh.cells[TRIANGLE][given], labels)


def surface_groups(mesh: MeshFile) -> dict[int, str]:
    """Names of the physical groups of triangles by their number."""
    return {number: name for name, (dimension, number) in mesh.groups.items() if dimension == 2}


def _files_beside(mesh: MeshFile, suffix: str, names: Names) -> list[tuple[Path, Label]]:
    """Files of this kind whose name, without that of the mesh, means a label."""
    stem = opencarp_file(mesh.path, "").name
    found = []
    for path in sorted(mesh.path.parent.glob(f"*{suffix}")):
        name = path.name.removesuffix(suffix).removesuffix(".surf").removeprefix(stem).strip("._- ")
        label = names.get(name, label_of(name))
        if label is not None:
            found.append((path, label))
    return found


def _surf_files(mesh: MeshFile, names: Names) -> _Labelled | None:
    files = _files_beside(mesh, ".surf", names)
    if not files:
        return None
    parts = [read_surf(path, len(mesh.points)) for path, _ in files]
    labels = np.repeat([label for _, label in files], [len(part) for part in parts])
    source = ", ".join(path.name for path, _ in files)
    return _Labelled(f"{mesh.path} ({source})", np.concatenate(parts), labels.astype(np.int64))


def _point_votes(
    mesh: MeshFile, boundary: NDArray[np.int64], array: str | None, names: Names
) -> tuple[str, NDArray[np.bool_]] | None:
    """Source of the labels of points, and which labels each has, shape (points, labels)."""
    votes = np.zeros((len(mesh.points), max(Label) + 1), dtype=bool)
    on_boundary = np.unique(boundary)
    if mesh.path.suffix.lower() in OPENCARP_FORMATS:
        files = _files_beside(mesh, ".vtx", names)
        if not files:
            return None
        for path, label in files:
            indices, _ = read_vtx(path)
            if indices.max() >= len(mesh.points):
                raise InputError(
                    f"{path}: index {indices.max()} is out of range; the mesh has points 0 to "
                    f"{len(mesh.points) - 1}"
                )
            votes[indices, label] = True
        source = f"{mesh.path} ({', '.join(path.name for path, _ in files)})"
    else:
        name = array_of_labels(mesh.point_data, array)
        if name is None:
            return None
        source = f"{mesh.path}: array '{name}'"
        numbers = whole_numbers(source, np.asarray(mesh.point_data[name])[on_boundary])
        votes[on_boundary, labels_of(source, numbers, names, {})] = True
    without = on_boundary[~votes[on_boundary].any(axis=1)]
    if without.size:
        raise InputError(
            f"{source}: {without.size} of {on_boundary.size} boundary points have no label (first: "
            f"{without[0]}); label every one"
        )
    return source, votes


def _elected(votes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Label with the most votes of a triangle's corners, shape (b,)."""
    order = np.array(PRECEDENCE, dtype=np.int64)
    # argmax takes the first of those with as many
    return np.asarray(order[np.argmax(votes[:, order], axis=1)])


def _on_boundary(labelled: _Labelled, boundary: NDArray[np.int64]) -> NDArray[np.int64]:
    """Label of each boundary triangle; `UNLABELLED` where none was given."""
    source, triangles, given = labelled
    rows = np.sort(np.concatenate([boundary, triangles]), axis=1)
    _, number = np.unique(rows, axis=0, return_inverse=True)
    number = number.ravel()
    place = np.full(number.max() + 1, -1)
    place[number[: len(boundary)]] = np.arange(len(boundary))
    at = place[number[len(boundary) :]]
    stray = np.flatnonzero(at < 0)
    if stray.size:
        raise InputError(
            f"{source}: {stray.size} of {len(triangles)} labelled triangles are not on the "
            f"boundary of the tetrahedra (first: points {_listed(triangles[stray[0]])}); label "
            "faces of the mesh itself"
        )
    labels = np.full(len(boundary), UNLABELLED)
    labels[at] = given
    twice = np.flatnonzero(labels[at] != given)
    if twice.size:
        raise InputError(
            f"{source}: {twice.size} triangles have two labels (first: points "
            f"{_listed(triangles[twice[0]])}); keep one"
        )
    return labels


def _listed(indices: NDArray[np.int64]) -> str:
    return " ".join(map(str, indices))


def _check_all_there(source: str, labels: NDArray[np.int64]) -> None:
    without = int((labels == UNLABELLED).sum())
    rest = f"{without} of {len(labels)} boundary triangles have no label" if without else ""
    missing = [
        label.name.lower().replace("_", " ")
        for label in NEEDED
        if not np.isin(labels, BASAL if label == Label.BASE else label).any()
    ]
    if missing:
        found = f" ({rest})" if rest else ""
        raise InputError(f"{source}: labels missing: {', '.join(missing)}{found}; add them")
    if without:
        raise InputError(
            f"{source}: {rest} (first: {np.flatnonzero(labels == UNLABELLED)[0]}); label every one"
        )
