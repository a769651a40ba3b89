"""A heart from the mesh, surfaces and electrodes in files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.ranges import check_array
from fascicle.heart.electrodes import check_electrodes, read_electrodes
from fascicle.heart.endocardium import ChosenSeed, oriented_into_cavity, seeded_endocardia
from fascicle.heart.fibres import is_placeholder, rule_based_fibres
from fascicle.heart.heart import Heart, VentricularCoordinates
from fascicle.heart.labelled_surface import labelled_mesh, missing_parts
from fascicle.mesh.checks import (
    check_endocardium_in_place,
    check_fibres,
    check_tetrahedra,
    check_units,
    refuse,
)
from fascicle.mesh.measures import principal_axes, unit
from fascicle.mesh.mesh_file import GROUP, TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.topology import without_unused_vertices

# Names of arrays in files, in the order in which they are looked for
ARRAY_NAMES = {
    "label": ("label", "labels", "class", "classes", "surface", "surfaces", "boundary", GROUP),
    "region": ("region", "regions", "elemtag", "elemtags", "tag", "tags", GROUP),
    "fibres": ("fibre", "fibres", "fiber", "fibers", "f0", "fiber_direction", "fibre_direction"),
    "sheets": ("sheet", "sheets", "s0", "sheet_direction"),
}


def assemble_heart(
    *,
    mesh: MeshFile,
    fibres: MeshFile | None,
    surfaces: dict[str, MeshFile],
    seeds: dict[str, tuple[ChosenSeed, ChosenSeed]],
    electrodes: Path,
    name: str,
    by_rule: bool | None = False,
    notes: list[str] | None = None,
) -> Heart:
    """Build and validate a heart from files that were read.

    The mesh has tetrahedra, and perhaps their regions and sheets; fibres are per point or
    tetrahedron, in the same file if None. Triangles of the endocardia, by side, with a cell array
    ``valve`` that is not 0 span a valve opening. Seeds are vertices of the endocardia, or positions
    on them, or None: then the anatomy decides.

    Fibres and sheets are those of `fascicle.heart.fibres.rule_based_fibres` if `by_rule`, or if it
    is None and the file's fibres are a `fascicle.heart.fibres.placeholder`; the notes then say so.
    """
    tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    check_units(str(mesh.path), mesh.points)
    notes = notes if notes is not None else []
    source, direction = fibres if fibres is not None else mesh, np.zeros((len(tetrahedra), 3))
    if by_rule is None:
        array, values, _ = _fibre_array(source)
        array = f"array '{array}' of {source.path}"
        by_rule = is_placeholder("fibres", array, values, notes, kept=False)
    if not by_rule:
        direction = _fibres_per_tetrahedron(mesh, tetrahedra, source)
    vertices, tetrahedra = without_unused_vertices(mesh.points, tetrahedra)
    check_tetrahedra(str(mesh.path), vertices, tetrahedra)
    named = {}
    for side, surface in surfaces.items():
        named_surface = str(surface.path), surface.points, _endocardium(side, surface)
        check_endocardium_in_place(*named_surface, vertices, tetrahedra)
        valves = surface.cell_array(TRIANGLE, "valve")
        valves = None if valves is None else valves != 0
        named[side] = *named_surface, valves
    if float(np.median(cKDTree(surfaces["rv"].points).query(surfaces["lv"].points)[0])) == 0:
        raise InputError(
            f"{surfaces['lv'].path}: the LV and the RV endocardium are the same surface; "
            "give one for each ventricle"
        )
    lv, rv = seeded_endocardia(named, seeds)
    nine, more = read_electrodes(electrodes)
    heart = Heart(
        vertices=vertices,
        tetrahedra=tetrahedra,
        fibres=direction,
        lv=lv,
        rv=rv,
        electrodes=nine,
        name=name,
        additional_electrodes=more,
        regions=region_labels(mesh),
        sheets=None if by_rule else _sheets(mesh),
        coordinates=read_coordinates(mesh),
    )
    check_electrodes(str(electrodes), heart)
    if not by_rule:
        return heart
    labelled = labelled_mesh(heart)
    if missing := missing_parts(labelled.labels):
        raise InputError(
            f"{source.path}: no fibres, and no rule serves, as the mesh's boundary has no "
            f"{', '.join(missing)} where the surfaces are; give fibres, or this mesh's surfaces"
        )
    ruled = rule_based_fibres(labelled)
    return replace(heart, fibres=ruled.fibre, sheets=ruled.sheet)


def _endocardium(side: str, surface: MeshFile) -> Integers:
    """Triangles of an endocardium, facing its cavity, with point indices as in the file.

    Seeds refer to these indices. Points that no triangle uses, which would make the chart singular,
    are refused.
    """
    name = f"{surface.path} ({side.upper()} endocardium)"
    triangles = surface.require(TRIANGLE, "triangles")
    unused = np.bincount(triangles.ravel(), minlength=len(surface.points)) == 0
    remedy = "remove them (ParaView: Clean)"
    refuse(name, unused, "points belong to no triangle", remedy, surface.points)
    check_array("coordinate", surface.points, f"{name}: a coordinate")
    return oriented_into_cavity(surface.points, triangles, name)


def _fibres_per_tetrahedron(mesh: MeshFile, tetrahedra: Integers, source: MeshFile) -> Floats:
    """Find the unit fibre of each tetrahedron, matched by position if the order differs."""
    name = str(source.path)
    _, values, per_cell = _fibre_array(source)
    if per_cell:
        if source is not mesh:
            theirs = source.points[source.require(TETRAHEDRON, "tetrahedra")].mean(axis=1)
            ours = mesh.points[tetrahedra].mean(axis=1)
            values = values[_match_by_position(name, theirs, ours, "tetrahedra")]
        check_fibres(name, values, mesh.points, tetrahedra)
        length = np.linalg.norm(values, axis=1, keepdims=True)
        # unit vectors stay as they are, so that a heart that was written reads back equal
        return np.asarray(np.where(np.abs(length - 1) < 1e-12, values, values / length))
    used = np.unique(tetrahedra)
    row = _match_by_position(name, source.points, mesh.points[used], "vertices")
    at_vertex = np.zeros((len(mesh.points), 3))
    at_vertex[used] = values[row]
    check_fibres(name, at_vertex[used], mesh.points[used])
    # the mean axis of four vertices, as fibres have no sign
    return principal_axes(unit(at_vertex[tetrahedra]))


def _match_by_position(name: str, sources: Floats, targets: Floats, kind: str) -> Integers:
    """Rows (k,) of the sources (n, 3) that are at the targets (k, 3); positions in mm."""
    distance, row = cKDTree(sources).query(targets)
    tolerance = 1e-5 * float(np.ptp(targets, axis=0).max())  # room for single precision
    refuse(
        name,
        distance > tolerance,
        f"{kind} of the mesh have no fibre within {tolerance:.2g} mm (largest gap "
        f"{distance.max():.3g} mm)",
        "give fibres on the same mesh",
        targets,
    )
    return np.asarray(row, dtype=np.int64)


def region_labels(mesh: MeshFile, array: str = "region") -> Integers | None:
    """Labels of the tetrahedra (m,), if the mesh has this cell array; whole numbers."""
    if (values := mesh.cell_array(TETRAHEDRON, array)) is None:
        return None
    if values.ndim != 1 or not (np.isfinite(values) & (values == np.round(values))).all():
        raise InputError(
            f"{mesh.path}: the cell array '{array}' must hold one whole number a tetrahedron; "
            "correct or remove it"
        )
    return values.astype(np.int64)


def _sheets(mesh: MeshFile) -> Floats | None:
    if (values := mesh.cell_array(TETRAHEDRON, "sheet")) is None:
        return None
    name = f"{mesh.path} ('sheet')"
    if values.shape[1:] != (3,):
        raise InputError(f"{name}: sheets must be vectors of three numbers; correct or remove it")
    check_fibres(name, values, mesh.points, mesh.cells[TETRAHEDRON])
    return values


def _fibre_array(source: MeshFile) -> tuple[str, Floats, bool]:
    """Name and values of a file's array of directions, and whether it has one per tetrahedron."""
    candidates: dict[str, tuple[Floats, bool]] = {}
    of_cells = source.cell_data.get(TETRAHEDRON, {})
    for arrays, per_cell in ((source.point_data, False), (of_cells, True)):  # cells last: exact
        for key, values in arrays.items():
            if np.shape(values)[1:] == (3,) and key.lower() not in ("normals", "sheet"):
                candidates[key] = np.asarray(values, dtype=float), per_cell
    keys = [key for key in candidates if key.lower() in ARRAY_NAMES["fibres"]] or list(candidates)
    if len(keys) != 1:
        raise InputError(
            f"{source.path}: need one array of fibre directions (3 components); found "
            f"{', '.join(keys) or 'none'}; keep one, or name it 'fibre'"
        )
    return keys[0], *candidates[keys[0]]


def read_coordinates(mesh: MeshFile) -> VentricularCoordinates | None:
    """Ventricular coordinates of the vertices of a mesh's tetrahedra, if it has the point arrays.

    The arrays are ``tv``, ``tm``, ``rt`` (or ``rtSin`` and ``rtCos``) and ``ab`` of Cobiveco, or
    ``v``, ``rho``, ``phi`` and ``z`` of `from_universal`, in upper or lower case; all four. An
    error if one is not a number a point, or out of range.
    """
    arrays = {name.lower(): values for name, values in mesh.point_data.items()}
    used = np.unique(mesh.cells[TETRAHEDRON])
    if {"rtsin", "rtcos"} <= set(arrays) and "rt" not in arrays:
        arrays["rt"] = np.arctan2(arrays["rtsin"], arrays["rtcos"]) / (2 * np.pi) % 1
    names, universal = VentricularCoordinates.names, ("v", "rho", "phi", "z")
    if set(names) <= set(arrays):
        return VentricularCoordinates(*(_checked(mesh, arrays, used, name, 0, 1) for name in names))
    if not set(universal) <= set(arrays):
        return None
    limits = {"v": (-1, 1), "phi": (-np.pi, np.pi)}
    v, *rho_phi_z = (
        _checked(mesh, arrays, used, name, *limits.get(name, (0, 1))) for name in universal
    )
    if np.ptp(v) == 0:
        raise InputError(
            f"{mesh.path}: the point array 'v' of ventricular coordinates is {v[0]:g} everywhere; "
            "give -1 in the left and 1 in the right ventricle, or remove it"
        )
    return from_universal(v, *rho_phi_z)


def _checked(
    mesh: MeshFile, arrays: Mapping[str, Floats], used: Integers, name: str, low: float, high: float
) -> Floats:
    """Values of an array at the used points, clipped to its range; an error if far outside."""
    values, among = np.asarray(arrays[name], dtype=float), "to"
    if values.shape != (len(mesh.points),):
        raise InputError(
            f"{mesh.path}: the point array '{name}' has shape {values.shape}; ventricular "
            "coordinates are one number a point; correct or remove it"
        )
    values = values[used]
    slack = 1e-3 * (high - low)  # interpolation rounds
    bad = ~((values >= low - slack) & (values <= high + slack))
    if name in ("tv", "v"):
        bad, among = ~np.isin(values, (low, high)), "or"
    refuse(
        f"{mesh.path}: the point array '{name}' of ventricular coordinates",
        bad,
        f"values are not {low:.4g} {among} {high:.4g}, as {values[np.argmax(bad)]:.4g}",
        "correct them, or remove the array to have them computed",
        mesh.points[used],
        numbers=used,
    )
    return values.clip(low, high)


def from_universal(v: Floats, rho: Floats, phi: Floats, z: Floats) -> VentricularCoordinates:
    """Convert universal ventricular coordinates (n,) to those of Cobiveco.

    Universal coordinates are those of Bayer et al. 2018, Med Image Anal 45:83-93: v −1 in the left,
    1 in the right ventricle; ρ 0 on the endocardium, 1 on the epicardium; φ from −π to π in the
    left ventricle, to which the septum belongs, and in the right one from its posterior attachment
    to the anterior one; z 0 at the apex, 1 at the base. Their apex, the left ventricle's, is kept.
    """
    right = v > 0
    behind, before = phi[right].min(), phi[right].max()
    way = (phi - behind) / (before - behind)
    septal = ~right & (way >= 0) & (way <= 1)
    # in the left free wall from the anterior attachment on to the posterior one
    back = (phi - before) % (2 * np.pi) / (2 * np.pi - before + behind)
    return VentricularCoordinates(
        (right | (septal & (rho > 0.5))).astype(float),
        np.where(septal, np.abs(1 - 2 * rho), 1 - rho),
        np.where(septal, 1 - way / 3, 2 / 3 * np.where(right, way, 1 - back)),
        z,
    )
