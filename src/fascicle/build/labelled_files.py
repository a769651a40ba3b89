"""Closed surfaces and tetrahedra from files, with the labels of their triangles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from fascicle.build.endocardia import labels_from_points
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.assembly import ARRAY_NAMES, read_coordinates, region_labels
from fascicle.heart.fibres import is_placeholder
from fascicle.heart.heart import VentricularCoordinates
from fascicle.heart.labelled_surface import (
    ENDOCARDIA,
    NEEDED_LABELS,
    Label,
    LabelledMesh,
    LabelledSurface,
    Names,
    label_of,
    labels_by_number,
    labels_of,
    missing_parts,
    whole_numbers,
)
from fascicle.mesh.checks import check_fibres, check_tetrahedra, check_units, refuse
from fascicle.mesh.measures import principal_axes, unit
from fascicle.mesh.mesh_file import GROUP, OPENCARP_FORMATS, TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.opencarp import opencarp_file, read_surf, read_vtx
from fascicle.mesh.topology import (
    boundary_triangles,
    merged_vertices,
    places_in,
    without_unused_vertices,
)

FibreChoice = Literal["rule", "file"] | None  # None: those of the file, if they are no placeholder


@dataclass(frozen=True)
class Anatomy:
    """Labelled mesh, with the fibres and other properties that its files hold."""

    mesh: LabelledMesh  # labels are all 0 before they are found
    fibres: Floats | None = None  # unit directions (m, 3), if the source has any
    sheets: Floats | None = None
    coordinates: VentricularCoordinates | None = None
    notes: tuple[str, ...] = ()  # decisions taken on the way, for the user
    guessed: bool = False  # labels were derived from the shape; the user should check them
    own_mesh: bool = False  # the tetrahedra are those of the source
    values: Mapping[str, float] = field(default_factory=dict)  # patient's values of quantities
    warnings: tuple[str, ...] = ()  # one line each, with a remedy


class LabelArray(NamedTuple):
    """Array of labels: its source for messages, values (k,), and whether it is of triangles."""

    source: str
    values: Floats | Integers
    of_triangles: bool
    groups: Mapping[int, str] | None  # names of the numbers, if they are Gmsh's physical groups


def find_label_array(mesh: MeshFile, array: str | None) -> LabelArray | None:
    """Find the array of this name, or else one with a usual name; triangles come before points."""
    of_triangles = mesh.cell_data.get(TRIANGLE, {})
    for arrays in (of_triangles, mesh.point_data):
        requested = None if array not in arrays else (array, arrays[array])
        if entry := _named(arrays, ARRAY_NAMES["label"]) if array is None else requested:
            name, values = entry
            surfaces = {number: group for group, (size, number) in mesh.groups.items() if size == 2}
            groups = surfaces if name == GROUP else None
            source = f"{mesh.path}: array '{name}'"
            return LabelArray(source, values, arrays is of_triangles, groups)
    if array is not None:
        names = ", ".join(sorted({*of_triangles, *mesh.point_data})) or "none"
        raise InputError(
            f"{mesh.path}: no array '{array}' on triangles or points; there are: {names}; name one "
            "of them (--label-array)"
        )
    return None


def has_labels(mesh: MeshFile, array: str | None = None) -> bool:
    """True if there are labels: in a named array, or an array with a usual name."""
    if array is not None:
        return True
    labels = find_label_array(mesh, None)
    # a surface that is all one physical group, or in none, has no labels
    return labels is not None and (labels.groups is None or len(np.unique(labels.values)) > 1)


def labelled_surface(
    mesh: MeshFile, array: str | None = None, names: Mapping[str, int] | None = None
) -> LabelledSurface:
    """Surface of a file (mm) with labels of its triangles; repeated points are merged.

    There is a label for each triangle or point, in the array of this name, by default a usual one
    (`ARRAY_NAMES`). Names give the number of each label, as in ``{"lv": 3}``; the other labels have
    `Label`'s numbers.
    """
    check_units(str(mesh.path), mesh.points)
    triangles = mesh.require(TRIANGLE, "triangles")
    if (label_array := find_label_array(mesh, array)) is None:
        arrays = sorted({*mesh.point_data, *mesh.cell_data.get(TRIANGLE, {})})
        usual = ", ".join(ARRAY_NAMES["label"][:-1])
        raise InputError(
            f"{mesh.path}: no labels: no array called {usual} on triangles or points (arrays: "
            f"{', '.join(arrays) or 'none'}); name the array (--label-array)"
        )
    numbers = {} if names is None else labels_by_number(names)
    label_numbers = whole_numbers(label_array.source, label_array.values)
    labels = labels_of(label_array.source, label_numbers, numbers, label_array.groups or {})
    used, number = np.unique(merged_vertices(mesh.points), return_inverse=True)
    vertices, triangles = mesh.points[used], number[triangles]
    if not label_array.of_triangles:
        at_vertices = np.empty(len(vertices), dtype=np.int64)
        at_vertices[number] = labels
        labels = labels_from_points(vertices, triangles, at_vertices)
    return LabelledSurface(vertices, triangles, labels, str(mesh.path))


def labelled_tetrahedra(
    mesh: MeshFile,
    array: str | None = None,
    names: Names | None = None,
    *,
    cut: Integers | None = None,
    fibres: FibreChoice = None,
) -> Anatomy:
    """Tetrahedra of a file, with the labels of their surface, regions, fibres and sheets.

    The labels come from

    - triangles of the same file with a cell array ``label`` (or ``class``, ``surface``, ...)
      of `Label` numbers: VTK, VTU;
    - a point array of such a name on the boundary's points; a triangle gets the label of most of
      its corners (ties: the endocardia, then the epicardium, then the base);
    - physical groups of triangles, by name or number: Gmsh;
    - ``.surf`` files, or else ``.vtx`` files, in the mesh's folder with names like
      ``<stem>_lv_endo.surf``: openCARP.

    `array` is the array of labels, if it has another name, and `names` are the file's own names or
    numbers (as text) of labels. Triangles (k, 3) that were cut, where tissue was left out, are base
    if the file has no label. Fibres of the file are ignored ("rule"), or kept even if they look
    like a `fascicle.heart.fibres.placeholder` ("file"). Unused vertices are left out; labels are 0
    if the file has none and where nothing was cut.
    """
    file_tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    name = str(mesh.path)
    vertices, tetrahedra = without_unused_vertices(mesh.points, file_tetrahedra)
    check_units(name, vertices)
    check_tetrahedra(name, vertices, tetrahedra)
    triangles, _ = boundary_triangles(tetrahedra)
    boundary = np.unique(file_tetrahedra)[triangles]
    labels = _label_boundary(mesh, boundary, array, names if names is not None else {}, cut)
    tissue = LabelledMesh(vertices, tetrahedra, triangles, labels, name=name)
    read = with_arrays(Anatomy(tissue, own_mesh=True), mesh, fibres)
    return replace(read, coordinates=read_coordinates(mesh))


def with_arrays(anatomy: Anatomy, mesh: MeshFile, fibres: FibreChoice = None) -> Anatomy:
    """Add regions, fibres and sheets to an anatomy, from the file of its tetrahedra."""
    region = _named(mesh.cell_data.get(TETRAHEDRON, {}), ARRAY_NAMES["region"])
    regions = None if region is None else region_labels(mesh, region[0])
    notes = list(anatomy.notes)
    along, across = (_directions(mesh, kind, fibres, notes) for kind in ("fibres", "sheets"))
    return replace(
        anatomy,
        mesh=replace(anatomy.mesh, regions=regions),
        fibres=along,
        sheets=None if along is None else across,
        notes=tuple(notes),
    )


def _named(arrays: Mapping[str, Floats], names: tuple[str, ...]) -> tuple[str, Floats] | None:
    """First array with one of these names, in the order of the names."""
    lower = {key.lower(): key for key in arrays}
    return next(((lower[name], arrays[lower[name]]) for name in names if name in lower), None)


def _directions(mesh: MeshFile, kind: str, choice: FibreChoice, notes: list[str]) -> Floats | None:
    """Unit directions of the tetrahedra, from a cell or else a point array, if usable."""
    tetrahedra = mesh.cells[TETRAHEDRON]
    of_cells = _named(mesh.cell_data.get(TETRAHEDRON, {}), ARRAY_NAMES[kind])
    entry = of_cells or _named(mesh.point_data, ARRAY_NAMES[kind])
    if entry is None or choice == "rule":
        if choice == "file" and kind == "fibres":
            raise InputError(f"--fibres file: {mesh.path} has none; leave it out to have a rule")
        return None
    title, values = f"{mesh.path}: array '{entry[0]}'", np.asarray(entry[1], dtype=float)
    if values.shape[1:] != (3,):
        raise InputError(f"{title} has shape {values.shape}; give three components, or rename it")
    used = values if of_cells else values[np.unique(tetrahedra)]
    points = mesh.points if of_cells else mesh.points[np.unique(tetrahedra)]
    remedy = "give every one a direction, or take a rule (--fibres rule)"
    if is_placeholder(kind, f"array '{entry[0]}'", used, notes, kept=choice == "file"):
        return None
    check_fibres(title, used, points, tetrahedra if of_cells else None, remedy)
    return unit(values) if of_cells else principal_axes(unit(values[tetrahedra]))


def _label_boundary(
    mesh: MeshFile, boundary: Integers, array: str | None, names: Names, cut: Integers | None
) -> Integers:
    """Labels (b,) of boundary triangles (b, 3) by the mesh's file, or others in its folder.

    Triangles without a label are base if they were cut. Without any labels, all others are 0.
    """
    basal = np.zeros(len(boundary), dtype=np.int64)
    if cut is not None:
        basal[places_in(boundary, cut) >= 0] = Label.BASE
    if mesh.path.suffix.lower() in OPENCARP_FORMATS and array is None:
        sourced = _from_surface_files(mesh, boundary, names, changed=cut is not None)
    else:
        sourced = _from_array(mesh, boundary, array, names)
    if sourced is None:
        return basal
    source, labels = sourced[0], np.where(sourced[1] == 0, basal, sourced[1])
    if missing := missing_parts(labels):
        without = f"{(labels == 0).sum()} of {len(labels)} boundary triangles have none"
        raise InputError(
            f"{source}: labels missing: {', '.join(missing)} ({without}); add them (all are needed)"
        )
    fault = "boundary triangles have no label"
    refuse(source, labels == 0, fault, "label every one", mesh.points, boundary, boundary)
    return labels


def _from_array(
    mesh: MeshFile, boundary: Integers, array: str | None, names: Names
) -> tuple[str, Integers] | None:
    """Source and labels (b,) of the boundary's triangles by an array of triangles or points."""
    if (label_array := find_label_array(mesh, array)) is None:
        return None
    if not label_array.of_triangles:
        points = np.unique(boundary)
        numbers = whole_numbers(label_array.source, label_array.values[points])
        votes = np.zeros((len(mesh.points), max(Label) + 1), dtype=bool)
        votes[points, labels_of(label_array.source, numbers, names, {})] = True
        return label_array.source, _elected(votes, boundary)
    numbers = whole_numbers(label_array.source, label_array.values)
    labelled = np.full(len(numbers), label_array.groups is None) | (numbers != 0)
    if not labelled.any():
        return None
    labels = labels_of(label_array.source, numbers[labelled], names, label_array.groups or {})
    triangles = mesh.cells[TRIANGLE][labelled]
    return label_array.source, _on_boundary(
        label_array.source, mesh.points, triangles, labels, boundary
    )


def _from_surface_files(
    mesh: MeshFile, boundary: Integers, names: Names, *, changed: bool
) -> tuple[str, Integers] | None:
    """Source and labels (b,) of the boundary's triangles by `.surf` files, or else `.vtx` files."""
    stem, points = opencarp_file(mesh.path, "").name, len(mesh.points)
    for suffix in (".surf", ".vtx"):
        files = []
        for path in sorted(mesh.path.parent.glob(f"*{suffix}")):
            name = path.name.removesuffix(suffix).removesuffix(".surf")
            name = name.removeprefix(stem).strip("._- ")
            if (label := names.get(name, label_of(name))) is not None:
                files.append((path, label))
        if not files:
            continue
        source = f"{mesh.path} ({', '.join(path.name for path, _ in files)})"
        if suffix == ".surf":
            parts = [read_surf(path, points) for path, _ in files]
            labels = np.repeat([int(label) for _, label in files], list(map(len, parts)))
            triangles = np.concatenate(parts)
            # triangles may be missing from a boundary that was changed
            still = (places_in(triangles, boundary) >= 0) | (not changed)
            triangles, labels = triangles[still], labels[still]
            return source, _on_boundary(source, mesh.points, triangles, labels, boundary)
        votes = np.zeros((points, max(Label) + 1), dtype=bool)
        for path, label in files:
            votes[read_vtx(path, points), label] = True
        used = np.unique(boundary)
        without = np.asarray(~votes[used].any(axis=1))
        fault = "points of the boundary have no label"
        refuse(source, without, fault, "label every one", mesh.points[used], numbers=used)
        return source, _elected(votes, boundary)
    return None


def _elected(votes: Booleans, boundary: Integers) -> Integers:
    """Label (b,) of most corners of each triangle, by the votes (points, labels) of points."""
    valves = sorted(set(Label) - set(NEEDED_LABELS))
    order = np.array([*ENDOCARDIA, Label.EPICARDIUM, *valves, Label.BASE], dtype=np.int64)
    # argmax takes the first label of a tie
    return np.asarray(order[np.argmax(votes[boundary].sum(axis=1)[:, order], axis=1)])


def _on_boundary(
    source: str, points: Floats, triangles: Integers, triangle_labels: Integers, boundary: Integers
) -> Integers:
    """Label of each boundary triangle; 0 where it has none."""
    at = places_in(triangles, boundary)
    labels = np.zeros(len(boundary), dtype=np.int64)
    labels[at] = triangle_labels
    for bad, fault, remedy in (
        (at < 0, "labelled triangles are not on the boundary", "label faces of the mesh itself"),
        (labels[at] != triangle_labels, "triangles have two labels", "keep one"),
    ):
        refuse(source, bad, fault, remedy, points, triangles, triangles)
    return labels
