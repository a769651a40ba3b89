"""What depends on a heart alone: computed once, kept on disk beside it, keyed by its content."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, atomic_path
from fascicle.core.progress import Progress, stage_progress
from fascicle.forward.ecg.action_potential import ActionPotential
from fascicle.forward.ecg.electrocardiogram import Electrocardiograph, build_electrocardiograph
from fascicle.forward.ecg.lead_field import nodal_gradients, unbounded_gradients
from fascicle.forward.eikonal.myocardium import Myocardium, build_myocardium, find_on_surface
from fascicle.heart.conduction import Conduction
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.kernels.arrays import EikonalMesh, TravelTimeTable
from fascicle.mesh.measures import barycentric_gradients
from fascicle.purkinje.chart import Chart, build_chart
from fascicle.purkinje.growth import Seed, find_seed
from fascicle.torso.lead_fields import resolve_lead_fields

FORMAT = 4  # of the files; another number makes them anew
ONCE = "once per heart"
KEPT = 4  # files in a heart's cache; the oldest go
HEART_ARRAYS = ("vertices", "tetrahedra", "fibres", "electrodes")


@dataclass(frozen=True)
class Prepared:
    """Everything about a heart that the forward model needs.

    Attributes
    ----------
    charts, seeds : dict of side to Chart and to Seed
        Maps of the endocardia, and where the bundles start.
    myocardium : Myocardium
        The myocardium for the coupled eikonal problem.
    electrocardiograph : Electrocardiograph
        The ECG integral.
    """

    charts: dict[str, Chart]
    seeds: dict[str, Seed]
    myocardium: Myocardium
    electrocardiograph: Electrocardiograph


def prepare(
    heart: Heart,
    conduction: Conduction,
    action_potential: ActionPotential,
    progress: Progress | None = None,
) -> Prepared:
    """Prepare a heart, or read what was prepared before.

    A heart that was read from a folder has its cache there, if the folder can be written to. The
    key is the content of heart and conduction and the version of this package.

    Parameters
    ----------
    heart, conduction, action_potential : Heart, Conduction, ActionPotential
        What the forward model is made of.
    progress : Progress, optional
        Progress callback for what takes a while.
    """
    if heart.folder is None or not os.access(heart.folder, os.W_OK):
        return build(heart, conduction, action_potential, progress)
    content = f"{version('fascicle')} {FORMAT} {heart.digest} {conduction}"
    path = heart.folder / DISPOSABLE / f"{hashlib.sha256(content.encode()).hexdigest()[:32]}.npz"
    try:
        return load(path, heart, action_potential)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        prepared = build(heart, conduction, action_potential, progress)  # not there, or damaged
    # somebody else's cache, a full disk, or another process tidying up: only this cache is lost
    with suppress(OSError, InputError):
        save(path, prepared)
        kept = sorted(path.parent.glob("*.npz"), key=lambda file: file.stat().st_mtime)
        for old in kept[:-KEPT]:
            old.unlink(missing_ok=True)
    return prepared


def build(
    heart: Heart,
    conduction: Conduction,
    action_potential: ActionPotential,
    progress: Progress | None = None,
) -> Prepared:
    """Prepare a heart; see `prepare`, which looks whether that was done before.

    Parameters
    ----------
    heart, conduction, action_potential, progress
        As there.
    """
    charts = {e.side: build_chart(e) for e in heart.endocardia}
    scale = conduction.scale(heart)
    barycentric = barycentric_gradients(heart.vertices, heart.tetrahedra)
    electrocardiograph = build_electrocardiograph(
        heart.tetrahedra,
        barycentric,
        heart.volumes,
        scale[:, None, None] * conduction.intracellular(heart.fibres),
        _lead_field_gradients(heart, conduction, barycentric, progress),
        action_potential,
    )
    report = stage_progress(progress, "preparation", ONCE)
    myocardium = build_myocardium(heart, conduction, report, barycentric)
    return Prepared(charts, _seeds(heart, charts), myocardium, electrocardiograph)


def _lead_field_gradients(
    heart: Heart, conduction: Conduction, barycentric: Floats, progress: Progress | None
) -> Floats:
    """Mean ∇Z of each electrode in each tetrahedron (kΩ/mm), shape (9, m, 3)."""
    fields = resolve_lead_fields(heart, conduction, stage_progress(progress, "lead fields", ONCE))
    if fields is not None:
        return nodal_gradients(fields.values, heart.tetrahedra, barycentric)
    return unbounded_gradients(heart.vertices, heart.tetrahedra, heart.electrodes, conduction.torso)


def _seeds(heart: Heart, charts: dict[str, Chart]) -> dict[str, Seed]:
    return {e.side: find_seed(e, charts[e.side]) for e in heart.endocardia}


def save(path: Path, prepared: Prepared, heart: Heart | None = None) -> None:
    """Write the arrays, and those of the heart if it is given, whole or not at all.

    Parameters
    ----------
    path : Path
        NPZ file.
    prepared : Prepared
        What is written.
    heart : Heart, optional
        The heart it was prepared from, if that is to be read back, too (`load_with_heart`).
    """
    myocardium, ecg = prepared.myocardium, prepared.electrocardiograph
    arrays: dict[str, NDArray[np.generic]] = {
        f"mesh.{name}": np.asarray(value) for name, value in myocardium.mesh._asdict().items()
    }
    for name, value in myocardium.travel_times._asdict().items():
        arrays[f"travel_times.{name}"] = np.asarray(value)
    for name in ("order", "conducts", "surface", "owner"):
        arrays[f"myocardium.{name}"] = getattr(myocardium, name)
    for name in ("corners", "weights"):
        arrays[f"ecg.{name}"] = getattr(ecg, name)
    for side, chart in prepared.charts.items():
        for name in ("points", "neighbours", "metric"):
            arrays[f"{side}.{name}"] = getattr(chart, name)
    if heart is not None:
        for name in HEART_ARRAYS:
            arrays[f"heart.{name}"] = getattr(heart, name)
        for endocardium in heart.endocardia:
            for name in ("vertices", "triangles", "root", "direction"):
                arrays[f"{endocardium.side}.{name}"] = np.asarray(getattr(endocardium, name))
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays)


def load(path: Path, heart: Heart, action_potential: ActionPotential) -> Prepared:
    """Read what `save` wrote for this heart.

    Parameters
    ----------
    path : Path
        NPZ file.
    heart, action_potential : Heart, ActionPotential
        What it was prepared for.
    """
    return _prepared(_arrays(path), heart, action_potential)


def load_with_heart(path: Path, action_potential: ActionPotential) -> tuple[Heart, Prepared]:
    """Read a file that `save` wrote with the heart in it."""
    arrays = _arrays(path)
    endocardia = [
        Endocardium(
            side,
            arrays[f"{side}.vertices"],
            arrays[f"{side}.triangles"],
            int(arrays[f"{side}.root"]),
            int(arrays[f"{side}.direction"]),
        )
        for side in ("lv", "rv")
    ]
    lv, rv = endocardia
    vertices, tetrahedra, fibres, electrodes = (arrays[f"heart.{name}"] for name in HEART_ARRAYS)
    heart = Heart(vertices, tetrahedra, fibres, lv, rv, electrodes)
    return heart, _prepared(arrays, heart, action_potential)


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _fields(arrays: dict[str, NDArray[Any]], prefix: str, names: Iterable[str]) -> dict[str, Any]:
    """Fields of a named tuple; an array without dimensions is a number."""
    found = {name: arrays[f"{prefix}.{name}"] for name in names}
    return {name: value if value.ndim else float(value) for name, value in found.items()}


def _prepared(
    arrays: dict[str, NDArray[Any]], heart: Heart, action_potential: ActionPotential
) -> Prepared:
    charts = {
        e.side: Chart(
            arrays[f"{e.side}.points"],
            e.vertices,
            e.triangles,
            arrays[f"{e.side}.neighbours"],
            arrays[f"{e.side}.metric"],
        )
        for e in heart.endocardia
    }
    mesh = EikonalMesh(**_fields(arrays, "mesh", EikonalMesh._fields))
    surface = arrays["myocardium.surface"]
    myocardium = Myocardium(
        mesh,
        TravelTimeTable(**_fields(arrays, "travel_times", TravelTimeTable._fields)),
        arrays["myocardium.order"],
        arrays["myocardium.conducts"],
        surface,
        arrays["myocardium.owner"],
        find_on_surface(mesh.vertices, surface),
    )
    electrocardiograph = Electrocardiograph(
        arrays["ecg.corners"], arrays["ecg.weights"], action_potential
    )
    return Prepared(charts, _seeds(heart, charts), myocardium, electrocardiograph)
