"""Extracting the ventricles from the mesh of a whole heart, by the numbers of its regions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import igl
import numpy as np

from fascicle.core.arrays import Booleans, Integers
from fascicle.core.errors import InputError
from fascicle.heart.assembly import ARRAY_NAMES
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledMesh
from fascicle.mesh.measures import closed_by_fan, signed_volumes, triangle_areas
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.topology import boundary_triangles, places_in

Regions = Mapping[str, tuple[int, ...]]  # the numbers of "lv", "rv" and perhaps "septum"


def region_arrays(mesh: MeshFile) -> dict[str, Integers]:
    """Arrays of the tetrahedra that may be regions: integers, with 2 to 200 different values.

    Arrays with the usual names come first, then those with more distinct numbers.
    """
    candidates = {}
    for name, array in mesh.cell_data.get(TETRAHEDRON, {}).items():
        values = np.asarray(array)
        if values.ndim == 1 and (np.isfinite(values) & (values == np.round(values))).all():
            count = len(np.unique(values))
            if 1 < count <= 200:  # more numbers would be of elements, not of regions
                rank = name.lower() not in ARRAY_NAMES["region"], -count
                candidates[name] = rank, values.astype(np.int64)
    ordered = sorted(candidates.items(), key=lambda item: item[1][0])
    return {name: values for name, (_, values) in ordered}


def regions_in(mesh: MeshFile) -> str:
    """Region numbers in a mesh and sizes of the regions, in words; empty if it has none."""
    if not (arrays := region_arrays(mesh)):
        return ""
    name, values = next(iter(arrays.items()))
    volumes = np.abs(signed_volumes(mesh.points, mesh.cells[TETRAHEDRON])) / 1e3
    numbers, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    names = {number: group for group, (size, number) in mesh.groups.items() if size == 3}
    sizes = zip(numbers.tolist(), counts, np.bincount(which, volumes), strict=True)
    listed = [
        f"{number}{f' {names[number]}' if number in names else ''} ({count} elements, {ml:.3g} ml)"
        for number, count, ml in sizes
    ]
    if len(listed) > 12:
        listed = [*listed[:12], f"and {len(listed) - 12} more"]
    other_arrays = f"; other arrays: {', '.join(list(arrays)[1:])}" if len(arrays) > 1 else ""
    return f"its array '{name}' has the regions {', '.join(listed)}{other_arrays}"


def ventricles(
    mesh: MeshFile, regions: Regions, array: str | None = None
) -> tuple[MeshFile, Integers]:
    """Take the ventricles out of a mesh, by the numbers of their regions in an array.

    By default it is the array that has these numbers. Returns the mesh of the ventricles, with the
    numbers in the array ``region`` and those triangles of the file that are on its boundary; and
    the triangles (k, 3), as points of the file, that lay between ventricles and other tissue.
    """
    unknown = [name for name in regions if name not in ("lv", "rv", "septum")]
    if unknown or not {"lv", "rv"} <= set(regions):
        fault = f"unknown '{unknown[0]}'" if unknown else "lv or rv missing"
        raise InputError(
            f"--regions: {fault}; give lv, rv and perhaps septum, as lv=1,rv=2,septum=7"
        )
    region_numbers = np.concatenate([np.array(numbers) for numbers in regions.values()])
    if len(np.unique(region_numbers)) < len(region_numbers):
        raise InputError("--regions: a number is given twice; give each once")
    values = _regions_with(mesh, region_numbers, array)
    tetrahedra, chosen = mesh.cells[TETRAHEDRON], np.isin(values, region_numbers)
    boundary, _ = boundary_triangles(tetrahedra[chosen])
    outer, _ = boundary_triangles(tetrahedra)
    kept = mesh.keeping(TETRAHEDRON, chosen)
    if TRIANGLE in kept.cells:
        kept = kept.keeping(TRIANGLE, places_in(kept.cells[TRIANGLE], boundary) >= 0)
    arrays = {**kept.cell_data.get(TETRAHEDRON, {}), "region": values[chosen].astype(float)}
    kept = replace(kept, cell_data={**kept.cell_data, TETRAHEDRON: arrays})
    return kept, boundary[places_in(boundary, outer) < 0]


def _regions_with(mesh: MeshFile, region_numbers: Integers, array: str | None) -> Integers:
    """Values of the array of regions that has all these numbers."""
    arrays = region_arrays(mesh)
    region_list = regions_in(mesh) or "its tetrahedra have no array of region numbers"
    if array is not None:
        arrays = {name: values for name, values in arrays.items() if name == array}
    if not (fitting := {name: v for name, v in arrays.items() if np.isin(region_numbers, v).all()}):
        numbers = ", ".join(map(str, region_numbers))
        raise InputError(
            f"{mesh.path}: no array{f' {array!r}' if array else ''} of the tetrahedra has all of "
            f"the regions {numbers}; {region_list}; give numbers that are there (--regions, "
            "--region-array)"
        )
    name, values = next(iter(fitting.items()))
    for other, theirs in fitting.items():
        if name.lower() not in ARRAY_NAMES["region"] and not np.array_equal(
            np.isin(values, region_numbers), np.isin(theirs, region_numbers)
        ):
            raise InputError(
                f"{mesh.path}: the arrays '{name}' and '{other}' both have these regions, of "
                "different elements; say which one is meant (--region-array)"
            )
    return values


def labels_of_ventricles(mesh: LabelledMesh, is_left: Booleans) -> Integers | None:
    """Labels (b,) of the boundary of `ventricles`, whose base is labelled; None if not possible.

    Without the base the boundary must fall into the epicardium, which encloses most, and two
    endocardia, of which that of the left ventricle lies on more of its tetrahedra, as `is_left`
    (m,) says. Smaller pieces become part of the base.
    """
    unlabelled = np.flatnonzero(mesh.labels == 0)
    triangles, owner = (
        mesh.triangles[unlabelled],
        boundary_triangles(mesh.tetrahedra)[1][unlabelled],
    )
    piece = np.asarray(igl.facet_components(triangles)[1])
    area = np.bincount(piece, triangle_areas(mesh.vertices, triangles))
    if len(large := np.flatnonzero(area > 0.02 * area.sum())) != 3:
        return None
    enclosed = [abs(closed_by_fan(mesh.vertices, triangles[piece == k])[0]) for k in large]
    outer = large[np.argmax(enclosed)]
    rv, lv = sorted(large[large != outer], key=lambda k: float(is_left[owner[piece == k]].mean()))
    labels = np.where(mesh.labels == 0, int(Label.BASE), mesh.labels)
    for label, which in zip((*ENDOCARDIA, Label.EPICARDIUM), (lv, rv, outer), strict=True):
        labels[unlabelled[piece == which]] = label
    return labels
