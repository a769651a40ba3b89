"""Heart folders: a `heart.toml` manifest, a tetrahedral mesh, two endocardia, nine electrodes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from fascicle.core.errors import InputError
from fascicle.core.files import (
    as_path,
    atomic_folder,
    check_folder,
    check_nothing_lost,
    named_by,
    read_toml,
    user_cache,
)
from fascicle.core.leads import ELECTRODES
from fascicle.core.quantities import SPEED, check_one_speed, checked, region_labels
from fascicle.heart.assembly import REGION, SHEET, VALVE, assemble_heart
from fascicle.heart.conduction import SPEEDS, Region
from fascicle.heart.electrodes import write_electrodes
from fascicle.heart.heart import Heart
from fascicle.heart.torso import LeadFields, read_torso, write_torso
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, MeshFile
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.formats.vtk import write_grid, write_surface

MANIFEST = "heart.toml"
FORMAT = "fascicle heart 1"
MESH, ELECTRODE_FILE, TORSO = "mesh.vtu", "electrodes.csv", "torso.vtu"
PICTURE = "check.png"  # of what the folder holds; whoever writes the folder may draw it
LABELS_PICTURE = "labels.png"  # of labels that were found from the shape
OWN_FILES = (
    MANIFEST, MESH, "lv_endocardium.vtp", "rv_endocardium.vtp", ELECTRODE_FILE, TORSO, PICTURE,
    LABELS_PICTURE,
)  # fmt: skip
DEFAULT_HEART = "default"
LEAD_FIELD = "lead_field_"  # point arrays, one an electrode


class _Strict(BaseModel):
    """Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid")


class Seeds(_Strict):
    """Where one bundle starts and heads for: vertices of its endocardium."""

    root: int
    direction: int


class LeadFieldKeys(_Strict):
    """What the lead fields in the mesh were computed from; see `fascicle.torso.lead_fields`."""

    heart: str
    torso: str


class Manifest(_Strict):
    """Contents of `heart.toml`; file names are relative to the folder."""

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
    values: dict[str, Any] = {}


def as_heart(given: Heart | Path | str) -> Heart:
    """A heart as it was given, or read from its folder.

    Raises
    ------
    InputError
        If it is neither, or the folder cannot be used.
    """
    if isinstance(given, Heart):
        return given
    return load_heart(as_path(given, "heart", "a heart, its folder, or 'default'"))


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
    given = as_path(path, "heart")
    if str(path) == DEFAULT_HEART and not given.exists():
        with resources.as_file(resources.files("fascicle") / "data" / "default_heart") as packaged:
            heart = load_heart(packaged)
        folder = user_cache() / "default_heart"  # a package is no place to write to
        with suppress(OSError):  # nor is every home; then nothing is kept
            folder.mkdir(parents=True, exist_ok=True)
        return replace(heart, folder=folder)
    folder = given
    manifest, path = _read_manifest(folder), folder / MANIFEST
    surfaces = {"lv": manifest.lv_endocardium, "rv": manifest.rv_endocardium}
    seeds = {"lv": manifest.lv, "rv": manifest.rv}
    mesh = read_mesh(named_by(path, manifest.mesh), "mesh")
    heart = assemble_heart(
        mesh=mesh,
        fibres=None,
        surfaces={
            side: read_mesh(named_by(path, file), f"{side.upper()} endocardium")
            for side, file in surfaces.items()
        },
        seeds={side: (points.root, points.direction) for side, points in seeds.items()},
        electrodes=named_by(path, manifest.electrodes),
        name=manifest.name,
    )
    torso = None
    if manifest.torso is not None:
        torso = read_torso(named_by(path, manifest.torso), heart.vertices)
    lead_fields = _lead_fields(mesh, manifest.lead_fields)
    values = _patient_values(path, manifest.values, heart)
    return replace(heart, folder=folder, torso=torso, lead_fields=lead_fields, values=values)


def _read_manifest(folder: Path) -> Manifest:
    path = folder / MANIFEST
    if not folder.exists():
        raise InputError(f"{folder}: no such heart folder; make one with 'fascicle heart build'")
    if not path.is_file():
        raise InputError(
            f"{folder}: not a heart folder (no {MANIFEST}); make one with 'fascicle heart build'"
        )
    values = read_toml(path, "import the heart again")
    try:
        return Manifest.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{path}: '{key}': {first['msg']}; correct it or import the heart again"
        ) from None


def _patient_values(path: Path, values: dict[str, Any], heart: Heart) -> dict[str, float]:
    """The patient's values, of quantities that there are, and of regions that there are."""
    try:
        found = checked(values)
        check_one_speed(found)
        regions = region_labels(found)
        for label, name in regions.items():
            Region(found[name], label).elements(heart)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    for name in found:
        # all that `Conduction.with_values` looks at; anything else would count for nothing
        if name not in (*SPEEDS, *SPEED, *regions.values()):
            raise InputError(f"{path}: '{name}' is no property of the tissue; leave it out")
    return found


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
        If a file that is not part of a heart would be lost, or nothing can be written there.
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
    with atomic_folder(folder, disposable=OWN_FILES) as temporary:
        write_mesh(heart, temporary / MESH)
        files = {"mesh": MESH}
        for endocardium in heart.endocardia:
            file = files[f"{endocardium.side}_endocardium"] = f"{endocardium.side}_endocardium.vtp"
            valves = {} if endocardium.valves is None else {VALVE: endocardium.valves.astype(int)}
            write_surface(
                temporary / file, endocardium.vertices, endocardium.triangles, cell_data=valves
            )
        files["electrodes"] = ELECTRODE_FILE
        write_electrodes(temporary / ELECTRODE_FILE, heart.electrodes)
        if heart.torso is not None:
            files["torso"] = TORSO
            write_torso(temporary / TORSO, heart.torso)
        (temporary / MANIFEST).write_text(_manifest_text(heart, files), encoding="utf-8")


def _manifest_text(heart: Heart, files: dict[str, str]) -> str:
    """Text of the manifest of a heart whose parts are in these files."""
    lines = [f'format = "{FORMAT}"', f"name = {_toml_string(heart.name)}", 'units = "mm"']
    lines += [f'{part} = "{file}"' for part, file in files.items()]
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
    if heart.values:
        lines += ["", "[values]  # of this patient; 'fascicle parameters' lists what there is"]
        lines += [f"{name} = {value!r}" for name, value in heart.values.items()]
    return "\n".join(lines) + "\n"


def _toml_string(text: str) -> str:
    """TOML string of a name; what cannot be UTF-8 (odd bytes in a path) becomes '?'."""
    readable = text.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(readable, ensure_ascii=False).replace("\x7f", "\\u007f")


def write_mesh(heart: Heart, path: Path) -> None:
    """Write the tetrahedra and every array of a heart as one VTU file (mm)."""
    points: dict[str, NDArray[Any]] = {}
    if heart.lead_fields is not None:
        for electrode, values in zip(ELECTRODES, heart.lead_fields.values, strict=True):
            points[f"{LEAD_FIELD}{electrode}"] = values
    write_grid(path, heart.vertices, heart.tetrahedra, TETRAHEDRON, points, cell_arrays(heart))


def cell_arrays(heart: Heart) -> dict[str, NDArray[Any]]:
    """Fibres, regions and sheets of the tetrahedra, by the names of their arrays in files."""
    arrays = {"fibre": heart.fibres, REGION: heart.regions, SHEET: heart.sheets}
    return {name: values for name, values in arrays.items() if values is not None}
