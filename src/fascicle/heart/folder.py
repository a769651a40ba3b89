"""Heart folders: a `heart.toml` manifest, a tetrahedral mesh, two endocardia, nine electrodes."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_folder, check_folder, check_nothing_lost, user_cache
from fascicle.core.leads import ELECTRODES
from fascicle.heart.assembly import REGION, SHEET, VALVE, assemble_heart
from fascicle.heart.electrodes import write_electrodes
from fascicle.heart.heart import Heart
from fascicle.heart.manifest import MANIFEST, LeadFieldKeys, manifest_text, read_manifest
from fascicle.heart.torso import LeadFields
from fascicle.heart.torso_files import read_torso, write_torso
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, MeshFile
from fascicle.mesh.formats.read import read_mesh
from fascicle.mesh.formats.vtk import write_grid, write_surface

MESH, ELECTRODE_FILE, TORSO = "mesh.vtu", "electrodes.csv", "torso.vtu"
PICTURE = "check.png"  # of what the folder holds; whoever writes the folder may draw it
LABELS_PICTURE = "labels.png"  # of labels that were found from the shape
OWN_FILES = (
    MANIFEST, MESH, "lv_endocardium.vtp", "rv_endocardium.vtp", ELECTRODE_FILE, TORSO, PICTURE,
    LABELS_PICTURE,
)  # fmt: skip
DEFAULT_HEART = "default"
LEAD_FIELD = "lead_field_"  # point arrays, one an electrode


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
    manifest = read_manifest(folder)
    surfaces = {"lv": manifest.lv_endocardium, "rv": manifest.rv_endocardium}
    seeds = {"lv": manifest.lv, "rv": manifest.rv}
    mesh = read_mesh(folder / manifest.mesh, "mesh")
    heart = assemble_heart(
        mesh=mesh,
        fibres=None,
        surfaces={
            side: read_mesh(folder / file, f"{side.upper()} endocardium")
            for side, file in surfaces.items()
        },
        seeds={side: (points.root, points.direction) for side, points in seeds.items()},
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
            temporary / MESH,
            heart.vertices,
            heart.tetrahedra,
            TETRAHEDRON,
            point_data=points,
            cell_data=cells,
        )
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
        (temporary / MANIFEST).write_text(manifest_text(heart, files), encoding="utf-8")
