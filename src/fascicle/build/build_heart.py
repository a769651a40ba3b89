"""Build a heart from an anatomy: fibres, endocardia, torso, electrodes and lead fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fascicle.build.endocardia import endocardia
from fascicle.build.labelled_files import Anatomy
from fascicle.build.read_anatomy import Source, read_anatomy
from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, check_installed
from fascicle.core.leads import ADDITIONAL_LEADS, ELECTRODES, FRANK, FRANK_ELECTRODES
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.ranges import check_items
from fascicle.heart.conduction import Conduction
from fascicle.heart.coordinates import with_coordinates
from fascicle.heart.electrodes import Electrodes, check_electrodes, read_electrodes
from fascicle.heart.endocardium import ChosenSeed, seeded_endocardia
from fascicle.heart.fibres import FibreAngles, rule_based_fibres
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.checks import check_tetrahedra
from fascicle.torso.conductor import mesh_torso, torso_of
from fascicle.torso.electrode_sites import (
    additional_sites,
    check_not_exchanged,
    check_not_mirrored,
    check_on_skin,
)
from fascicle.torso.heart_pose import Pose, axes_of_electrodes, heart_axes
from fascicle.torso.idealised import FittedTrunk, fitted_torso, idealised_torso, leaving
from fascicle.torso.lead_fields import (
    contacts_on,
    is_up_to_date,
    outer_boundary,
    resolve_lead_fields,
)
from fascicle.torso.surfaces import Surface, TorsoSurfaces, read_torso_surfaces
from fascicle.torso.trunk import TRUNK_SHAPE, TrunkSize, outside_trunk

Seeds = Mapping[str, tuple[ChosenSeed, ChosenSeed]]


@dataclass(frozen=True)
class TorsoOptions:
    """Choice of torso and electrodes around a heart."""

    torso: str = "idealised"  # or "none" (unbounded conductor), or the file of a closed skin
    lungs: tuple[Path, ...] = ()  # files of closed surfaces, with a custom skin
    # "height" (m), "weight" (kg) and "chest" girth (cm) of the idealised torso; any may be missing
    measures: Mapping[str, float] = field(default_factory=dict)
    pose: Pose = "standard"
    # file of positions, to which the idealised torso is fitted; without it, its standard sites
    electrodes: Path | None = None

    def __post_init__(self) -> None:
        if self.torso != "idealised":
            if self.electrodes is None:
                raise InputError(
                    f"--torso {self.torso}: electrodes are missing; give --electrodes (only the "
                    "idealised torso has places for them)"
                )
            if self.measures or self.pose != "standard":
                option = "--pose" if not self.measures else "--height, --weight or --chest"
                raise InputError(
                    f"{option} goes with the idealised torso, not with --torso {self.torso}; leave "
                    "it out"
                )
        skin = () if self.torso in ("idealised", "none") else (Path(self.torso),)
        if self.lungs and not skin:
            raise InputError(f"--lung goes with a custom torso, not with '{self.torso}'")
        # checked here, so that an error does not come only after minutes of work
        for path in (*skin, *self.lungs):
            if not path.is_file():
                raise InputError(f"{path}: no such file (torso); check the path")
        TrunkSize(**self.measures)
        _ = self.positions

    @cached_property
    def positions(self) -> tuple[Floats, Electrodes] | None:
        """The nine standard electrodes (9, 3), mm, and others, of the electrode file, if any."""
        return None if self.electrodes is None else read_electrodes(self.electrodes)


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

    Fibres of the source take precedence over rule-based ones of the given angles. Seeds are, by
    side, the root of the bundle and a point that it heads for; by default they follow from the
    anatomy. InputError if the anatomy or the torso cannot be used.
    """
    check_installed("pyvista", "building a heart")
    anatomy = read_anatomy(source, edge_length, progress)
    check_tetrahedra(anatomy.mesh.name, anatomy.mesh.vertices, anatomy.mesh.tetrahedra)
    heart = heart_of(anatomy, angles, seeds, name, progress)
    heart, coordinate_notes = with_coordinates(
        heart, anatomy.mesh, stage_progress(progress, "coordinates")
    )
    heart, notes = in_torso(heart, anatomy.mesh, torso or TorsoOptions(), progress)
    kept = []  # properties of the source that override options
    if anatomy.own_mesh:
        kept.append("mesh: as in the file, whose edge length was kept")
    if anatomy.fibres is not None:
        kept.append("fibres: those of the file; no rule was applied")
    return BuiltHeart(heart, anatomy, (*anatomy.notes, *kept, *coordinate_notes, *notes))


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
        rule_based = rule_based_fibres(mesh, angles, stage_progress(progress, "fibres"))
        fibres, sheets = rule_based.fibre, rule_based.sheet
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


def in_torso(
    heart: Heart, mesh: LabelledMesh, options: TorsoOptions, progress: Progress | None = None
) -> tuple[Heart, tuple[str, ...]]:
    """Place a heart in a torso with electrodes, which replace the heart's, and lead fields.

    The mesh is the heart's, with a labelled boundary. Notes describe how the torso was fitted.
    """
    source = str(options.electrodes) if options.electrodes is not None else mesh.name
    notes: tuple[str, ...] = ()
    surfaces: TorsoSurfaces | None = None
    if options.positions is not None:
        positions, others = options.positions
    else:
        surfaces = idealised_torso(mesh, TrunkSize(**options.measures), options.pose)
        assert surfaces.electrodes is not None
        positions, others = surfaces.electrodes, {}
    heart = replace(heart, electrodes=positions, additional_electrodes=others)
    check_electrodes(source, heart)
    check_not_mirrored(source, heart)
    if surfaces is None and options.torso == "idealised":
        check_not_exchanged(source, heart)
        surfaces, fitted = fitted_torso(mesh, positions, source, options.measures, options.pose)
        notes = tuple(_notes_on_fit(heart, fitted, options.pose))
    elif options.torso not in ("idealised", "none"):
        surfaces = read_torso_surfaces(Path(options.torso), options.lungs, mesh)
    if surfaces is None:
        return heart, notes
    check_on_skin(heart, contacts_on(*surfaces.skin, heart.electrode_positions).moved, source)
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs, stage_progress(progress, "torso"))
    heart = replace(heart, torso=torso)
    fields = resolve_lead_fields(heart, Conduction(), stage_progress(progress, "lead fields"))
    return replace(heart, lead_fields=fields), notes


def add_electrodes(
    heart: Heart | Path | str, leads: Sequence[str], progress: Progress | None = None
) -> Heart:
    """Add the electrodes of leads other than the standard twelve, at their standard sites.

    The heart, given as such, as its folder or as ``"default"``, is returned with lead fields for
    all electrodes. A heart stored without its torso, such as the packaged one, is put into the
    idealised torso again. Its other electrodes do not move. Leads are some of
    `fascicle.core.leads.ADDITIONAL_LEADS`: ``X``, ``Y``, ``Z``, ``V7`` to ``V9``, ``V2R`` to
    ``V6R``. InputError if a lead has no standard site, or the heart lies in an unbounded conductor.
    """
    heart = as_heart(heart)
    check_items(leads, str, "leads", f"some of {', '.join(ADDITIONAL_LEADS)}")
    for lead in leads:
        if lead not in ADDITIONAL_LEADS:
            raise InputError(
                f"lead {lead}: its electrodes have no standard place (known: "
                f"{', '.join(ADDITIONAL_LEADS)}); give their positions in the heart's "
                "electrodes.csv"
            )
    if not heart.has_torso:
        raise InputError(
            f"{heart.name}: it lies in an unbounded conductor, without a skin for electrodes; give "
            "their positions in its electrodes.csv, or build it again with a torso"
        )
    names = [name for name in dict.fromkeys(leads) if name not in FRANK]
    names += FRANK_ELECTRODES if set(leads) & set(FRANK) else ()
    names = [name for name in names if name not in heart.additional_electrodes]
    torso = torso_of(heart, stage_progress(progress, "torso"))
    tetrahedra = np.concatenate([heart.tetrahedra, torso.tetrahedra])
    skin = Surface(torso.vertices, outer_boundary(torso.vertices, tetrahedra))
    size = TrunkSize()
    axes = axes_of_electrodes(heart.electrodes, leaving(outside_trunk(size), size))
    electrodes = dict(heart.additional_electrodes) | additional_sites(heart, axes, skin, names)
    extended = replace(heart, torso=torso, additional_electrodes=electrodes, folder=None)
    conduction, report = Conduction.of(heart), stage_progress(progress, "lead fields")
    fields = resolve_lead_fields(extended, conduction, report)
    if fields is not None and heart.lead_fields and is_up_to_date(heart, conduction):
        # the lead fields of existing electrodes are kept, as remeshing changes the torso a little
        old_values = heart.lead_fields.values
        fields = replace(
            fields, values=np.concatenate([old_values, fields.values[len(old_values) :]])
        )
    return replace(extended, lead_fields=fields)


def _notes_on_fit(heart: Heart, fitted: FittedTrunk, pose: Pose) -> list[str]:
    """Notes on the fit of the trunk to the electrodes: size, pose, and distances by electrode."""
    size = fitted.size
    lv, rv = (Surface(e.vertices, e.triangles) for e in heart.endocardia)
    # direction from base to apex in the torso frame
    left, back, up = -fitted.frame.rotation.T @ heart_axes(lv, rv)[:, 2]
    azimuth, descent = np.degrees(np.arctan2(left, -back)), np.degrees(np.arcsin(-up))
    shape = ", ".join(f"{name} {getattr(size, name):.2f}" for name in TRUNK_SHAPE)
    axes = "from the electrodes" if pose == "standard" else f"{pose.upper()}, tilted to fit them"
    displacements = fitted.electrodes - fitted.sites
    return [
        f"torso: fitted to the electrodes; height {100 * size.height:.0f} cm, chest "
        f"{size.girth:.0f} cm; times the standard adult's: {shape}",
        f"pose: {axes}; the apex points {azimuth:.0f} degrees to the left and {descent:.0f} down",
        "electrodes: how far the skin was moved to each, and how far each is from its standard "
        "site, mm",
        f"{'':<5}{'skin':>6}{'left':>7}{'back':>7}{'up':>7}",
        *(
            f"{electrode:<5}{moved:6.1f}" + "".join(f"{value:7.0f}" for value in np.round(vector))
            for electrode, moved, vector in zip(
                ELECTRODES, fitted.moved, displacements, strict=True
            )
        ),
    ]
