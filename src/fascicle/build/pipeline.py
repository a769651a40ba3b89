"""From an anatomy to a heart in a torso: the stages, chained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.build.endocardia import endocardia
from fascicle.build.source import Anatomy, Source, read_anatomy
from fascicle.core.errors import InputError
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.conduction import Conduction
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.fibres.rules import FibreAngles, rule_based_fibres
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.seeds import ChosenSeed, choose_seeds
from fascicle.heart.validate import check_electrodes, check_tetrahedra
from fascicle.torso.body_size import BodySize
from fascicle.torso.electrode_sites import check_not_mirrored, check_on_skin, distances_to_skin
from fascicle.torso.heart_pose import Pose
from fascicle.torso.idealised import idealised_torso
from fascicle.torso.mesh import mesh_torso
from fascicle.torso.resolve import resolve_lead_fields
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
    height, weight, chest : float, optional
        Of the person, to scale the idealised torso (m, kg, cm).
    pose : {"standard", "ras", "lps"}
        See `fascicle.torso.heart_pose.body_frame`.
    electrodes : Path, optional
        File of positions; without it, they are at the standard places of the idealised torso.
    """

    torso: str = IDEALISED
    lungs: tuple[Path, ...] = ()
    height: float | None = None
    weight: float | None = None
    chest: float | None = None
    pose: Pose = "standard"
    electrodes: Path | None = None

    def __post_init__(self) -> None:
        if self.torso != IDEALISED and self.electrodes is None:
            raise InputError(
                f"--torso {self.torso}: electrodes are missing; give --electrodes (only the "
                "idealised torso has places for them)"
            )
        idle = [name for name in ("height", "weight", "chest") if getattr(self, name) is not None]
        if self.pose != "standard":
            idle.append("pose")
        if idle and self.torso != IDEALISED:
            raise InputError(
                f"--{idle[0]} goes with the idealised torso, not with --torso {self.torso}; leave "
                "it out"
            )
        if self.lungs and self.torso in (IDEALISED, NONE):
            raise InputError(f"--lung goes with a torso of your own, not with '{self.torso}'")
        self._check_before_meshing()

    def _check_before_meshing(self) -> None:
        """Refuse at once what would otherwise be found out after minutes."""
        files = [path for path in (self.electrodes, *self.lungs) if path is not None]
        if self.torso == IDEALISED:
            _ = self.build
        elif self.torso != NONE:
            files.append(Path(self.torso))
        for path in files:
            if not path.is_file():
                raise InputError(f"{path}: no such file (torso or electrodes); check the path")
        if self.electrodes is not None:
            read_electrodes(self.electrodes)

    @property
    def build(self) -> BodySize:
        """What the idealised torso is scaled by."""
        given = {"height": self.height, "weight": self.weight, "chest": self.chest}
        return BodySize(**{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True)
class BuiltHeart:
    """A heart, and what its builder should tell whoever asked for it.

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
        Told how far it is.

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
    return BuiltHeart(heart, anatomy, (*anatomy.notes, *_kept(anatomy)))


def _kept(anatomy: Anatomy) -> list[str]:
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
    """Fibres, endocardia and seeds of an anatomy; its electrodes are nowhere yet.

    See `build_heart` for the parameters.
    """
    mesh, seeds = anatomy.mesh, seeds if seeds is not None else {}
    fibres, sheets = anatomy.fibres, anatomy.sheets
    if fibres is None:
        ruled = rule_based_fibres(mesh, angles, stage_progress(progress, "fibres"))
        fibres, sheets = ruled.fibre, ruled.sheet
    lv, rv = endocardia(mesh)
    surfaces = {"lv": lv, "rv": rv}
    chosen = {
        side: choose_seeds(
            f"{mesh.name}: {side.upper()}",
            seeds.get(side, (None, None)),
            (ours.vertices, ours.triangles, ours.valve),
            theirs.vertices,
        )
        for side, ours, theirs in (("lv", lv, rv), ("rv", rv, lv))
    }
    left, right = (
        Endocardium(
            side, s.vertices, s.triangles, *chosen[side], s.valve if s.valve.any() else None
        )
        for side, s in surfaces.items()
    )
    nowhere = np.full((9, 3), np.nan)  # until the body is known
    return Heart(
        mesh.vertices, mesh.tetrahedra, fibres, left, right, nowhere, name, mesh.regions, sheets
    )


def in_body(
    heart: Heart, mesh: LabelledMesh, body: Body, progress: Progress | None = None
) -> Heart:
    """Put torso, electrodes and lead fields around a heart of this mesh."""
    surfaces = _surfaces(mesh, body)
    heart = replace(heart, electrodes=_electrodes(body, surfaces))
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


def _surfaces(mesh: LabelledMesh, body: Body) -> TorsoSurfaces | None:
    """Skin and lungs, in the heart's frame; None for an unbounded conductor."""
    if body.torso == NONE:
        return None
    if body.torso == IDEALISED:
        return idealised_torso(mesh, body.build, body.pose)
    return read_torso_surfaces(Path(body.torso), body.lungs, mesh)


def _electrodes(body: Body, surfaces: TorsoSurfaces | None) -> NDArray[np.float64]:
    if body.electrodes is not None:
        return read_electrodes(body.electrodes)
    if surfaces is None or surfaces.electrodes is None:
        raise ValueError("only the idealised torso has places for electrodes")
    return surfaces.electrodes
