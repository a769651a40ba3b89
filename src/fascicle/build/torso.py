"""What surrounds a heart: its torso, electrodes and lead fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.core.progress import Progress, stage_progress
from fascicle.heart.conduction import Conduction
from fascicle.heart.electrodes import read_electrodes
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.heart.validate import check_electrodes
from fascicle.torso.electrode_sites import check_not_exchanged, check_not_mirrored, check_on_skin
from fascicle.torso.heart_pose import Pose, apex_direction
from fascicle.torso.idealised import FittedTrunk, fitted_torso, idealised_torso
from fascicle.torso.lead_fields import contacts_on, resolve_lead_fields
from fascicle.torso.mesh import mesh_torso
from fascicle.torso.surfaces import Surface, TorsoSurfaces, read_torso_surfaces
from fascicle.torso.trunk import SHAPE, TrunkSize


@dataclass(frozen=True)
class TorsoOptions:
    """What surrounds the heart.

    Attributes
    ----------
    torso : str
        ``"idealised"``, ``"none"`` (unbounded conductor), or the file of a closed skin surface.
    lungs : tuple of Path
        Closed surfaces of the lungs, with a custom skin.
    measures : mapping of name to float
        Height (m), weight (kg) and chest girth (cm), as far as they are known, to scale the
        idealised torso.
    pose : {"standard", "ras", "lps"}
        See `fascicle.torso.heart_pose.torso_frame`.
    electrodes : Path, optional
        Positions that the idealised torso is fitted to; by default those of its standard places.
    """

    torso: str = "idealised"
    lungs: tuple[Path, ...] = ()
    measures: Mapping[str, float] = field(default_factory=dict)
    pose: Pose = "standard"
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
        # refused now rather than after minutes of work
        for path in (*skin, *self.lungs):
            if not path.is_file():
                raise InputError(f"{path}: no such file (torso); check the path")
        TrunkSize(**self.measures)
        _ = self.positions

    @cached_property
    def positions(self) -> Floats | None:
        """Electrodes of the file (9, 3) (mm), if there is one."""
        return None if self.electrodes is None else read_electrodes(self.electrodes)


def in_torso(
    heart: Heart, mesh: LabelledMesh, options: TorsoOptions, progress: Progress | None = None
) -> tuple[Heart, tuple[str, ...]]:
    """Place a heart in a torso with electrodes and lead fields; electrodes it has are replaced.

    The mesh is the heart's, with a labelled boundary. Notes describe how the torso was fitted.
    """
    source = str(options.electrodes) if options.electrodes is not None else mesh.name
    notes: tuple[str, ...] = ()
    surfaces: TorsoSurfaces | None = None
    positions = options.positions
    if positions is None:
        surfaces = idealised_torso(mesh, TrunkSize(**options.measures), options.pose)
        positions = surfaces.electrodes
        assert positions is not None
    heart = replace(heart, electrodes=positions)
    check_electrodes(source, positions, heart)
    check_not_mirrored(source, heart)
    if surfaces is None and options.torso == "idealised":
        check_not_exchanged(source, heart)
        surfaces, fitted = fitted_torso(mesh, positions, source, options.measures, options.pose)
        notes = tuple(_notes_on_fit(heart, fitted, options.pose))
    elif options.torso not in ("idealised", "none"):
        surfaces = read_torso_surfaces(Path(options.torso), options.lungs, mesh)
    if surfaces is None:
        return heart, notes
    check_on_skin(source, contacts_on(*surfaces.skin, heart.electrodes).moved)
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs, stage_progress(progress, "torso"))
    heart = replace(heart, torso=torso)
    fields = resolve_lead_fields(heart, Conduction(), stage_progress(progress, "lead fields"))
    return replace(heart, lead_fields=fields), notes


def _notes_on_fit(heart: Heart, fitted: FittedTrunk, pose: Pose) -> list[str]:
    """Notes on how the trunk was fitted to the electrodes, as a whole and for each."""
    size = fitted.size
    lv, rv = (Surface(e.vertices, e.triangles) for e in heart.endocardia)
    azimuth, descent = apex_direction(fitted.frame.rotation, lv, rv)
    shape = ", ".join(f"{name} {getattr(size, name):.2f}" for name in SHAPE)
    axes = "from the electrodes" if pose == "standard" else f"{pose.upper()}, tilted to fit them"
    off = fitted.electrodes - fitted.sites
    return [
        f"torso: fitted to the electrodes; height {size.height:.2f} m, chest {size.girth:.0f} cm; "
        f"times the standard adult's: {shape}",
        f"pose: {axes}; the apex points {azimuth:.0f} degrees to the left and {descent:.0f} down",
        "electrodes: how far the skin was moved to each, and how far each is from its standard "
        "site, mm",
        f"{'':<5}{'skin':>6}{'left':>7}{'back':>7}{'up':>7}",
        *(
            f"{electrode:<5}{moved:6.1f}" + "".join(f"{value:7.0f}" for value in np.round(vector))
            for electrode, moved, vector in zip(ELECTRODES, fitted.moved, off, strict=True)
        ),
    ]
