"""Labels of triangles in the files of a mesh, and beside them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.label_names import LABEL_NAMES, Names, label_of, labels_of, whole_numbers
from fascicle.heart.labelled_surface import NEEDED, Label, missing_parts
from fascicle.mesh.formats.mesh_file import GROUP, OPENCARP_FORMATS, TRIANGLE, MeshFile
from fascicle.mesh.formats.opencarp import opencarp_file, read_surf, read_vtx
from fascicle.mesh.topology import places_in

UNLABELLED = 0
# Which label a triangle gets that has as many corners of one as of another
PRECEDENCE = (
    Label.LV_ENDOCARDIUM,
    Label.RV_ENDOCARDIUM,
    Label.EPICARDIUM,
    *sorted(set(Label) - set(NEEDED)),
    Label.BASE,
)


class LabelArray(NamedTuple):
    """An array of labels in a file: where, its values (k,), and what they belong to.

    `groups` are the names of Gmsh's physical groups by number, None where these are no groups.
    """

    source: str
    values: Floats
    of_triangles: bool
    groups: Mapping[int, str] | None


def find_label_array(mesh: MeshFile, array: str | None) -> LabelArray | None:
    """Find the array called so, or else one of `LABEL_NAMES`; triangles come before points.

    Raises
    ------
    InputError
        If there is none called so.
    """
    of_triangles = mesh.cell_data.get(TRIANGLE, {})
    for arrays in (of_triangles, mesh.point_data):
        names = {key.lower(): key for key in arrays} if array is None else {array: array}
        wanted = LABEL_NAMES if array is None else (array,)
        name = next((names[name] for name in wanted if names.get(name) in arrays), None)
        if name is not None:
            surfaces = {number: group for group, (size, number) in mesh.groups.items() if size == 2}
            groups = surfaces if name == GROUP else None
            source = f"{mesh.path}: array '{name}'"
            return LabelArray(source, arrays[name], arrays is of_triangles, groups)
    if array is not None:
        known = ", ".join(sorted({*of_triangles, *mesh.point_data})) or "none"
        raise InputError(
            f"{mesh.path}: no array '{array}' on triangles or points; there are: {known}; name one "
            "of them (--label-array)"
        )
    return None


def label_boundary(
    mesh: MeshFile, boundary: Integers, array: str | None, names: Names
) -> Integers | None:
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
    if mesh.path.suffix.lower() in OPENCARP_FORMATS and array is None:
        found = _from_files_beside(mesh, boundary, names)
    else:
        found = _from_array(mesh, boundary, array, names)
    if found is None:
        return None
    source, labels = found
    _check_all_there(source, labels)
    return labels


def _from_array(
    mesh: MeshFile, boundary: Integers, array: str | None, names: Names
) -> tuple[str, Integers] | None:
    """Source and labels (b,) of the boundary's triangles by an array of triangles or points."""
    found = find_label_array(mesh, array)
    if found is None:
        return None
    if not found.of_triangles:
        points = np.unique(boundary)
        numbers = whole_numbers(found.source, found.values[points])
        votes = np.zeros((len(mesh.points), max(Label) + 1), dtype=bool)
        votes[points, labels_of(found.source, numbers, names, {})] = True
        return found.source, _elected(votes, boundary)
    numbers = whole_numbers(found.source, found.values)
    given = np.full(len(numbers), found.groups is None) | (numbers != UNLABELLED)
    if not given.any():
        return None
    labels = labels_of(found.source, numbers[given], names, found.groups or {})
    return found.source, _on_boundary(found.source, mesh.cells[TRIANGLE][given], labels, boundary)


def _from_files_beside(
    mesh: MeshFile, boundary: Integers, names: Names
) -> tuple[str, Integers] | None:
    """Source and labels (b,) of the boundary's triangles by `.surf` files, or else `.vtx` files."""
    stem = opencarp_file(mesh.path, "").name
    for suffix, read in ((".surf", _from_surf_files), (".vtx", _from_vtx_files)):
        files = []
        for path in sorted(mesh.path.parent.glob(f"*{suffix}")):
            name = path.name.removesuffix(suffix).removesuffix(".surf").removeprefix(stem)
            name = name.strip("._- ")
            label = names.get(name, label_of(name))
            if label is not None:
                files.append((path, label))
        if files:
            source = f"{mesh.path} ({', '.join(path.name for path, _ in files)})"
            return source, read(source, files, len(mesh.points), boundary)
    return None


def _from_surf_files(
    source: str, files: list[tuple[Path, Label]], points: int, boundary: Integers
) -> Integers:
    parts = [read_surf(path, points) for path, _ in files]
    labels = np.repeat([int(label) for _, label in files], list(map(len, parts)))
    return _on_boundary(source, np.concatenate(parts), labels, boundary)


def _from_vtx_files(
    source: str, files: list[tuple[Path, Label]], points: int, boundary: Integers
) -> Integers:
    votes = np.zeros((points, max(Label) + 1), dtype=bool)
    for path, label in files:
        indices, _ = read_vtx(path)
        if indices.max() >= points:
            raise InputError(
                f"{path}: index {indices.max()} is out of range; the mesh has points 0 to "
                f"{points - 1}"
            )
        votes[indices, label] = True
    on_boundary = np.unique(boundary)
    without = on_boundary[~votes[on_boundary].any(axis=1)]
    if without.size:
        raise InputError(
            f"{source}: {without.size} of {on_boundary.size} boundary points have no label (first: "
            f"{without[0]}); label every one"
        )
    return _elected(votes, boundary)


def _elected(votes: Booleans, boundary: Integers) -> Integers:
    """Label that most corners of each triangle have, of the votes (points, labels), shape (b,)."""
    order = np.array(PRECEDENCE, dtype=np.int64)
    # argmax takes the first of those with as many
    return np.asarray(order[np.argmax(votes[boundary].sum(axis=1)[:, order], axis=1)])


def _on_boundary(source: str, triangles: Integers, given: Integers, boundary: Integers) -> Integers:
    """Label of each boundary triangle; `UNLABELLED` where none was given."""
    at = places_in(triangles, boundary)
    labels = np.full(len(boundary), UNLABELLED)
    labels[at] = given
    for bad, fault, remedy in (
        (at < 0, "labelled triangles are not on the boundary", "label faces of the mesh itself"),
        (labels[at] != given, "triangles have two labels", "keep one"),
    ):
        if bad.any():
            first = " ".join(map(str, triangles[np.argmax(bad)]))
            raise InputError(
                f"{source}: {int(bad.sum())} of {len(triangles)} {fault} (first: points {first}); "
                f"{remedy}"
            )
    return labels


def _check_all_there(source: str, labels: Integers) -> None:
    without = int((labels == UNLABELLED).sum())
    rest = f"{without} of {len(labels)} boundary triangles have no label" if without else ""
    missing = missing_parts(labels)
    if missing:
        found = f" ({rest})" if rest else ""
        raise InputError(f"{source}: labels missing: {', '.join(missing)}{found}; add them")
    if without:
        raise InputError(
            f"{source}: {rest} (first: {np.flatnonzero(labels == UNLABELLED)[0]}); label every one"
        )
