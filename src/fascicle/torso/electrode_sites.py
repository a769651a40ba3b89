"""Standard sites of electrodes, and checks on the positions of given electrodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import IntEnum

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES, RIGHT_LEADS
from fascicle.heart.electrodes import Electrodes
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import unit
from fascicle.torso.heart_pose import surface_middle
from fascicle.torso.surfaces import Surface
from fascicle.torso.trunk import TrunkSize

FARTHEST = 30.0  # mm from the skin; electrodes further away do not belong to the torso


# Rows of electrodes in arrays, in the order of `fascicle.core.leads.ELECTRODES`
Electrode = IntEnum("Electrode", "RA LA LL V1 V2 V3 V4 V5 V6", start=0)


def standard_electrodes(size: TrunkSize, skin: Surface) -> Floats:
    """Put the nine electrodes (9, 3) onto the skin of an idealised torso, in the torso frame (mm).

    V1 and V2 lie in the fourth intercostal space at the borders of the sternum, V4 in the fifth at
    the midclavicular line, V3 between V2 and V4, V5 and V6 at V4's level on the anterior and the
    middle axillary line: Kligfield et al. 2007, Circulation 115:1306-1324. Limb electrodes lie on
    the trunk, where the limbs join it: Mason and Likar 1966, Am Heart J 71:196-205.
    """
    electrodes = []
    for start, direction in zip(*site_rays(size), strict=True):
        hits = igl.ray_mesh_intersect(start, direction, *skin)
        electrodes.append(start + max(distance for _, distance, *_ in hits) * direction)
    return np.array(electrodes)


def site_rays(size: TrunkSize) -> tuple[Floats, Floats]:
    """Rays from within the trunk that leave the skin at the standard electrode sites.

    Starts (9, 3) and directions (9, 3) in the torso frame (mm).
    """
    width, height = size.half_width, 1000 * size.height  # mm
    sternal = 0.15  # share of the half-width: the sternum is 5 cm wide at the fourth space
    clavicular = 0.55  # halfway between the middle of the neck and the tip of the shoulder
    shoulder, hip = 0.88 * size.shoulders * width, 0.65 * size.hips * width
    fifth = -0.021 * height  # the fifth intercostal space below the fourth
    axillary = np.radians(64)  # anterior axillary line, from straight ahead; V6 is at 90
    front = (0.0, -1.0)
    # by electrode: a place within the trunk, (x, z), and the direction to the skin, (x, y)
    rays = [
        ((-shoulder, 0.080 * height), front),
        ((shoulder, 0.080 * height), front),
        ((hip, -0.178 * height), front),  # in front of the iliac crest
        ((-sternal * width, 0.0), front),
        ((sternal * width, 0.0), front),
        (((sternal + clavicular) / 2 * width, fifth / 2), front),
        ((clavicular * width, fifth), front),
        ((0.0, fifth), (np.sin(axillary), -np.cos(axillary))),
        ((0.0, fifth), (1.0, 0.0)),
    ]
    starts = np.array([(x, 0.0, z) for (x, z), _ in rays])
    return starts, np.array([(x, y, 0.0) for _, (x, y) in rays])


def additional_sites(heart: Heart, axes: Floats, skin: Surface, names: Sequence[str]) -> Electrodes:
    """Place additional electrodes on the skin of a torso (mm), relative to the standard nine.

    Frank's A, C, E, I and M lie at the level of V4 to V6, C halfway between A and E around the
    chest, H at the back of the neck; F, of the left leg, is at LL: Frank 1956, Circulation
    13:737-749. V7 to V9 lie at that level on the posterior axillary line, below the tip of the
    scapula and at the spine's border, and right-sided electrodes mirror the left ones: Kligfield et
    al. 2007, Circulation 115:1306-1324.

    The columns of `axes` (3, 3) point to the left, to the back and up in the heart's coordinates;
    the skin is closed. Names are those of Frank's electrodes, and of `POSTERIOR_LEADS` and
    `RIGHT_LEADS` of `fascicle.core.leads`.
    """
    nine = heart.electrodes @ axes
    x = float(nine[[Electrode.RA, Electrode.LA, Electrode.V1, Electrode.V2], 0].mean())
    y, level = nine[Electrode.V6, 1], nine[Electrode.V4 :, 2].mean()
    width = nine[Electrode.V6, 0] - x

    def ray(start: tuple[float, float, float], direction: tuple[float, float, float]) -> Floats:
        towards, begin = axes @ direction, axes @ start
        if not (hits := igl.ray_mesh_intersect(begin, towards, *skin)):
            raise InputError(
                f"{heart.name}: no skin where the electrodes {', '.join(names)} belong; give their "
                "positions in electrodes.csv"
            )
        return np.asarray(begin + max(distance for _, distance, *_ in hits) * towards)

    places = {"F": heart.electrodes[Electrode.LL]}
    # degrees from straight ahead to the left
    angles = {"A": 90.0, "C": 45.0, "E": 0.0, "I": -90.0, "M": 180.0, "V7": 116.0}
    for name, angle in zip(angles, np.radians([*angles.values()]), strict=True):
        places[name] = ray((x, y, level), (np.sin(angle), -np.cos(angle), 0.0))
    # of the half-width: behind the midclavicular and the sternal line
    for name, share in (("V8", 0.55), ("V9", 0.15)):
        places[name] = ray((x + share * width, y, level), (0.0, 1.0, 0.0))
    # on the back in the midline, 2 cm below the top of the torso
    top = float(ray((x, y, level), (0.0, 0.0, 1.0)) @ axes[:, 2])
    places["H"] = ray((x, y, top - 20.0), (0.0, 1.0, 0.0))
    for name in RIGHT_LEADS:  # nearest to the mirror image of the left one
        image = axes @ (nine[Electrode[name.removesuffix("R")]] * [-1, 1, 1] + [2 * x, 0, 0])
        places[name] = np.asarray(igl.point_mesh_squared_distance(image[None], *skin)[2][0])
    return {name: places[name] for name in names}


def check_on_skin(heart: Heart, distances: Floats, source: str | None = None) -> None:
    """Refuse electrodes, from `source`, at distances (e,) (mm) from the skin beyond `FARTHEST`."""
    worst = int(np.argmax(distances))
    if distances[worst] > FARTHEST:
        raise InputError(
            f"{source or heart.name}: electrode {heart.electrode_names[worst]} is "
            f"{distances[worst]:.0f} mm from the skin, more than {FARTHEST:.0f}; give the person's "
            "own skin in the electrodes' frame and in mm (--torso FILE), the idealised torso's "
            "--height, --weight or --chest, or none (--torso none)"
        )


def check_not_mirrored(name: str, heart: Heart) -> None:
    """Refuse a heart, called `name`, whose RV lies left of or behind the LV for its electrodes.

    In a healthy chest the RV lies to the right and in front of the LV, each by two thirds of their
    distance; the limits leave room for any rotation about the long axis that occurs. Where limb
    and chest electrodes disagree about the left side, `electrode_warnings` says so.
    """
    limbs, chest = _leftwards(heart.electrodes)
    if limbs @ chest <= 0:
        return
    left = unit(limbs + chest)
    across = unit(_lv_to_rv(heart))
    where = "to the left of" if across @ left > 0.25 else ""
    if not where and -across @ _frontwards(heart, left) > 0.5:
        where = "behind"
    if where:
        raise InputError(
            f"{name}: the RV lies {where} the LV as the electrodes see it, so the heart or the "
            "electrodes are mirrored; check the axes of both (RAS or LPS), and which is the LV"
        )


def check_not_exchanged(name: str, heart: Heart) -> None:
    """Refuse electrodes, from `name`, that seem to be exchanged."""
    for warning in _order_warnings(heart):
        raise InputError(f"{name}: {warning}")


def _order_warnings(heart: Heart) -> Iterator[str]:
    """Warnings about exchanged electrodes: left and right, up and down, or around the chest."""
    electrodes = heart.electrodes
    limbs, chest = _leftwards(electrodes)
    leftwards, up = -_lv_to_rv(heart), _upwards(electrodes)
    if limbs @ leftwards < 0 < chest @ leftwards:
        yield "electrodes RA and LA: LA lies to the right of RA, so lead I is reversed; swap them"
    elif chest @ leftwards < 0 < limbs @ leftwards:
        yield "electrodes V1 to V6 run from the left to the right; reverse their order"
    else:
        around = electrodes[Electrode.V1 :] - electrodes[:2].mean(axis=0)
        around -= np.outer(around @ up, up)
        left = unit(limbs - (limbs @ up) * up)
        angle = np.arctan2(around @ left, around @ _frontwards(heart, limbs))
        for k in Electrode.V1 + np.flatnonzero(np.diff(angle) < 0):
            yield (
                f"electrodes {ELECTRODES[k]} and {ELECTRODES[k + 1]}: the second lies to the right "
                "of the first around the chest; check their order"
            )
    left = unit(limbs + chest) if limbs @ chest > 0 else unit(leftwards)
    if up @ np.cross(_frontwards(heart, left), left) < 0:
        yield (
            "electrode LL lies above RA and LA as the chest electrodes see it, so leads II, III "
            "and aVF are reversed; check the names, and that no axis is mirrored"
        )
        return
    height = electrodes @ up
    low, high = height[Electrode.LL], height[:2].max()
    for name, level in zip(ELECTRODES[Electrode.V1 :], height[Electrode.V1 :], strict=True):
        if not low < level < high:
            where = "above RA and LA" if level > high else "below LL"
            yield f"electrode {name} lies {where}; check its position"


def electrode_warnings(heart: Heart) -> Iterator[str]:
    """Warnings about misplaced or exchanged electrodes: one line each, with a remedy."""
    yield from _order_warnings(heart)
    distance, _ = cKDTree(heart.vertices).query(heart.electrode_positions)
    for name, d in zip(heart.electrode_names, distance, strict=True):
        where, remedy = f"electrode {name} is {d:.0f} mm from the heart", "check its position"
        if d < 10:  # mm: ribs lie between
            yield f"{where}, nearer than skin can be; {remedy}"
        if d > 350 and name.startswith("V"):
            yield f"{where}, further than any chest is wide; {remedy} and the units (mm)"


def _leftwards(electrodes: Floats) -> tuple[Floats, Floats]:
    """Unit vectors to the patient's left, by the limb and by the chest electrodes."""
    limbs = electrodes[Electrode.LA] - electrodes[Electrode.RA]
    return unit(limbs), unit(electrodes[Electrode.V5] - electrodes[Electrode.V1])


def _upwards(electrodes: Floats) -> Floats:
    return unit(electrodes[:2].mean(axis=0) - electrodes[Electrode.LL])


def _frontwards(heart: Heart, left: Floats) -> Floats:
    """Unit vector from the heart towards V1 to V4, orthogonal to up and to the left."""
    electrodes = heart.electrodes
    up = _upwards(electrodes)
    left = unit(left - (left @ up) * up)
    front = electrodes[Electrode.V1 : Electrode.V5].mean(axis=0) - heart.vertices.mean(axis=0)
    front -= (front @ up) * up + (front @ left) * left
    return unit(front)


def _lv_to_rv(heart: Heart) -> Floats:
    """Vector from the middle of the LV endocardium to that of the RV endocardium (mm)."""
    lv, rv = (surface_middle(Surface(e.vertices, e.triangles)) for e in heart.endocardia)
    return rv - lv
