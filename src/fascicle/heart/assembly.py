"""A heart from the mesh, surfaces and electrodes in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.ranges import check_array
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.endocardium import oriented_into_cavity
from fascicle.heart.heart import Heart
from fascicle.heart.seeds import ChosenSeed, seeded_endocardia
from fascicle.heart.validate import (
    check_electrodes,
    check_endocardium_in_place,
    check_fibres,
    check_tetrahedra,
    check_units,
)
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.measures import principal_axes, unit
from fascicle.mesh.topology import without_unused_vertices

REGION = "region"  # cell array of labels
SHEET = "sheet"  # cell array of directions
VALVE = "valve"  # cell array of an endocardium: 1 where it spans a valve opening
FIBRE_NAMES = ("fibre", "fibres", "fiber", "fibers", "f0", "fiber_direction", "fibre_direction")
OTHER_DIRECTIONS = ("normals", SHEET)  # arrays of directions that are not fibres
# Points of two files are the same when they are this close, as a fraction of the mesh's extent:
# room for single precision.
MATCH = 1e-5
UNIT_LENGTH_ERROR = 1e-12  # a fibre this near to unit length stays as it is


def assemble_heart(
    *,
    mesh: MeshFile,
    fibres: MeshFile | None,
    surfaces: dict[str, MeshFile],
    seeds: dict[str, tuple[ChosenSeed, ChosenSeed]],
    electrodes: Path,
    name: str,
) -> Heart:
    """Build and validate a heart from files that were read.

    Parameters
    ----------
    mesh : MeshFile
        Tetrahedra, labels of regions if it has them, and the fibres too if `fibres` is None.
    fibres : MeshFile or None
        The file that holds the fibres, per point or per tetrahedron.
    surfaces : dict of side to MeshFile
        Endocardia.
    seeds : dict of side to (root, direction)
        Vertices of the endocardia, or positions on them; None where they are to be found.
    electrodes : Path
        File of electrode positions.
    name : str
        What to call the heart.
    """
    tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    source = str(mesh.path)
    check_units(source, mesh.points)
    direction = _fibres_per_tetrahedron(mesh, tetrahedra, fibres if fibres is not None else mesh)
    vertices, tetrahedra = without_unused_vertices(mesh.points, tetrahedra)
    check_tetrahedra(source, vertices, tetrahedra)
    opened = {side: _surface(side, surface) for side, surface in surfaces.items()}
    for side, (points, _) in opened.items():
        check_endocardium_in_place(f"{surfaces[side].path}", points, vertices)
    _check_two_surfaces(surfaces, opened)
    named = {
        side: (str(surface.path), *opened[side], _valves(surface))
        for side, surface in surfaces.items()
    }
    lv, rv = seeded_endocardia(named, seeds)
    heart = Heart(
        vertices=vertices,
        tetrahedra=tetrahedra,
        fibres=direction,
        lv=lv,
        rv=rv,
        electrodes=read_electrodes(electrodes),
        name=name,
        regions=region_labels(mesh),
        sheets=_sheets(mesh),
    )
    check_electrodes(str(electrodes), heart.electrodes, heart)
    return heart


def _check_two_surfaces(
    surfaces: dict[str, MeshFile], opened: dict[str, tuple[Floats, Integers]]
) -> None:
    apart = cKDTree(opened["rv"][0]).query(opened["lv"][0])[0]
    if float(np.median(apart)) == 0:
        raise InputError(
            f"{surfaces['lv'].path}: the LV and the RV endocardium are the same surface; "
            "give one for each ventricle"
        )


def _surface(side: str, surface: MeshFile) -> tuple[Floats, Integers]:
    """Points and triangles of an endocardium, facing its cavity.

    Point indices stay as in the file, since seeds refer to them; points that no triangle uses
    would make the chart singular and are refused.
    """
    name = f"{surface.path} ({side.upper()} endocardium)"
    triangles = surface.require(TRIANGLE, "triangles")
    unused = len(surface.points) - np.unique(triangles).size
    if unused:
        raise InputError(
            f"{name}: {unused} of {len(surface.points)} points belong to no triangle; remove them "
            "(ParaView: Clean)"
        )
    check_array("coordinate", surface.points, f"{name}: a coordinate")
    return surface.points, oriented_into_cavity(surface.points, triangles, name)


def _fibres_per_tetrahedron(mesh: MeshFile, tetrahedra: Integers, source: MeshFile) -> Floats:
    """Find the unit fibre of each tetrahedron, matched by position if the order differs."""
    name = str(source.path)
    values, per_cell = _fibre_array(source)
    if per_cell:
        theirs = source.points[source.require(TETRAHEDRON, "tetrahedra")].mean(axis=1)
        ours = mesh.points[tetrahedra].mean(axis=1)
        row = _match_by_position(name, theirs, ours, "tetrahedra")
        values = values[row]
        check_fibres(name, values)
        length = np.linalg.norm(values, axis=1, keepdims=True)
        # so that a heart that was written reads back equal
        exact = np.abs(length - 1) < UNIT_LENGTH_ERROR
        return np.asarray(np.where(exact, values, values / length))
    used = np.unique(tetrahedra)
    row = _match_by_position(name, source.points, mesh.points[used], "vertices")
    at_vertex = np.zeros((len(mesh.points), 3))
    at_vertex[used] = values[row]
    check_fibres(name, at_vertex[used])
    return average_to_tetrahedra(at_vertex, tetrahedra)


def _match_by_position(name: str, given: Floats, wanted: Floats, what: str) -> Integers:
    """Rows (k,) of the given positions (n, 3) that are those of the wanted ones (k, 3)."""
    distance, row = cKDTree(given).query(wanted)
    tolerance = MATCH * float(np.ptp(wanted, axis=0).max())
    bad = np.flatnonzero(distance > tolerance)
    if bad.size:
        raise InputError(
            f"{name}: no fibre within {tolerance:.2g} mm of {bad.size} of {len(wanted)} {what} of "
            f"the mesh (largest gap {distance.max():.3g} mm); give fibres on the same mesh"
        )
    return np.asarray(row, dtype=np.int64)


def average_to_tetrahedra(fibres: Floats, tetrahedra: Integers) -> Floats:
    """Mean axis of each tetrahedron's four vertex fibres, shape (m, 3).

    Fibres have no sign, so the mean is the principal axis of Σ f⊗f.
    """
    return principal_axes(unit(fibres[tetrahedra]))


def region_labels(mesh: MeshFile, array: str = REGION) -> Integers | None:
    """Labels of the tetrahedra (m,), if the mesh has this cell array; whole numbers."""
    values = mesh.cell_array(TETRAHEDRON, array)
    if values is None:
        return None
    if values.ndim != 1 or not (np.isfinite(values) & (values == np.round(values))).all():
        raise InputError(
            f"{mesh.path}: the cell array '{array}' must hold one whole number a tetrahedron; "
            "correct or remove it"
        )
    return values.astype(np.int64)


def _sheets(mesh: MeshFile) -> Floats | None:
    """Sheet directions of the tetrahedra, if the mesh has the cell array `sheet`."""
    values = mesh.cell_array(TETRAHEDRON, SHEET)
    if values is None:
        return None
    name = f"{mesh.path} ('{SHEET}')"
    if values.ndim != 2 or values.shape[1] != 3:
        raise InputError(f"{name}: sheets must be vectors of three numbers; correct or remove it")
    check_fibres(name, values)
    return values


def _valves(surface: MeshFile) -> Booleans | None:
    """Which triangles span a valve opening, if the surface has the cell array `valve`."""
    values = surface.cell_array(TRIANGLE, VALVE)
    return None if values is None else values != 0


def _fibre_array(source: MeshFile) -> tuple[Floats, bool]:
    """Find the array of directions in a file, and whether it is one per tetrahedron."""
    candidates: dict[str, tuple[Any, bool]] = {}
    for arrays, per_cell in (
        (source.cell_data.get(TETRAHEDRON, {}), True),
        (source.point_data, False),
    ):
        for key, values in arrays.items():
            if (
                np.ndim(values) == 2
                and np.shape(values)[1] == 3
                and key.lower() not in OTHER_DIRECTIONS
            ):
                candidates.setdefault(key, (values, per_cell))  # those of cells are exact
    named = [key for key in candidates if key.lower() in FIBRE_NAMES]
    keys = named if named else list(candidates)
    if len(keys) != 1:
        found = ", ".join(keys) if keys else "none"
        raise InputError(
            f"{source.path}: need one array of fibre directions (3 components); found {found}; "
            "keep one, or name it 'fibre'"
        )
    values, per_cell = candidates[keys[0]]
    return np.asarray(values, dtype=float), per_cell
