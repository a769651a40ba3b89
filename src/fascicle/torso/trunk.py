"""An adult's trunk and lungs, as level sets of smooth functions in the torso frame.

Lengths along the torso are fractions of its height; those across follow the girth of the chest. The
torso frame is that of `fascicle.torso.heart_pose`.

Sources
-------
Standard adult : mean of the reference man (1.76 m, 73 kg) and the reference woman (1.63 m, 60 kg)
    of ICRP Publication 89 (Valentin 2002, Ann ICRP 32(3-4)).
Girth : Heinz et al. 2003, J Stat Educ 11(2): 247 men and 260 women of 1.71 m, 69.1 kg and 93.3 cm
    on average. A cylinder's girth goes with the square root of weight by height, and so do these.
Levels : Drillis and Contini 1966 (in Winter, Biomechanics and Motor Control of Human Movement):
    hip 0.530 and shoulder 0.818 of the height. The nipple, 0.72 to 0.73, lies in or a little below
    the fourth intercostal space, whose sternal end sets the origin here.
Outline : depth to width as in Heinz et al. 2003 (17.7 and 20.8 cm across 26.1 and 30.0 cm of bony
    chest, 0.69); the widths at other levels are those of drawings of the standing adult.
Lung volume : Hall et al. 2021, Eur Respir J 57:2000289 (2.5 l of gas in the reference woman and
    3.2 l in the reference man at the end of expiration); tissue and blood of the lungs add 0.95 and
    1.2 kg (ICRP 89).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import ClassVar

import igl
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.mesh.measures import triangle_normals, turned_outwards
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.surfaces import EDGES, Surface, remeshed, signed_distance

# About the distance (mm) of points (n, 3) to a surface, negative inside
Outside = Callable[[Floats], Floats]
# Positions in the undeformed trunk of points (n, 3) of a deformed one
Deformation = Callable[[Floats], Floats]

TRUNK_SHAPE = ("depth", "shoulders", "hips")
# Sections of the rib cage with its contents: level (of the height), half-width and half-depth (of
# those of the outline at V1's level)
CAGE = np.array(
    [
        (0.600, 0.84, 0.80),
        (0.735, 0.82, 0.78),
        (0.765, 0.76, 0.74),
        (0.790, 0.62, 0.60),
        (0.810, 0.44, 0.44),
        (0.830, 0.16, 0.20),
    ]
)


@dataclass(frozen=True)
class TrunkSize:
    """Measures by which an adult trunk is scaled; an error if a value is not an adult's.

    The last three are factors on the standard adult's depth by width of the chest, and on the width
    of shoulders and hips.
    """

    height: float = 1.70  # m, standing
    weight: float = 66.5  # kg
    chest: float | None = None  # cm, girth at the nipples; from height and weight if not given
    depth: float = 1.0
    shoulders: float = 1.0
    hips: float = 1.0
    # exponent of the superellipse that is the outline; 2 is an ellipse
    squareness: ClassVar[float] = 2.4
    # half-widths of the chest beyond which no section of the trunk reaches
    widest: ClassVar[float] = 1.2

    def __post_init__(self) -> None:
        # girth comes last, as it is a number only if height and weight are possible
        limits = {"height": (120.0, 230.0, "cm"), "weight": (25.0, 250.0, "kg")}
        limits |= dict.fromkeys(TRUNK_SHAPE, (0.5, 2.0, "times"))
        for name, (low, high, unit) in (limits | {"girth": (50.0, 180.0, "cm")}).items():
            value = getattr(self, name) * (100 if name == "height" else 1)  # in cm, as options
            if not low <= value <= high:
                raise InputError(
                    f"torso: {'chest ' if name == 'girth' else ''}{name} {value:.4g} {unit} is not "
                    f"that of an adult; give {low:g} to {high:g} {unit}"
                )

    @property
    def girth(self) -> float:
        """Girth of the chest (cm)."""
        return self.chest if self.chest is not None else 14.7 * sqrt(self.weight / self.height)

    @cached_property
    def half_width(self) -> float:
        """Half the width of the chest's outline at the level of V1 (mm)."""
        angle = np.linspace(0, 2 * np.pi, 721)
        outline = np.stack([np.cos(angle), np.sin(angle)])
        outline = np.sign(outline) * np.abs(outline) ** (2 / self.squareness)
        outline[1] *= self.depth * 0.70
        return float(10 * self.girth / np.linalg.norm(np.diff(outline), axis=0).sum())

    @property
    def half_depth(self) -> float:
        """Half the depth of the chest's outline at the level of V1 (mm)."""
        return self.depth * 0.70 * self.half_width

    def level(self, fraction: float) -> float:
        """Coordinate z in the torso frame (mm) of a fraction of the standing height; V1's is 0."""
        return 1000 * self.height * (fraction - 0.735)


def identity(points: Floats) -> Floats:
    """Return points unchanged: no deformation."""
    return points


def trunk(size: TrunkSize) -> Surface:
    """Skin of the trunk in the torso frame (mm)."""
    return skin_of(outside_trunk(size), trunk_box(size))


def skin_of(outside: Outside, box: Floats) -> Surface:
    """Mesh the surface on which a function vanishes, within a box (2, 3), as a skin."""
    return remeshed(level_set(outside, box, 12.0), EDGES["torso"])


def trunk_box(size: TrunkSize, margin: float = 0.0) -> Floats:
    """Two opposite corners (2, 3) of a box around the trunk, in the torso frame (mm)."""
    across = size.widest * max(1.0, size.shoulders, size.hips, size.depth) * size.half_width
    lower, upper = _ends(size)
    corners = np.array([[-across, -across, lower], [across, across, upper]])
    return np.asarray(corners + np.array([[-margin], [margin]]))


def _ends(size: TrunkSize) -> tuple[float, float]:
    """Levels z at which the trunk is cut off below and above (mm)."""
    return size.level(0.495), size.level(0.850)


def outside_trunk(size: TrunkSize) -> Outside:
    """Approximate signed distance (mm) from the skin in the torso frame, negative inside."""
    # level (of the height), half-width and half-depth of the outline (of those at V1's level), and
    # how much of the shoulders' and of the hips' width counts there
    sections = np.array(
        [
            (0.480, 0.88, 0.86, 0.0, 1.0),
            (0.530, 1.02, 0.96, 0.0, 1.0),  # hip
            (0.610, 0.92, 0.92, 0.0, 0.5),  # waist
            (0.680, 0.97, 0.98, 0.0, 0.0),
            (0.735, 1.00, 1.00, 0.0, 0.0),  # V1
            (0.770, 1.03, 0.96, 0.5, 0.0),
            (0.800, 1.10, 0.82, 1.0, 0.0),  # shoulder
            (0.825, 0.86, 0.66, 1.0, 0.0),
            (0.845, 0.46, 0.50, 0.5, 0.0),  # neck
            (0.870, 0.36, 0.44, 0.0, 0.0),
        ]
    )
    sections[:, 1] *= size.shoulders ** sections[:, 3] * size.hips ** sections[:, 4]
    beyond = beyond_sections(size, sections[:, :3].copy())
    lower, upper = _ends(size)

    def outside(points: Floats) -> Floats:
        ends = np.maximum(lower - points[:, 2], points[:, 2] - upper)
        return smooth_max(beyond(points), ends, 30.0)

    return outside


def beyond_sections(size: TrunkSize, sections: Floats) -> Outside:
    """Approximate signed distance (mm) to a stack of superellipses (k, 3), such as `CAGE`."""
    level = np.array([size.level(fraction) for fraction in sections[:, 0]])
    halves = PchipInterpolator(level, sections[:, 1:] * (size.half_width, size.half_depth))

    def outside(points: Floats) -> Floats:
        half = halves(np.clip(points[:, 2], level[0], level[-1]))
        powers = np.abs(points[:, :2] / half) ** size.squareness
        relative = powers.sum(axis=1) ** (1 / size.squareness)
        # `reach` is the outline's radius towards a point: the distance is exact along x and y
        reach = np.linalg.norm(points[:, :2], axis=1) / np.maximum(relative, 1e-9)
        return np.asarray((relative - 1) * np.clip(reach, half.min(axis=1), half.max(axis=1)))

    return outside


def smooth_max(a: Floats, b: Floats, width: float) -> Floats:
    """The larger of two distances (n,), rounded off where they differ by less than a width (mm)."""
    overlap = np.maximum(width - np.abs(a - b), 0) / width
    return np.asarray(np.maximum(a, b) + overlap**2 * width / 4)


def level_set(outside: Outside, box: Floats, spacing: float) -> Surface:
    """Surface on which a function of points (n, 3), negative inside, vanishes: marching cubes.

    The box (2, 3), two opposite corners, holds the surface; the grid has this spacing (mm).
    """
    axes = [np.arange(low - 3 * spacing, high + 4 * spacing, spacing) for low, high in box.T]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    values = outside(points)
    # a surface through a grid point, or nearly so, would have triangles of no area
    least = 0.05 * spacing
    values = np.where(np.abs(values) < least, np.copysign(least, values), values)
    vertices, triangles, _ = igl.marching_cubes(values, points, *(len(axis) for axis in axes), 0.0)
    return Surface(vertices, turned_outwards(vertices, triangles))


def convex_hull(points: Floats) -> Surface:
    """Convex hull of points (n, 3), counter-clockwise seen from outside."""
    hull = ConvexHull(points)
    vertices, triangles = without_unused_vertices(points, hull.simplices)
    outward = hull.equations[:, :3]
    inverted = np.einsum("ij,ij->i", triangle_normals(vertices, triangles), outward) < 0
    triangles[inverted] = triangles[inverted, ::-1]
    return Surface(vertices, triangles)


def exclusion_hull(heart: Floats, base: Floats) -> Surface:
    """Convex hull of the ventricles' points and of room for the atria, 45 mm behind the base."""
    towards_atria = base.mean(axis=0) - heart.mean(axis=0)
    towards_atria *= 45.0 / np.linalg.norm(towards_atria)
    # the atria continue what lies within 15 mm from the base
    near_base = heart[(heart - base.mean(axis=0)) @ towards_atria > -45.0 * 15.0]
    return convex_hull(np.concatenate([heart, near_base + towards_atria]))


def lungs_of(
    name: str,
    size: TrunkSize,
    excluded: Surface,
    undeformed: Deformation = identity,
    smallest: float = 0.3,
) -> tuple[Surface, Surface]:
    """Left and right lung in the torso frame (mm).

    Lungs keep clear of the surface `excluded` (`exclusion_hull`); `undeformed` maps points to the
    undeformed trunk. An error, about the heart called `name`, if a lung would have less than the
    `smallest` volume (litres).
    """
    lungs = []
    for side, sign, dome_level in (("left", 1, 0.710), ("right", -1, 0.717)):  # the diaphragm's
        lung = _lung(size, excluded, sign, dome_level, undeformed)
        if lung is None or lung.litres < smallest:
            raise InputError(
                f"{name}: leaves no room for the {side} lung in the idealised torso; check pose "
                "and units, or give a larger height, weight or chest girth"
            )
        lungs.append(lung)
    return lungs[0], lungs[1]


def _lung(
    size: TrunkSize, excluded: Surface, sign: int, dome_level: float, undeformed: Deformation
) -> Surface | None:
    """Lung within the ribs, lateral to the mediastinum and the heart, above the diaphragm."""
    half_width, half_depth = size.half_width, size.half_depth
    height, top, blend, spacing = 1000 * size.height, size.level(0.822), 20.0, 8.0  # mm
    outside_ribs = beyond_sections(size, CAGE)

    def outside(points: Floats) -> Floats:
        in_trunk = undeformed(points)
        x, y, z = sign * in_trunk[:, 0], in_trunk[:, 1] / half_depth, in_trunk[:, 2]
        # the mediastinum is 0.13 half-widths wide in front and 0.26 at the spine
        middle = half_width * (0.13 + (0.26 - 0.13) / (1 + np.exp(-6.0 * (y - 0.1))))
        # the dome's top is 0.4 half-widths from the midplane; it falls towards ribs and back
        radius = np.hypot((x / half_width - 0.4) / 0.6, y / 0.9)
        dome = size.level(dome_level) - height * (0.055 * radius**2 + 0.012 * y)
        beyond = outside_ribs(in_trunk)
        for other in (middle - x, dome - z, z - top):
            beyond = smooth_max(beyond, other, blend)
        near = beyond < 2 * spacing  # elsewhere the heart makes no difference
        heart = 6.0 - signed_distance(points[near], excluded)  # mm between heart and lungs
        beyond[near] = smooth_max(beyond[near], heart, blend)
        return beyond

    reach = np.array([half_width, half_depth])
    box = np.stack([np.append(-reach, size.level(CAGE[0, 0])), np.append(reach, top)])
    surface = level_set(outside, box, spacing)
    return remeshed(surface, EDGES["lung"]) if len(surface.triangles) else None
