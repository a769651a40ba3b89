"""From an anatomy to a heart in a torso: the stages, chained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fascicle.build.anatomy import Anatomy, Source
from fascicle.build.endocardia import endocardia
from fascicle.build.read_anatomy import read_anatomy
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.conduction import Conduction
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.fibres.rules import FibreAngles, rule_based_fibres
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.seeds import ChosenSeed, seeded_endocardia
from fascicle.heart.validate import check_electrodes, check_tetrahedra
from fascicle.torso.body_size import BodySize
from fascicle.torso.electrode_sites import check_not_mirrored, check_on_skin, distances_to_skin
from fascicle.torso.heart_pose import Pose
from fascicle.torso.idealised import idealised_torso
from fascicle.torso.lead_fields import resolve_lead_fields
from fascicle.torso.mesh import mesh_torso
from fascicle.torso.surface_files import read_torso_surfaces
from fascicle.torso.surfaces import TorsoSurfaces

IDEALISED, NONE = "idealised", "none"

Seeds = Mapping[str, tuple[ChosenSeed, ChosenSeed]]


@dataclass(frozen=True)
class Body:
    """What surrounds the heart.

    Attributes
    ----------
    torso : str
        ``"idealised"``, ``"none"`` (unbounded conductor), or the file of a closed skin surface.
    lungs : tuple of Path
        Closed surfaces, with a skin of the user's own.
    size : BodySize, optional
        Of the person, to scale the idealised torso.
    pose : {"standard", "ras", "lps"}
        See `fascicle.torso.heart_pose.body_frame`.
    electrodes : Path, optional
        File of positions; without it, they are at the standard places of the idealised torso.
    """

    torso: str = IDEALISED
    lungs: tuple[Path, ...] = ()
    size: BodySize | None = None
    pose: Pose = "standard"
    electrodes: Path | None = None

    def __post_init__(self) -> None:
        if self.torso != IDEALISED:
            if self.electrodes is None:
                raise InputError(
                    f"--torso {self.torso}: electrodes are missing; give --electrodes (only the "
                    "idealised torso has places for them)"
                )
            if self.size is not None or self.pose != "standard":
                option = "--pose" if self.size is None else "--height, --weight or --chest"
                raise InputError(
                    f"{option} goes with the idealised torso, not with --torso {self.torso}; leave "
                    "it out"
                )
        if self.lungs and self.torso in (IDEALISED, NONE):
            raise InputError(f"--lung goes with a torso of your own, not with '{self.torso}'")
        # what would otherwise be found out after minutes is refused at once
        skin = () if self.torso in (IDEALISED, NONE) else (Path(self.torso),)
        for path in (*skin, *self.lungs):
            if not path.is_file():
                raise InputError(f"{path}: no such file (torso); check the path")
        _ = self.positions

    @cached_property
    def positions(self) -> Floats | None:
        """Electrodes of the file (9, 3) (mm), if there is one."""
        return None if self.electrodes is None else read_electrodes(self.electrodes)


@dataclass(frozen=True)
class BuiltHeart:
    """A heart, and what to say about how it was made.

    Attributes
    ----------
    heart : Heart
        Ready to simulate.
    anatomy : Anatomy
        What it was made of.
    notes : tuple of str
        What was decided on the way, for people.
    """

    heart: Heart
    anatomy: Anatomy
    notes: tuple[str, ...] = ()


def build_heart(
    source: Source,
    *,
    edge_length: float = 2.0,
    angles: FibreAngles | None = None,
    body: Body | None = None,
    seeds: Seeds | None = None,
    name: str = "heart",
    progress: Progress | None = None,
) -> BuiltHeart:
    """Build a simulation-ready heart from an anatomy.

    Parameters
    ----------
    source : Source
        Surface, surfaces, segmentation or mesh.
    edge_length : float
        Mean edge of the tetrahedra (mm).
    angles : FibreAngles, optional
        Of the rule-based fibres; fibres that the source has are kept.
    body : Body, optional
        Torso and electrodes.
    seeds : mapping of side to (root, direction), optional
        Where bundles start and head for; found from the anatomy where not given.
    name : str
        What to call the heart.
    progress : Progress, optional
        Progress callback.

    Raises
    ------
    InputError
        If the anatomy or the body cannot be used; the message says why.
    """
    body = body if body is not None else Body()
    anatomy = read_anatomy(source, edge_length, progress)
    check_tetrahedra(anatomy.mesh.name, anatomy.mesh.vertices, anatomy.mesh.tetrahedra)
    heart = heart_of(anatomy, angles, seeds, name, progress)
    heart = in_body(heart, anatomy.mesh, body, progress)
    return BuiltHeart(heart, anatomy, (*anatomy.notes, *_notes_on_what_was_kept(anatomy)))


def _notes_on_what_was_kept(anatomy: Anatomy) -> list[str]:
    """What the source had already, so that options about it do nothing."""
    notes = []
    if anatomy.own_mesh:
        notes.append("mesh: as in the file; the edge length is its own")
    if anatomy.fibres is not None:
        notes.append("fibres: those of the file; no rule was applied")
    return notes


def heart_of(
    anatomy: Anatomy,
    angles: FibreAngles | None = None,
    seeds: Seeds | None = None,
    name: str = "heart",
    progress: Progress | None = None,
) -> Heart:
    """Fibres, endocardia and seeds of an anatomy; its electrodes are not placed yet (NaN).

    Parameters
    ----------
    anatomy : Anatomy
        The labelled mesh.
    angles, seeds, name, progress
        As in `build_heart`.
    """
    mesh, seeds = anatomy.mesh, seeds if seeds is not None else {}
    fibres, sheets = anatomy.fibres, anatomy.sheets
    if fibres is None:
        ruled = rule_based_fibres(mesh, angles, stage_progress(progress, "fibres"))
        fibres, sheets = ruled.fibre, ruled.sheet
    surfaces = {
        side: (mesh.name, own.vertices, own.triangles, own.valve if own.valve.any() else None)
        for side, own in zip(("lv", "rv"), endocardia(mesh), strict=True)
    }
    chosen = {side: seeds.get(side, (None, None)) for side in surfaces}
    left, right = seeded_endocardia(surfaces, chosen)
    unplaced = np.full((len(ELECTRODES), 3), np.nan)
    heart = Heart(mesh.vertices, mesh.tetrahedra, fibres, left, right, unplaced, name)
    return replace(heart, regions=mesh.regions, sheets=sheets, values=anatomy.values)


def in_body(
    heart: Heart, mesh: LabelledMesh, body: Body, progress: Progress | None = None
) -> Heart:
    """Put torso, electrodes and lead fields around a heart.

    Parameters
    ----------
    heart : Heart
        Its electrodes do not count.
    mesh : LabelledMesh
        Its tetrahedra, with their boundary labelled.
    body : Body
        What surrounds it.
    progress : Progress, optional
        Progress callback.
    """
    surfaces = _torso_surfaces(mesh, body)
    positions = body.positions
    if positions is None and surfaces is not None:
        positions = surfaces.electrodes
    if positions is None:
        raise ValueError("only the idealised torso has places for electrodes")
    heart = replace(heart, electrodes=positions)
    source = str(body.electrodes) if body.electrodes is not None else mesh.name
    check_electrodes(source, heart.electrodes, heart)
    check_not_mirrored(source, heart)
    if surfaces is None:
        return heart
    check_on_skin(source, distances_to_skin(heart.electrodes, surfaces.skin))
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs, stage_progress(progress, "torso"))
    heart = replace(heart, torso=torso)
    fields = resolve_lead_fields(heart, Conduction(), stage_progress(progress, "lead fields"))
    return replace(heart, lead_fields=fields)


def _torso_surfaces(mesh: LabelledMesh, body: Body) -> TorsoSurfaces | None:
    """Skin and lungs, in the heart's frame; None for an unbounded conductor."""
    if body.torso == NONE:
        return None
    if body.torso == IDEALISED:
        return idealised_torso(mesh, body.size if body.size is not None else BodySize(), body.pose)
    return read_torso_surfaces(Path(body.torso), body.lungs, mesh)
