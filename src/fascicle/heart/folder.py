"""Heart folders: a `heart.toml` manifest, a tetrahedral mesh, two endocardia, electrodes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from fascicle.core import above
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, given_in
from fascicle.core.files import (
    PACKAGED,
    as_path,
    atomic_folder,
    check_folder,
    check_nothing_lost,
    named_by,
    packaged_heart,
    read_toml,
    user_cache,
)
from fascicle.core.parameters import complete
from fascicle.core.quantities import SPEED, check_not_twice, checked, region_labels
from fascicle.heart.action_potential import read_action_potential, write_action_potential
from fascicle.heart.assembly import assemble_heart
from fascicle.heart.atlas import read_atlas, write_atlas
from fascicle.heart.conduction import Conduction, Region
from fascicle.heart.electrodes import write_electrodes
from fascicle.heart.heart import Heart, LeadFields, Torso, TorsoTissue
from fascicle.mesh.checks import refuse
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.mesh_file import TETRAHEDRON, TRIANGLE, MeshFile
from fascicle.mesh.read import read_mesh
from fascicle.mesh.vtk import write_grid

# Files of a heart folder, which may be replaced: the manifest, the files by its keys, and pictures,
# where the command that wrote the folder drew them, of the heart and of labels found from its shape
HEART_FILES = {
    "manifest": "heart.toml",
    "mesh": "mesh.vtu",
    "lv_endocardium": "lv_endocardium.vtu",
    "rv_endocardium": "rv_endocardium.vtu",
    "electrodes": "electrodes.csv",
    "torso": "torso.vtu",
    "action_potential": "action_potential.csv",
    "atlas": "atlas.npz",
    "check": "check.png",
    "labels": "labels.png",
}
# files of a heart's folder, with the former names of endocardia
REPLACED = {*HEART_FILES.values(), "lv_endocardium.vtp", "rv_endocardium.vtp"}


class Seeds(BaseModel, extra="forbid"):
    """Vertices of an endocardium: where its bundle starts, and where it heads for."""

    root: int
    direction: int


class LeadFieldKeys(BaseModel, extra="forbid"):
    """Keys of heart and torso of the mesh's lead fields; see `fascicle.torso.lead_fields`."""

    heart: str
    torso: str


class Manifest(BaseModel, extra="forbid"):
    """Contents of `heart.toml`; file names are relative to the folder."""

    format: Literal["fascicle heart 1"]
    name: str
    units: Literal["mm"]
    mesh: str
    lv_endocardium: str
    rv_endocardium: str
    electrodes: str
    torso: str | None = None
    action_potential: str | None = None
    atlas: str | None = None
    lead_fields: LeadFieldKeys | None = None
    lv: Seeds
    rv: Seeds
    values: dict[str, Any] = {}
    example: dict[str, Any] = {}


def as_heart(heart: Heart | Path | str) -> Heart:
    """A heart as it is, or read from its folder; an error if it is neither."""
    if isinstance(heart, Heart):
        return heart
    return load_heart(as_path(heart, "heart", "a heart, its folder, or 'default'"))


def load_heart(
    path: Path | str,
    *,
    sex: str | None = None,
    age: float | None = None,
    height: float | None = None,
    weight: float | None = None,
) -> Heart:
    """Load and validate a heart folder.

    Parameters
    ----------
    path : path
        The folder, or the name of a packaged heart: ``"default"``, an idealised one,
        ``"camps-dti004"``, one subject's (Camps et al. 2024, Med Image Anal,
        doi:10.1016/j.media.2024.103361) with coarser elements, or ``"atlas"``, hearts of the
        population for a person of whom there is no image.
    sex : str, optional
        ``"f"`` or ``"m"``. This and the following are what is known of the person; only the atlas
        uses it.
    age, height, weight : float, optional
        Age (years), height (cm) and weight (kg).

    Raises
    ------
    InputError
        If anything about it would make the physics wrong; the message names file and remedy.
    """
    person = {"sex": sex, "age": age, "height": height, "weight": weight}
    if any(value is not None for value in person.values()):
        of_person: Heart = above("atlas.population").for_person(load_heart(path), person)
        return of_person
    folder = as_path(path, "heart")
    if (packaged := packaged_heart(path)) is not None:
        heart = load_heart(packaged)
        cache = user_cache() / "hearts" / str(path)  # a package may be read-only
        with suppress(OSError):  # the user's cache may be read-only, too; then nothing is stored
            cache.mkdir(parents=True, exist_ok=True)
        return replace(heart, folder=cache)
    manifest, path = _read_manifest(folder), folder / HEART_FILES["manifest"]
    surfaces = {"lv": manifest.lv_endocardium, "rv": manifest.rv_endocardium}
    bundles = {"lv": manifest.lv, "rv": manifest.rv}
    mesh = read_mesh(named_by(path, manifest.mesh), "mesh")
    heart = assemble_heart(
        mesh=mesh,
        fibres=None,
        surfaces={
            side: read_mesh(named_by(path, file), f"{side.upper()} endocardium")
            for side, file in surfaces.items()
        },
        seeds={side: (bundle.root, bundle.direction) for side, bundle in bundles.items()},
        electrodes=named_by(path, manifest.electrodes),
        name=manifest.name,
    )
    torso = None
    if manifest.torso is not None:
        torso = read_torso(named_by(path, manifest.torso), heart.vertices)
    lead_fields = None
    if manifest.lead_fields is not None:
        keys = manifest.lead_fields
        lead_fields = LeadFields(_read_lead_fields(mesh, heart), keys.heart, keys.torso)
    table = None
    if manifest.action_potential is not None:
        table = read_action_potential(named_by(path, manifest.action_potential))
    atlas = None
    if manifest.atlas is not None:
        atlas = read_atlas(named_by(path, manifest.atlas))
    values = _patient_values(path, manifest.values, heart)
    with given_in(path):
        example = complete(manifest.example) if manifest.example else {}
    return replace(
        heart,
        torso=torso,
        lead_fields=lead_fields,
        values=values,
        action_potential=table,
        example=example,
        atlas=atlas,
        folder=folder,
    )


def _read_manifest(folder: Path) -> Manifest:
    path = folder / HEART_FILES["manifest"]
    if not path.is_file():
        fault = "not a heart folder (no heart.toml)" if folder.exists() else "no such heart folder"
        packaged = f"give one of the package ({', '.join(PACKAGED)})"
        raise InputError(f"{folder}: {fault}; make one with 'fascicle heart build', or {packaged}")
    try:
        return Manifest.model_validate(read_toml(path, "import the heart again"))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{path}: '{key}': {first['msg']}; correct it or import the heart again"
        ) from None


def _patient_values(path: Path, values: dict[str, Any], heart: Heart) -> dict[str, float]:
    """Values of the patient; an error if there is no such property of the tissue or region."""
    with given_in(path):
        properties = checked(values)
        check_not_twice(properties)
        regions = region_labels(properties)
        for label, name in regions.items():
            Region(properties[name], label).elements(heart)
        for name in properties:
            # `Conduction.with_values` looks at these only; others would have no effect
            if name not in (*Conduction.velocities, *SPEED, *regions.values()):
                raise InputError(f"'{name}' is not a property of the tissue; leave it out")
        return properties


def _read_lead_fields(mesh: MeshFile, heart: Heart) -> Floats:
    """Lead fields (e, n) from the mesh's point arrays; electrodes added later may lack theirs."""
    used = np.unique(mesh.cells[TETRAHEDRON])
    rows = []
    for k, electrode in enumerate(heart.electrode_names):
        array = mesh.point_data.get(f"lead_field_{electrode}", np.empty(0))
        if k >= len(heart.electrodes) and not array.size:
            break  # the electrode was added later
        if array.shape != (len(mesh.points),) or not np.isfinite(array[used]).all():
            raise InputError(
                f"{mesh.path}: the point array 'lead_field_{electrode}' is missing or not finite; "
                "build the heart again, or take 'lead_fields' out of heart.toml to have them "
                "computed"
            )
        rows.append(array[used])
    return np.array(rows, dtype=float)


def read_torso(path: Path, heart_vertices: Floats) -> Torso:
    """Read the torso around a heart's vertices (n, 3) (mm); refuse a damaged or a wrong one."""
    mesh = read_mesh(path, "torso")
    tetrahedra = mesh.require(TETRAHEDRON, "tetrahedra")
    tissues = mesh.cell_data[TETRAHEDRON].get("tissue", np.empty(0))
    labels = " or ".join(f"{tissue.value} ({tissue.name.lower()})" for tissue in TorsoTissue)
    count = len(heart_vertices)
    remedy = "build the heart's torso again"
    other = not np.array_equal(mesh.points[:count], heart_vertices)
    for bad, fault in (
        (tissues.shape != (len(tetrahedra),), "no cell array 'tissue' with a label each"),
        (not np.isin(tissues, list(TorsoTissue)).all(), f"a tissue that is not {labels}"),
        (other, f"its first {count} points are not the heart's"),
    ):
        if bad:
            raise InputError(f"{path}: {fault}; {remedy}")
    inverted = signed_volumes(mesh.points, tetrahedra) <= 0
    fault = "tetrahedra are flat or inverted"
    refuse(str(path), inverted, fault, remedy, mesh.points, tetrahedra)
    return Torso(mesh.points, tetrahedra, tissues.astype(np.int64))


def check_heart_folder(folder: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse a folder that a heart cannot be written to, before the work of building it.

    The folder must not hold a file that is not part of a heart, nor one of the inputs that the
    heart is made of. A heart folder's own files are replaced.
    """
    check_folder(folder)
    for path in inputs:
        if folder.resolve() in path.resolve().parents:
            raise InputError(
                f"{folder}: holds the input {path.name}, which would be lost; give another --out"
            )
    check_nothing_lost(folder, REPLACED)


def write_heart(heart: Heart, folder: Path) -> None:
    """Write a heart folder, whole or not at all."""
    check_heart_folder(folder)
    with atomic_folder(folder, disposable=REPLACED) as temporary:
        files = {key: temporary / file for key, file in HEART_FILES.items()}
        write_grid(files["mesh"], *heart_mesh(heart))
        for e in heart.endocardia:
            valves = {} if e.valves is None else {"valve": e.valves.astype(int)}
            file = files[f"{e.side}_endocardium"]
            write_grid(file, e.vertices, e.triangles, TRIANGLE, cell_data=valves)
        write_electrodes(files["electrodes"], heart.electrodes, heart.additional_electrodes)
        if heart.torso is not None:
            write_torso(files["torso"], heart.torso)
        if heart.action_potential is not None:
            write_action_potential(files["action_potential"], heart.action_potential)
        if heart.atlas is not None:
            write_atlas(heart.atlas, files["atlas"])
        files["manifest"].write_text(_manifest_text(heart), encoding="utf-8")


def _manifest_text(heart: Heart) -> str:
    content: dict[str, Any] = {
        "format": "fascicle heart 1",
        # characters that cannot be UTF-8 (odd bytes in a path) become '?'
        "name": heart.name.encode("utf-8", "replace").decode("utf-8"),
        "units": "mm",
        **{key: file for key, file in HEART_FILES.items() if key in Manifest.model_fields},
    }
    for optional in ("torso", "action_potential", "atlas"):
        if getattr(heart, optional) is None:
            del content[optional]
    if heart.lead_fields is not None:
        keys = heart.lead_fields
        content["lead_fields"] = {"heart": keys.key, "torso": keys.torso}
    for e in heart.endocardia:
        content[e.side] = {"root": e.root, "direction": e.direction}
    content |= {key: dict(v) for key in ("values", "example") if (v := getattr(heart, key))}
    lines = []
    for key, value in content.items():
        table = isinstance(value, dict)
        lines += ["", f"[{key}]"] if table else []
        for name, item in (value if table else {key: value}).items():
            text = json.dumps(item, ensure_ascii=False) if isinstance(item, str) else repr(item)
            lines.append(f"{name} = " + text.replace("\x7f", "\\u007f"))
    return "\n".join(lines) + "\n"


def write_torso(path: Path, torso: Torso) -> None:
    """Write a torso as VTU, with its tissues as the cell array ``tissue``."""
    tissues = {"tissue": torso.tissues.astype(np.float64)}
    write_grid(path, torso.vertices, torso.tetrahedra, TETRAHEDRON, cell_data=tissues)


def heart_mesh(heart: Heart) -> Any:
    """Points, cells and their kind, point arrays and cell arrays of a heart, for `write_grid`."""
    points: dict[str, NDArray[Any]] = {}
    if heart.lead_fields is not None:
        # an electrode that was added later has no lead field
        fields = zip(heart.electrode_names, heart.lead_fields.values, strict=False)
        points = {f"lead_field_{electrode}": values for electrode, values in fields}
    if heart.coordinates is not None:
        places = heart.coordinates.arrays.items()
        points |= {name: values.astype(np.float32) for name, values in places}
    return heart.vertices, heart.tetrahedra, TETRAHEDRON, points, cell_arrays(heart)


def cell_arrays(heart: Heart) -> dict[str, NDArray[Any]]:
    """Fibres, regions and sheets of the tetrahedra, by the names of their arrays in files."""
    arrays = {"fibre": heart.fibres, "region": heart.regions, "sheet": heart.sheets}
    return {name: values for name, values in arrays.items() if values is not None}
