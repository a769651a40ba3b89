"""Heart folders: a `heart.toml` manifest, a tetrahedral mesh, two endocardia, nine electrodes."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError
from scipy.spatial import cKDTree

from fascicle.core.cache import user_cache
from fascicle.core.errors import InputError
from fascicle.core.files import atomic_folder, check_folder, check_nothing_lost
from fascicle.core.leads import ELECTRODES
from fascicle.heart.electrodes import read_electrodes, write_electrodes
from fascicle.heart.endocardium import Endocardium, oriented_into_cavity
from fascicle.heart.fibres.directions import average_to_tetrahedra, match_by_position
from fascicle.heart.heart import Heart
from fascicle.heart.seeds import ChosenSeed, choose_seeds
from fascicle.heart.torso import LeadFields
from fascicle.heart.torso_files import read_torso, write_torso
from fascicle.heart.validate import (
    check_electrodes,
    check_endocardium_in_place,
    check_fibres,
    check_tetrahedra,
    check_units,
)
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.formats.vtk import write_grid, write_surface
from fascicle.mesh.topology import without_unused_vertices

MANIFEST = "heart.toml"
TORSO = "torso.vtu"
PICTURE = "check.png"  # of what the folder holds; whoever writes the folder may draw it
LABELS_PICTURE = "labels.png"  # of labels that were found from the shape
OWN_FILES = (
    MANIFEST, "mesh.vtu", "lv_endocardium.vtp", "rv_endocardium.vtp", "electrodes.csv", TORSO,
    PICTURE, LABELS_PICTURE,
)  # fmt: skip
DEFAULT_HEART = "default"
FORMAT = "fascicle heart 1"
REGION = "region"  # cell array of labels
SHEET = "sheet"  # cell array of directions
VALVE = "valve"  # cell array of an endocardium: 1 where it spans a valve opening
LEAD_FIELD = "lead_field_"  # point arrays, one an electrode
FIBRE_NAMES = ("fibre", "fibres", "fiber", "fibers", "f0", "fiber_direction", "fibre_direction")

OTHERS = ("normals", SHEET)  # arrays of directions that are not fibres


class Seeds(BaseModel):
    """Where one bundle starts and heads for: vertices of its endocardium."""

    model_config = ConfigDict(extra="forbid")
    root: int
    direction: int


class LeadFieldKeys(BaseModel):
    """What the lead fields in the mesh were computed from; see `fascicle.torso.resolve`."""

    model_config = ConfigDict(extra="forbid")
    heart: str
    torso: str


class Manifest(BaseModel):
    """Contents of `heart.toml`; file names are relative to the folder."""

    model_config = ConfigDict(extra="forbid")
    format: Literal["fascicle heart 1"]
    name: str
    units: Literal["mm"]
    mesh: str
    lv_endocardium: str
    rv_endocardium: str
    electrodes: str
    torso: str | None = None
    lead_fields: LeadFieldKeys | None = None
    lv: Seeds
    rv: Seeds


def load_heart(path: Path | str) -> Heart:
    """Load and validate a heart folder.

    Parameters
    ----------
    path : path
        The folder, or ``"default"`` for the packaged heart.

    Raises
    ------
    InputError
        If anything about it would make the physics wrong; the message names file and remedy.
    """
    if str(path) == DEFAULT_HEART and not Path(path).exists():
        with resources.as_file(resources.files("fascicle") / "data" / "default_heart") as packaged:
            heart = load_heart(packaged)
        folder = user_cache() / "default_heart"  # a package is no place to write to
        with suppress(OSError):  # nor is every home; then nothing is kept
            folder.mkdir(parents=True, exist_ok=True)
        return replace(heart, folder=folder)
    folder = Path(path)
    manifest = _read_manifest(folder)
    sides = {
        side: (folder / getattr(manifest, f"{side}_endocardium"), getattr(manifest, side))
        for side in ("lv", "rv")
    }
    mesh = read_mesh(folder / manifest.mesh, "mesh")
    heart = assemble_heart(
        mesh=mesh,
        fibres=None,
        surfaces={
            side: read_mesh(file, f"{side.upper()} endocardium")
            for side, (file, _) in sides.items()
        },
        seeds={side: (seeds.root, seeds.direction) for side, (_, seeds) in sides.items()},
        electrodes=folder / manifest.electrodes,
        name=manifest.name,
    )
    torso = read_torso(folder / manifest.torso, heart) if manifest.torso is not None else None
    lead_fields = _lead_fields(mesh, manifest.lead_fields)
    return replace(heart, folder=folder, torso=torso, lead_fields=lead_fields)


def _lead_fields(mesh: MeshFile, keys: LeadFieldKeys | None) -> LeadFields | None:
    """Lead fields that stand in the mesh file, if the manifest says what they are."""
    if keys is None:
        return None
    used = np.unique(mesh.cells[TETRAHEDRON])
    values = np.full((len(ELECTRODES), len(used)), np.nan)
    for row, electrode in zip(values, ELECTRODES, strict=True):
        array = mesh.point_data.get(f"{LEAD_FIELD}{electrode}")
        if array is not None and array.shape == (len(mesh.points),):
            row[:] = array[used]
        if not np.isfinite(row).all():
            raise InputError(
                f"{mesh.path}: the point array '{LEAD_FIELD}{electrode}' is missing or not finite; "
                f"build the heart again, or take 'lead_fields' out of {MANIFEST} to have them "
                "computed"
            )
    return LeadFields(values, keys.heart, keys.torso)


def _read_manifest(folder: Path) -> Manifest:
    path = folder / MANIFEST
    if not folder.exists():
        raise InputError(f"{folder}: no such heart folder; make one with 'fascicle heart build'")
    if not path.is_file():
        raise InputError(
            f"{folder}: not a heart folder (no {MANIFEST}); make one with 'fascicle heart build'"
        )
    try:
        return Manifest.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{path}: '{key}': {first['msg']}; correct it or import the heart again"
        ) from None
    except (ValueError, RecursionError) as error:  # of TOML, of UTF-8, of a number too long
        raise InputError(f"{path}: not valid TOML ({error}); import the heart again") from None


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
    check_units(str(mesh.path), mesh.points)
    direction = _fibres_per_tetrahedron(mesh, tetrahedra, fibres if fibres is not None else mesh)
    vertices, tetrahedra = without_unused_vertices(mesh.points, tetrahedra)
    check_tetrahedra(str(mesh.path), vertices, tetrahedra)
    opened = {side: _surface(side, surface) for side, surface in surfaces.items()}
    for side, (points, _) in opened.items():
        check_endocardium_in_place(f"{surfaces[side].path}", points, vertices)
    _check_two_surfaces(surfaces, opened)
    endocardia = {}
    for side, other in (("lv", "rv"), ("rv", "lv")):
        points, triangles = opened[side]
        valves = _valves(surfaces[side])
        found = choose_seeds(
            f"{surfaces[side].path}: {side.upper()}",
            seeds[side],
            (points, triangles, valves),
            opened[other][0],
        )
        endocardia[side] = Endocardium(side, points, triangles, *found, valves)
    heart = Heart(
        vertices=vertices,
        tetrahedra=tetrahedra,
        fibres=direction,
        lv=endocardia["lv"],
        rv=endocardia["rv"],
        electrodes=read_electrodes(electrodes),
        name=name,
        regions=_regions(mesh),
        sheets=_sheets(mesh),
    )
    check_electrodes(str(electrodes), heart.electrodes, heart)
    return heart


def _check_two_surfaces(
    surfaces: dict[str, MeshFile], opened: dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]
) -> None:
    apart = cKDTree(opened["rv"][0]).query(opened["lv"][0])[0]
    if float(np.median(apart)) == 0:
        raise InputError(
            f"{surfaces['lv'].path}: the LV and the RV endocardium are the same surface; "
            "give one for each ventricle"
        )


def _surface(side: str, surface: MeshFile) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
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
    return surface.points, oriented_into_cavity(surface.points, triangles, name)


def _fibres_per_tetrahedron(
    mesh: MeshFile, tetrahedra: NDArray[np.int64], source: MeshFile
) -> NDArray[np.float64]:
    """Find the unit fibre of each tetrahedron, matched by position if the order differs."""
    name = str(source.path)
    values, per_cell = _fibre_array(source)
    if per_cell:
        theirs = source.points[source.require(TETRAHEDRON, "tetrahedra")].mean(axis=1)
        ours = mesh.points[tetrahedra].mean(axis=1)
        row = match_by_position(name, theirs, ours, "tetrahedra")
        values = values[row]
        check_fibres(name, values)
        length = np.linalg.norm(values, axis=1, keepdims=True)
        # a fibre of unit length to rounding stays as it is: a written heart reads back equal
        return np.asarray(np.where(np.abs(length - 1) < 1e-12, values, values / length))
    used = np.unique(tetrahedra)
    row = match_by_position(name, source.points, mesh.points[used], "vertices")
    at_vertex = np.zeros((len(mesh.points), 3))
    at_vertex[used] = values[row]
    check_fibres(name, at_vertex[used])
    at_vertex[at_vertex.any(axis=1) == 0] = [1.0, 0.0, 0.0]  # points that no tetrahedron uses
    return average_to_tetrahedra(at_vertex, tetrahedra)


def _regions(mesh: MeshFile) -> NDArray[np.int64] | None:
    """Labels of the tetrahedra, if the mesh has the cell array `region`."""
    values = mesh.cell_data.get(TETRAHEDRON, {}).get(REGION)
    if values is None:
        return None
    labels = np.asarray(values, dtype=float)
    if labels.ndim != 1 or not (labels == np.round(labels)).all():
        raise InputError(
            f"{mesh.path}: the cell array '{REGION}' must hold one whole number a tetrahedron; "
            "correct or remove it"
        )
    return labels.astype(np.int64)


def _sheets(mesh: MeshFile) -> NDArray[np.float64] | None:
    """Sheet directions of the tetrahedra, if the mesh has the cell array `sheet`."""
    values = mesh.cell_data.get(TETRAHEDRON, {}).get(SHEET)
    if values is None:
        return None
    check_fibres(f"{mesh.path} ('{SHEET}')", np.asarray(values, dtype=float))
    return np.asarray(values, dtype=float)


def _valves(surface: MeshFile) -> NDArray[np.bool_] | None:
    """Which triangles span a valve opening, if the surface has the cell array `valve`."""
    values = surface.cell_data.get(TRIANGLE, {}).get(VALVE)
    return None if values is None else np.asarray(values, dtype=float) != 0


def _fibre_array(source: MeshFile) -> tuple[NDArray[np.float64], bool]:
    """Find the array of directions in a file, and whether it is one per tetrahedron."""
    candidates: dict[str, tuple[Any, bool]] = {}
    for arrays, per_cell in (
        (source.cell_data.get(TETRAHEDRON, {}), True),
        (source.point_data, False),
    ):
        for key, values in arrays.items():
            if np.ndim(values) == 2 and np.shape(values)[1] == 3 and key.lower() not in OTHERS:
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


def _toml_string(text: str) -> str:
    """TOML string of a name; what cannot be UTF-8 (odd bytes in a path) becomes '?'."""
    readable = text.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(readable, ensure_ascii=False).replace("\x7f", "\\u007f")


def check_heart_folder(folder: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse a folder that a heart cannot be written to, before the work of building it.

    Parameters
    ----------
    folder : Path
        May be a heart folder already; its files are then replaced.
    inputs : iterable of Path
        Files that the heart is made of, which must not be among them.

    Raises
    ------
    InputError
        If something of somebody else's would be lost, or nothing can be written there.
    """
    check_folder(folder)
    for path in inputs:
        if folder.resolve() in path.resolve().parents:
            raise InputError(
                f"{folder}: holds the input {path.name}, which would be lost; give another --out"
            )
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    if not (folder / MANIFEST).exists():
        raise InputError(
            f"{folder}: holds files and is no heart folder (no {MANIFEST}); give another --out"
        )
    check_nothing_lost(folder, OWN_FILES)


def write_heart(heart: Heart, folder: Path) -> None:
    """Write a heart folder, whole or not at all."""
    check_heart_folder(folder)
    cells: dict[str, NDArray[Any]] = {"fibre": heart.fibres}
    if heart.regions is not None:
        cells[REGION] = heart.regions
    if heart.sheets is not None:
        cells[SHEET] = heart.sheets
    points: dict[str, NDArray[Any]] = {}
    if heart.lead_fields is not None:
        for electrode, values in zip(ELECTRODES, heart.lead_fields.values, strict=True):
            points[f"{LEAD_FIELD}{electrode}"] = values
    with atomic_folder(folder, disposable=OWN_FILES) as temporary:
        write_grid(
            temporary / "mesh.vtu",
            heart.vertices,
            heart.tetrahedra,
            TETRAHEDRON,
            point_data=points,
            cell_data=cells,
        )
        lines = [
            f'format = "{FORMAT}"',
            f"name = {_toml_string(heart.name)}",
            'units = "mm"',
            'mesh = "mesh.vtu"',
        ]
        for endocardium in heart.endocardia:
            file = f"{endocardium.side}_endocardium.vtp"
            valves = {} if endocardium.valves is None else {VALVE: endocardium.valves.astype(int)}
            write_surface(
                temporary / file, endocardium.vertices, endocardium.triangles, cell_data=valves
            )
            lines.append(f'{endocardium.side}_endocardium = "{file}"')
        write_electrodes(temporary / "electrodes.csv", heart.electrodes)
        lines.append('electrodes = "electrodes.csv"')
        if heart.torso is not None:
            write_torso(temporary / TORSO, heart.torso)
            lines.append(f'torso = "{TORSO}"')
        if heart.lead_fields is not None:
            keys = f'heart = "{heart.lead_fields.key}", torso = "{heart.lead_fields.torso}"'
            lines.append(f"lead_fields = {{ {keys} }}")
        for endocardium in heart.endocardia:
            lines += [
                "",
                f"[{endocardium.side}]  # points of the endocardium",
                f"root = {endocardium.root}",
                f"direction = {endocardium.direction}",
            ]
        (temporary / MANIFEST).write_text("\n".join(lines) + "\n", encoding="utf-8")
