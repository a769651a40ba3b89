"""An adult trunk with lungs and electrodes, from height, weight and girth, around a given heart.

Skin (`fascicle.torso.trunk`) and lungs (`fascicle.torso.lungs`) are level sets of smooth functions
in the body frame of `fascicle.torso.heart_pose`.

Sources
-------
Standard adult : mean of the reference man (1.76 m, 73 kg) and the reference woman (1.63 m, 60 kg)
    of ICRP Publication 89 (Valentin 2002, Ann ICRP 32(3-4)).
Girth : Heinz et al. 2003, J Stat Educ 11(2): 247 men and 260 women of 1.71 m, 69.1 kg and 93.3 cm
    on average. A cylinder's girth goes with the square root of weight by height, and so do these.
Skin to heart : Rahko 2008, J Am Soc Echocardiogr 21:761-764 (parasternal 32 mm, apical 31 mm).
Heart : the valves' surface projections put the middle of the LV base half an intercostal space
    above the fourth, and the apex into the fifth, at the midclavicular line.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.measures import solid_centroid
from fascicle.torso.body_size import BodySize
from fascicle.torso.electrode_sites import standard_electrodes
from fascicle.torso.enclosure import check_within
from fascicle.torso.fit import FARTHEST, FittedTrunk, fit_trunk
from fascicle.torso.heart_pose import (
    BodyFrame,
    Pose,
    axes_of_electrodes,
    body_frame,
    check_apex,
    default_position,
    opening,
)
from fascicle.torso.lungs import convex_hull, exclusion_hull, lungs_of
from fascicle.torso.surfaces import Surface, TorsoSurfaces, signed_distance
from fascicle.torso.trunk import (
    Deformation,
    identity,
    outside_trunk,
    skin_of,
    smooth_max,
    trunk,
    trunk_box,
)

SKIN_MARGIN = 5.0  # mm that must remain between heart and skin
NEAR_HEART = 4 * SKIN_MARGIN  # within which a fitted skin keeps clear of the heart


def idealised_torso(
    mesh: LabelledMesh, body: BodySize | None = None, pose: Pose = "standard"
) -> TorsoSurfaces:
    """Put an idealised adult torso around a heart, which stays where it is.

    Parameters
    ----------
    mesh : LabelledMesh
        The heart (mm).
    body : BodySize, optional
        Height, weight and girth; those of a standard adult if not given.
    pose : {"standard", "ras", "lps"}
        Where the body's axes come from, see `fascicle.torso.heart_pose.body_frame`.

    Raises
    ------
    InputError
        If the heart does not fit into that torso, leaves no room for the lungs, or is not closed.
    """
    body = body if body is not None else BodySize()
    frame = frame_around(mesh, body, pose)
    skin = trunk(body)
    electrodes = frame.to_heart(standard_electrodes(body, skin))
    return _around(mesh, body, frame, skin, electrodes)


def fitted_torso(
    mesh: LabelledMesh,
    electrodes: Floats,
    name: str,
    known: Mapping[str, float],
    pose: Pose = "standard",
) -> tuple[TorsoSurfaces, FittedTrunk]:
    """Put an idealised torso around a heart on whose skin given electrodes lie.

    Parameters
    ----------
    mesh : LabelledMesh
        The heart (mm).
    electrodes : (9, 3) array
        In the heart's coordinates (mm), in the order of `fascicle.core.leads.ELECTRODES`.
    name : str
        What to call them in an error.
    known : mapping of name to float
        Measures of the person, arguments of `BodySize`, which are kept.
    pose : {"standard", "ras", "lps"}
        Whether the body's axes follow from the electrodes, or are those of the image that the heart
        comes from; both are tilted a little where that fits better.

    Raises
    ------
    InputError
        As `idealised_torso`; if electrodes and heart are not in one frame, or an electrode is far
        from the skin of any adult.
    """
    standard = BodySize()
    lv, rv = _endocardia(mesh)
    if pose == "standard":
        rotation = axes_of_electrodes(electrodes, standard_electrodes(standard, trunk(standard)))
        check_apex(f"{name}: by the electrodes' places", rotation, lv, rv)
    else:
        rotation = frame_around(mesh, standard, pose).rotation
    heart = mesh.vertices[np.unique(mesh.triangles)]
    fitted = fit_trunk(
        name, electrodes, heart, solid_centroid(mesh.vertices, mesh.tetrahedra), rotation, known
    )
    placed = fitted.frame.to_body(heart)
    hull = convex_hull(placed)
    trunk_as_it_was = outside_trunk(fitted.body)
    low, high = placed.min(axis=0) - NEAR_HEART, placed.max(axis=0) + NEAR_HEART

    def outside(points: Floats) -> Floats:
        of_trunk = trunk_as_it_was(fitted.undeformed(points))
        # elsewhere the heart makes no difference
        near = ((points > low) & (points < high)).all(axis=1) & (of_trunk > -NEAR_HEART)
        of_heart = signed_distance(points[near], hull) - 2 * SKIN_MARGIN
        of_trunk[near] = -smooth_max(-of_trunk[near], -of_heart, SKIN_MARGIN)
        return of_trunk

    skin = skin_of(outside, trunk_box(fitted.body, FARTHEST))
    return _around(mesh, fitted.body, fitted.frame, skin, electrodes, fitted.undeformed), fitted


def _around(
    mesh: LabelledMesh,
    body: BodySize,
    frame: BodyFrame,
    skin: Surface,
    electrodes: Floats,
    undeformed: Deformation = identity,
) -> TorsoSurfaces:
    """Add lungs to a skin in the body frame; electrodes are in the heart's coordinates."""
    heart = frame.to_body(mesh.vertices[np.unique(mesh.triangles)])
    _check_fits(mesh.name, heart, skin)
    base = frame.to_body(np.stack([opening(side) for side in _endocardia(mesh)]))
    lungs = lungs_of(mesh.name, body, exclusion_hull(heart, base), undeformed)
    surfaces = TorsoSurfaces(
        Surface(frame.to_heart(skin.vertices), skin.triangles),
        tuple(Surface(frame.to_heart(lung.vertices), lung.triangles) for lung in lungs),
        electrodes,
    )
    check_within(mesh, surfaces.skin, surfaces.lungs)
    return surfaces


def frame_around(mesh: LabelledMesh, body: BodySize, pose: Pose = "standard") -> BodyFrame:
    """Where the axes of an idealised body lie around a heart.

    Parameters
    ----------
    mesh : LabelledMesh
        The heart (mm).
    body : BodySize
        Height, weight and girth.
    pose : {"standard", "ras", "lps"}
        Where the body's axes come from, see `fascicle.torso.heart_pose.body_frame`.
    """
    return body_frame(
        *_endocardia(mesh),
        solid_centroid(mesh.vertices, mesh.tetrahedra),
        default_position(body),
        pose,
    )


def _endocardia(mesh: LabelledMesh) -> tuple[Surface, Surface]:
    """Left and right."""
    return (
        Surface(mesh.vertices, mesh.having(Label.LV_ENDOCARDIUM)),
        Surface(mesh.vertices, mesh.having(Label.RV_ENDOCARDIUM)),
    )


def _check_fits(name: str, heart: Floats, skin: Surface) -> None:
    beyond = signed_distance(heart, skin) + SKIN_MARGIN
    if beyond.max() > 0:
        x, y, z = heart[np.argmax(beyond)]
        where = (
            f"{'left' if x > 0 else 'right'} {'front' if y < 0 else 'back'} "
            f"{'above' if z > 0 else 'below'} V1"
        )
        raise InputError(
            f"{name}: does not fit into the idealised torso, {beyond.max():.0f} mm too far out "
            f"({where}); check pose and units, or give a larger height, weight or chest girth"
        )
