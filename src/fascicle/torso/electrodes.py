"""Where electrodes belong, and whether given ones can be where they are said to be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import igl
import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.geometry.heart import Heart
from fascicle.leads import ELECTRODES
from fascicle.torso.placing import heart_axes
from fascicle.torso.surfaces import Surface

if TYPE_CHECKING:
    from fascicle.torso.idealised import Build

Floats = NDArray[np.float64]
RA, LA, LL, V1, V2, V3, V4, V5, V6 = range(len(ELECTRODES))

# Sites: Kligfield et al. 2007, Circulation 115:1306-1324. Limb electrodes on the trunk, where the
# limbs join it: Mason and Likar 1966, Am Heart J 71:196-205. Across the body in parts of the half
# width of the chest, along it in parts of the height, from V1's level.
STERNAL = 0.15  # the sternum is some 5 cm wide at the fourth intercostal space
MIDCLAVICULAR = 0.55  # halfway between the middle of the neck and the tip of the shoulder
AXILLARY = np.radians(58)  # of the anterior axillary line from straight ahead; V6's is at 90
SHOULDER, SHOULDER_LEVEL = 0.88, 0.080
HIP, HIP_LEVEL = 0.65, -0.178  # in front of the iliac crest
INTERCOSTAL = 0.021  # the fifth intercostal space below the fourth


def standard_electrodes(build: Build, skin: Surface) -> Floats:
    """Put the nine electrodes onto the skin of an idealised torso.

    V1 and V2 lie in the fourth intercostal space at the borders of the sternum, V4 in the fifth at
    the midclavicular line, V3 between V2 and V4, V5 and V6 at V4's level on the anterior and the
    middle axillary line.

    Parameters
    ----------
    build : Build
        What the torso is scaled by.
    skin : Surface
        Its skin in the body frame (mm).

    Returns
    -------
    (9, 3) array
        In the order of `fascicle.leads.ELECTRODES` (mm).
    """
    width, metre = build.half_width, 1000 * build.height
    low = -INTERCOSTAL * metre
    axillary = np.array([np.sin(AXILLARY), -np.cos(AXILLARY)])
    # a place on the axis of the trunk, or beside it, and the way from there to the skin
    rays = {
        RA: ((-SHOULDER * width, 0, SHOULDER_LEVEL * metre), (0, -1)),
        LA: ((SHOULDER * width, 0, SHOULDER_LEVEL * metre), (0, -1)),
        LL: ((HIP * width, 0, HIP_LEVEL * metre), (0, -1)),
        V1: ((-STERNAL * width, 0, 0), (0, -1)),
        V2: ((STERNAL * width, 0, 0), (0, -1)),
        V3: (((STERNAL + MIDCLAVICULAR) / 2 * width, 0, low / 2), (0, -1)),
        V4: ((MIDCLAVICULAR * width, 0, low), (0, -1)),
        V5: ((0, 0, low), axillary),
        V6: ((0, 0, low), (1, 0)),
    }
    electrodes = np.empty((len(ELECTRODES), 3))
    for electrode, (start, (x, y)) in rays.items():
        electrodes[electrode] = _on_skin(skin, np.array(start, dtype=float), np.array([x, y, 0.0]))
    return electrodes


def _on_skin(skin: Surface, start: Floats, way: Floats) -> Floats:
    """Where a ray from within leaves the skin."""
    hits = igl.ray_mesh_intersect(start, way, *skin)
    return start + max(distance for _, distance, *_ in hits) * way
