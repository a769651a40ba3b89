"""Lungs of an adult trunk: within the ribs, clear of the heart, above the diaphragm.

Sources
-------
Volume : Hall et al. 2021, Eur Respir J 57:2000289 (2.5 l of gas in the reference woman and 3.2 l in
    the reference man of ICRP Publication 89 at the end of expiration); tissue and blood of the
    lungs add 0.95 and 1.2 kg (ICRP 89).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.mesh.measures import triangle_normals
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.body_size import MM_PER_M, BodySize
from fascicle.torso.surfaces import Surface, remeshed, signed_distance
from fascicle.torso.trunk import Deformation, beyond_sections, identity, level_set, smooth_max

# Ribs and all within, as the sections of the trunk; level, half-width and half-depth
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
LUNG_TOP = 0.822
DOMES = {1: 0.710, -1: 0.717}  # level of the diaphragm's top on the left and on the right
DOME_MIDDLE = 0.4  # of the dome's top: from the midplane (of the chest's half-width)
DOME_REACH = (0.6, 0.9)  # from there to the ribs: of half-width and half-depth
DOME_DROP = 0.055  # and how much lower it is at the ribs (of the height)
DOME_TILT = 0.012  # and further down at the back, up at the front
MEDIASTINUM = (0.13, 0.26)  # its half-width in front and at the spine (of the chest's half-width)
MEDIASTINUM_STEEPNESS, MEDIASTINUM_MIDDLE = 6.0, 0.1  # of its widening (by half-depths)
ATRIA = 45.0  # mm, how far behind the ventricles' base the lungs keep clear
NEAR_BASE = 3  # the atria continue what lies within a third of that from the base
CLEARANCE = 6.0  # mm, of the lungs around the heart
BLEND = 20.0  # mm, of the edges of the lungs

SMALLEST_LUNG = 0.3  # litres; the girth of the thinnest adult leaves more
LUNG_GRID = 8.0  # mm, of the level set
LUNG_EDGE = 9.0  # mm, of the triangles


def exclusion_hull(heart: Floats, base: Floats) -> Surface:
    """Convex hull of the ventricles and of room for the atria behind them."""
    towards_atria = base.mean(axis=0) - heart.mean(axis=0)
    towards_atria *= ATRIA / np.linalg.norm(towards_atria)
    near_base = heart[(heart - base.mean(axis=0)) @ towards_atria > -ATRIA * ATRIA / NEAR_BASE]
    points = np.concatenate([heart, near_base + towards_atria])
    return convex_hull(points)


def convex_hull(points: Floats) -> Surface:
    """Convex hull of points (n, 3), counter-clockwise seen from outside."""
    hull = ConvexHull(points)
    vertices, triangles = without_unused_vertices(points, hull.simplices)
    outward = hull.equations[:, :3]
    inverted = np.einsum("ij,ij->i", triangle_normals(vertices, triangles), outward) < 0
    triangles[inverted] = triangles[inverted, ::-1]
    return Surface(vertices, triangles)


def lungs_of(
    name: str, body: BodySize, clear: Surface, undeformed: Deformation = identity
) -> tuple[Surface, Surface]:
    """Left and right lung in the body frame (mm).

    Parameters
    ----------
    name : str
        What to call the heart in an error.
    body : BodySize
        What the trunk is scaled by.
    clear : Surface
        Of `exclusion_hull`, in the body frame (mm).
    undeformed : callable
        Where points of the body frame lie in the trunk as it was before it was deformed.

    Raises
    ------
    InputError
        If the heart leaves no room for one.
    """
    lungs = []
    for side, which in ((1, "left"), (-1, "right")):
        lung = _lung(body, clear, side, undeformed)
        if lung is None or lung.litres < SMALLEST_LUNG:
            raise InputError(
                f"{name}: leaves no room for the {which} lung in the idealised torso; check pose "
                "and units, or give a larger height, weight or chest girth"
            )
        lungs.append(lung)
    return lungs[0], lungs[1]


def _lung(body: BodySize, clear: Surface, side: int, undeformed: Deformation) -> Surface | None:
    """One lung: within the ribs, beside the mediastinum and the heart, above the diaphragm."""
    half_width, half_depth = body.half_width, body.half_depth
    height = MM_PER_M * body.height
    outside_ribs = beyond_sections(body, CAGE)

    def outside(points: Floats) -> Floats:
        in_trunk = undeformed(points)
        x, y, z = side * in_trunk[:, 0], in_trunk[:, 1] / half_depth, in_trunk[:, 2]
        ribs = outside_ribs(in_trunk)
        front, back = MEDIASTINUM
        widening = 1 + np.exp(-MEDIASTINUM_STEEPNESS * (y - MEDIASTINUM_MIDDLE))
        middle = half_width * (front + (back - front) / widening)
        radius = np.hypot((x / half_width - DOME_MIDDLE) / DOME_REACH[0], y / DOME_REACH[1])
        dome = body.level(DOMES[side]) - height * (DOME_DROP * radius**2 + DOME_TILT * y)
        beyond = smooth_max(ribs, middle - x, BLEND)
        beyond = smooth_max(beyond, dome - z, BLEND)
        beyond = smooth_max(beyond, z - body.level(LUNG_TOP), BLEND)
        inside = beyond < 2 * LUNG_GRID  # elsewhere the heart makes no difference
        heart = CLEARANCE - signed_distance(points[inside], clear)
        beyond[inside] = smooth_max(beyond[inside], heart, BLEND)
        return beyond

    reach = np.array([half_width, half_depth])
    lower, upper = body.level(CAGE[0, 0]), body.level(LUNG_TOP)
    box = np.stack([np.append(-reach, lower), np.append(reach, upper)])
    surface = level_set(outside, box, LUNG_GRID)
    return remeshed(surface, LUNG_EDGE) if len(surface.triangles) else None
