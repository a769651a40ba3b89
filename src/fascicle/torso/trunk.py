"""Skin of an adult trunk, as the level set of a smooth function in the body frame.

Lengths along the body are fractions of its height; those across follow the girth of the chest. The
body frame is that of `fascicle.torso.heart_pose`.

Sources
-------
Levels : Drillis and Contini 1966 (in Winter, Biomechanics and Motor Control of Human Movement):
    hip 0.530 and shoulder 0.818 of the height. The nipple, 0.72 to 0.73, lies in or a little below
    the fourth intercostal space, whose sternal end sets the origin here.
Outline : depth to width as in Heinz et al. 2003, J Stat Educ 11(2) (17.7 and 20.8 cm across 26.1
    and 30.0 cm of bony chest, 0.69); the widths at other levels are those of drawings of the
    standing adult.
"""

from __future__ import annotations

from collections.abc import Callable

import igl
import numpy as np
from scipy.interpolate import PchipInterpolator

from fascicle.core.arrays import Floats
from fascicle.mesh.measures import turned_outwards
from fascicle.torso.body_size import SQUARENESS, BodySize
from fascicle.torso.surfaces import Surface, remeshed

# About the distance (mm) of points (n, 3) to a surface, negative inside
Outside = Callable[[Floats], Floats]
# Where points (n, 3) of a deformed body lie in the body as it was before
Deformation = Callable[[Floats], Floats]

# Level (of the height), half-width and half-depth of the outline (of those at V1's level), and how
# much of the shoulders' and of the hips' width counts there
SECTIONS = np.array(
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
BOTTOM, TOP = 0.495, 0.850  # where the trunk is cut off
ROUNDING = 30.0  # mm, of the edges there
WIDEST = 1.2  # beyond every section above (of the half-width)
LEAST_RATIO = 1e-9  # of the distance from the trunk's axis to that of the outline

SKIN_GRID = 12.0  # mm, of the level set
GRID_MARGIN = 3  # steps of the grid around the box
LEAST_LEVEL = 0.05  # of that spacing
SKIN_EDGE = 11.0  # mm, of the triangles


def identity(points: Floats) -> Floats:
    """No deformation."""
    return points


def trunk(body: BodySize) -> Surface:
    """Skin of the trunk in the body frame (mm)."""
    return skin_of(outside_trunk(body), trunk_box(body))


def skin_of(outside: Outside, box: Floats) -> Surface:
    """Mesh the surface on which a function vanishes, within a box (2, 3), as a skin."""
    return remeshed(level_set(outside, box, SKIN_GRID), SKIN_EDGE)


def trunk_box(body: BodySize, margin: float = 0.0) -> Floats:
    """Two opposite corners (2, 3) of a box around the trunk, in the body frame (mm)."""
    across = WIDEST * max(1.0, body.shoulders, body.hips, body.depth) * body.half_width
    corner = np.array([across, across, body.level(TOP)])
    other = np.array([-across, -across, body.level(BOTTOM)])
    return np.array([other - margin, corner + margin])


def outside_trunk(body: BodySize) -> Outside:
    """About how far points of the body frame are from the skin (mm), negative inside."""
    lower, upper = body.level(BOTTOM), body.level(TOP)
    sections = SECTIONS[:, :3].copy()
    sections[:, 1] *= body.shoulders ** SECTIONS[:, 3] * body.hips ** SECTIONS[:, 4]
    beside = beyond_sections(body, sections)

    def outside(points: Floats) -> Floats:
        ends = np.maximum(lower - points[:, 2], points[:, 2] - upper)
        return smooth_max(beside(points), ends, ROUNDING)

    return outside


def beyond_sections(body: BodySize, sections: Floats) -> Outside:
    """About the distance (mm) of points to a stack of superellipses, negative inside.

    Parameters
    ----------
    body : BodySize
        What they are scaled by.
    sections : (k, 3) array
        Level (of the height), half-width and half-depth (of those of the chest at V1's level).
    """
    level = np.array([body.level(fraction) for fraction in sections[:, 0]])
    halves = PchipInterpolator(level, sections[:, 1:] * (body.half_width, body.half_depth))

    def outside(points: Floats) -> Floats:
        half = halves(np.clip(points[:, 2], level[0], level[-1]))
        relative = (np.abs(points[:, :2] / half) ** SQUARENESS).sum(axis=1) ** (1 / SQUARENESS)
        # exact along x and along y, where the outline is that far away
        reach = np.linalg.norm(points[:, :2], axis=1) / np.maximum(relative, LEAST_RATIO)
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
    axes = [
        np.arange(low - GRID_MARGIN * spacing, high + (GRID_MARGIN + 1) * spacing, spacing)
        for low, high in box.T
    ]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    values = outside(points)
    # a surface through a grid point, or nearly so, would have triangles of no area
    least = LEAST_LEVEL * spacing
    values = np.where(np.abs(values) < least, np.copysign(least, values), values)
    vertices, triangles, _ = igl.marching_cubes(values, points, *(len(axis) for axis in axes), 0.0)
    return Surface(vertices, turned_outwards(vertices, triangles))
