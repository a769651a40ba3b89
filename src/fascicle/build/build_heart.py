"""From an anatomy to a heart in a torso: the stages, chained."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fascicle.build.endocardia import endocardia
from fascicle.build.labelled_files import Anatomy
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.build.torso import TorsoOptions, in_torso
from fascicle.core.leads import ELECTRODES
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.coordinates import with_coordinates
from fascicle.heart.endocardium import ChosenSeed, seeded_endocardia
from fascicle.heart.fibres import FibreAngles, rule_based_fibres
from fascicle.heart.heart import Heart
from fascicle.heart.validate import check_tetrahedra

Seeds = Mapping[str, tuple[ChosenSeed, ChosenSeed]]


class BuiltHeart(NamedTuple):
    """A heart, the anatomy that it was built from, and notes for the user."""

    heart: Heart
    anatomy: Anatomy
    notes: tuple[str, ...]


def build_heart(
    source: Source,
    *,
    edge_length: float = 2.0,
    angles: FibreAngles | None = None,
    torso: TorsoOptions | None = None,
    seeds: Seeds | None = None,
    name: str = "heart",
    progress: Progress | None = None,
) -> BuiltHeart:
    """Build a simulation-ready heart from an anatomy, meshed with a mean edge length (mm).

    Fibres of the source take precedence over the angles of rule-based ones. Seeds (by side, root
    and direction) are where each bundle starts and heads; by default the anatomy decides. An error
    if the anatomy or the torso cannot be used.
    """
    anatomy = read_anatomy(source, edge_length, progress)
    check_tetrahedra(anatomy.mesh.name, anatomy.mesh.vertices, anatomy.mesh.tetrahedra)
    heart = heart_of(anatomy, angles, seeds, name, progress)
    heart, located = with_coordinates(heart, anatomy.mesh, stage_progress(progress, "coordinates"))
    heart, notes = in_torso(heart, anatomy.mesh, torso or TorsoOptions(), progress)
    kept = []  # properties of the source that override options
    if anatomy.own_mesh:
        kept.append("mesh: as in the file, whose edge length was kept")
    if anatomy.fibres is not None:
        kept.append("fibres: those of the file; no rule was applied")
    return BuiltHeart(heart, anatomy, (*anatomy.notes, *kept, *located, *notes))


def heart_of(
    anatomy: Anatomy,
    angles: FibreAngles | None = None,
    seeds: Seeds | None = None,
    name: str = "heart",
    progress: Progress | None = None,
) -> Heart:
    """Heart with fibres, endocardia and seeds of an anatomy; electrodes are not placed (NaN)."""
    mesh, fibres, sheets = anatomy.mesh, anatomy.fibres, anatomy.sheets
    if fibres is None:
        ruled = rule_based_fibres(mesh, angles, stage_progress(progress, "fibres"))
        fibres, sheets = ruled.fibre, ruled.sheet
    surfaces = {
        side: (mesh.name, e.vertices, e.triangles, e.valve if e.valve.any() else None)
        for side, e in zip(("lv", "rv"), endocardia(mesh), strict=True)
    }
    chosen = {side: (seeds or {}).get(side, (None, None)) for side in surfaces}
    left, right = seeded_endocardia(surfaces, chosen)
    unplaced = np.full((len(ELECTRODES), 3), np.nan)
    return Heart(
        mesh.vertices, mesh.tetrahedra, fibres, left, right, unplaced, name,
        regions=mesh.regions, sheets=sheets, values=anatomy.values, coordinates=anatomy.coordinates,
    )  # fmt: skip
