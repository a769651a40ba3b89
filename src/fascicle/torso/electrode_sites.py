"""Where electrodes belong, and whether given ones can be where they are said to be."""

from __future__ import annotations

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import unit
from fascicle.torso.body_size import MM_PER_M, BodySize
from fascicle.torso.heart_pose import surface_middle
from fascicle.torso.surfaces import Surface

RA, LA, LL, V1, V2, V3, V4, V5, V6 = range(len(ELECTRODES))

# Sites: Kligfield et al. 2007, Circulation 115:1306-1324. Limb electrodes on the trunk, where the
# limbs join it: Mason and Likar 1966, Am Heart J 71:196-205. Across the body in parts of the half
# width of the chest, along it in parts of the height, from V1's level.
STERNAL = 0.15  # the sternum is some 5 cm wide at the fourth intercostal space
MIDCLAVICULAR = 0.55  # halfway between the middle of the neck and the tip of the shoulder
AXILLARY = np.radians(64)  # of the anterior axillary line from straight ahead; V6's is at 90
SHOULDER, SHOULDER_LEVEL = 0.88, 0.080
HIP, HIP_LEVEL = 0.65, -0.178  # in front of the iliac crest
INTERCOSTAL = 0.021  # the fifth intercostal space below the fourth

# In a healthy chest the RV lies to the right and in front of the LV, each by two thirds of their
# distance; these leave room for any rotation of the heart about its long axis that is seen.
FURTHEST_LEFT, FURTHEST_BACK = 0.25, 0.5  # of the distance from the LV to the RV
NEAREST, FURTHEST_CHEST = 10.0, 350.0  # mm from the heart; ribs lie between, a chest is not wider

FARTHEST = 30.0  # mm from the skin: beyond, electrodes and torso do not belong together


def standard_electrodes(body: BodySize, skin: Surface) -> Floats:
    """Put the nine electrodes onto the skin of an idealised torso.

    V1 and V2 lie in the fourth intercostal space at the borders of the sternum, V4 in the fifth at
    the midclavicular line, V3 between V2 and V4, V5 and V6 at V4's level on the anterior and the
    middle axillary line.

    Parameters
    ----------
    body : BodySize
        What the torso is scaled by.
    skin : Surface
        Its skin in the body frame (mm).

    Returns
    -------
    (9, 3) array
        In the order of `fascicle.core.leads.ELECTRODES` (mm).
    """
    starts, directions = site_rays(body)
    return np.array([_on_skin(skin, *ray) for ray in zip(starts, directions, strict=True)])


def site_rays(body: BodySize) -> tuple[Floats, Floats]:
    """Where electrodes belong: on the skin that rays from within the trunk leave through.

    Parameters
    ----------
    body : BodySize
        What the torso is scaled by.

    Returns
    -------
    starts, directions : (9, 3) and (9, 3) arrays
        In the body frame (mm), in the order of `fascicle.core.leads.ELECTRODES`.
    """
    width, height = body.half_width, MM_PER_M * body.height
    low = -INTERCOSTAL * height
    axillary = np.array([np.sin(AXILLARY), -np.cos(AXILLARY)])
    front = np.array([0.0, -1.0])
    # a place within the trunk, (x, z), and the direction from there to the skin, (x, y)
    rays = {
        RA: (-SHOULDER * body.shoulders * width, SHOULDER_LEVEL * height, front),
        LA: (SHOULDER * body.shoulders * width, SHOULDER_LEVEL * height, front),
        LL: (HIP * body.hips * width, HIP_LEVEL * height, front),
        V1: (-STERNAL * width, 0.0, front),
        V2: (STERNAL * width, 0.0, front),
        V3: ((STERNAL + MIDCLAVICULAR) / 2 * width, low / 2, front),
        V4: (MIDCLAVICULAR * width, low, front),
        V5: (0.0, low, axillary),
        V6: (0.0, low, np.array([1.0, 0.0])),
    }
    places = [rays[k] for k in range(len(ELECTRODES))]
    starts = np.array([(x, 0.0, z) for x, z, _ in places])
    directions = np.array([(*direction, 0.0) for _, _, direction in places])
    return starts, directions


def _on_skin(skin: Surface, start: Floats, direction: Floats) -> Floats:
    """Where a ray from within leaves the skin."""
    hits = igl.ray_mesh_intersect(start, direction, *skin)
    return np.asarray(start + max(distance for _, distance, *_ in hits) * direction)


def distances_to_skin(electrodes: Floats, skin: Surface) -> Floats:
    """How far electrodes (n, 3) are from a skin; (n,), mm."""
    squared, _, _ = igl.point_mesh_squared_distance(
        np.ascontiguousarray(electrodes, dtype=float), *skin
    )
    return np.asarray(np.sqrt(squared))


def check_on_skin(name: str, distances: Floats) -> None:
    """Refuse electrodes that are not on the skin.

    Parameters
    ----------
    name : str
        What they come from, for the message.
    distances : (9,) array
        Their distances from it (mm), in the order of `fascicle.core.leads.ELECTRODES`.

    Raises
    ------
    InputError
        If one is more than `FARTHEST` away.
    """
    worst = int(np.argmax(distances))
    if distances[worst] > FARTHEST:
        raise InputError(
            f"{name}: electrode {ELECTRODES[worst]} is {distances[worst]:.0f} mm from the skin, "
            f"more than {FARTHEST:.0f}; give the person's own skin in the electrodes' frame and in "
            "mm (--torso FILE), the idealised torso's --height, --weight or --chest, or none "
            "(--torso none)"
        )


def check_not_mirrored(name: str, heart: Heart) -> None:
    """Refuse a heart whose RV lies to the left of or behind the LV, as its electrodes see it.

    Where limb and chest electrodes contradict each other on what is left, it is they that are
    wrong; `electrode_warnings` says so, and nothing is refused.

    Parameters
    ----------
    name : str
        What to call the heart in the error.
    heart : Heart
        With its electrodes (mm).

    Raises
    ------
    InputError
        If it is mirrored.
    """
    limbs, chest = _leftwards(heart.electrodes)
    if limbs @ chest <= 0:
        return
    left = unit(limbs + chest)
    across = unit(_lv_to_rv(heart))
    front = _frontwards(heart, left)
    for component, most, where in (
        (across @ left, FURTHEST_LEFT, "to the left of"),
        (-across @ front, FURTHEST_BACK, "behind"),
    ):
        if component > most:
            raise InputError(
                f"{name}: the RV lies {where} the LV as the electrodes see it, so the heart or the "
                "electrodes are mirrored; check the axes of both (RAS or LPS), and which is the LV"
            )


def check_not_exchanged(name: str, heart: Heart) -> None:
    """Refuse electrodes of which two have each other's name, where a torso is to be fitted to them.

    Parameters
    ----------
    name : str
        What to call them in the error.
    heart : Heart
        With its electrodes (mm).

    Raises
    ------
    InputError
        As `electrode_warnings` words it.
    """
    for warning in [*_reversals(heart), *_heights(heart)]:
        raise InputError(f"{name}: {warning}")


def electrode_warnings(heart: Heart) -> list[str]:
    """What is odd about a heart's electrodes: one line each, with what to do.

    Parameters
    ----------
    heart : Heart
        With its electrodes (mm).

    Returns
    -------
    list of str
        Empty if they are where electrodes are.
    """
    return [*_reversals(heart), *_heights(heart), *_distances(heart)]


def _reversals(heart: Heart) -> list[str]:
    """Left and right swapped, or the chest electrodes out of order."""
    electrodes = heart.electrodes
    limbs, chest = _leftwards(electrodes)
    leftwards = -_lv_to_rv(heart)
    if limbs @ leftwards < 0 < chest @ leftwards:
        return [
            "electrodes RA and LA: LA lies to the right of RA, so lead I is reversed; swap them"
        ]
    if chest @ leftwards < 0 < limbs @ leftwards:
        return ["electrodes V1 to V6 run from the left to the right; reverse their order"]
    upwards = _upwards(electrodes)
    front = _frontwards(heart, limbs)
    around = electrodes[V1:] - electrodes[[RA, LA]].mean(axis=0)
    around -= np.outer(around @ upwards, upwards)
    left = unit(limbs - (limbs @ upwards) * upwards)
    angle = np.arctan2(around @ left, around @ front)
    return [
        f"electrodes {ELECTRODES[V1 + k]} and {ELECTRODES[V1 + k + 1]}: the second lies to the "
        "right of the first around the chest; check their order"
        for k in np.flatnonzero(np.diff(angle) < 0)
    ]


def _heights(heart: Heart) -> list[str]:
    """The legs' electrode above the arms', or chest electrodes not between them."""
    electrodes = heart.electrodes
    limbs, chest = _leftwards(electrodes)
    left = unit(limbs + chest) if limbs @ chest > 0 else unit(-_lv_to_rv(heart))
    if _upwards(electrodes) @ np.cross(_frontwards(heart, left), left) < 0:
        return [
            "electrode LL lies above RA and LA as the chest electrodes see it, so leads II, III "
            "and aVF are reversed; check the names, and that no axis is mirrored"
        ]
    height = electrodes @ _upwards(electrodes)
    low, high = height[LL], height[[RA, LA]].max()
    return [
        f"electrode {name} lies {'above RA and LA' if level > high else 'below LL'}; "
        "check its position"
        for name, level in zip(ELECTRODES[V1:], height[V1:], strict=True)
        if not low < level < high
    ]


def _distances(heart: Heart) -> list[str]:
    """Electrodes nearer to the heart, or further away, than the skin of the chest can be."""
    distance, _ = cKDTree(heart.vertices).query(heart.electrodes)
    near = [
        f"electrode {ELECTRODES[k]} is {distance[k]:.0f} mm from the heart, nearer than "
        "skin can be; check its position"
        for k in np.flatnonzero(distance < NEAREST)
    ]
    far = [
        f"electrode {ELECTRODES[k]} is {distance[k]:.0f} mm from the heart, further than any chest "
        "is wide; check its position and the units (mm)"
        for k in V1 + np.flatnonzero(distance[V1:] > FURTHEST_CHEST)
    ]
    return near + far


def _leftwards(electrodes: Floats) -> tuple[Floats, Floats]:
    """Unit vectors to the patient's left, by the limb and by the chest electrodes."""
    return unit(electrodes[LA] - electrodes[RA]), unit(electrodes[V5] - electrodes[V1])


def _upwards(electrodes: Floats) -> Floats:
    return unit(electrodes[[RA, LA]].mean(axis=0) - electrodes[LL])


def _frontwards(heart: Heart, left: Floats) -> Floats:
    """From the trunk towards V1 to V4, as far as it is neither up nor to the left."""
    electrodes = heart.electrodes
    up = _upwards(electrodes)
    left = unit(left - (left @ up) * up)
    front = electrodes[V1 : V4 + 1].mean(axis=0) - heart.vertices.mean(axis=0)
    front -= (front @ up) * up + (front @ left) * left
    return unit(front)


def _lv_to_rv(heart: Heart) -> Floats:
    """From the middle of one endocardium to that of the other (mm)."""
    lv, rv = (surface_middle(Surface(e.vertices, e.triangles)) for e in heart.endocardia)
    return rv - lv
