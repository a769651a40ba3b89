"""An adult trunk with lungs and electrodes, from height, weight and girth, around a given heart.

Skin and lungs are level sets of smooth functions in the body frame of `fascicle.torso.heart_pose`.
Lengths along the body are fractions of its height; those across follow the girth of the chest.

Sources
-------
Standard adult : mean of the reference man (1.76 m, 73 kg) and the reference woman (1.63 m, 60 kg)
    of ICRP Publication 89 (Valentin 2002, Ann ICRP 32(3-4)).
Girth : Heinz et al. 2003, J Stat Educ 11(2): 247 men and 260 women of 1.71 m, 69.1 kg and 93.3 cm
    on average. A cylinder's girth goes with the square root of weight by height, and so do these.
Levels : Drillis and Contini 1966 (in Winter, Biomechanics and Motor Control of Human Movement):
    hip 0.530 and shoulder 0.818 of the height. The nipple, 0.72 to 0.73, lies in or a little below
    the fourth intercostal space, whose sternal end sets the origin here.
Outline : depth to width as in Heinz et al. (17.7 and 20.8 cm across 26.1 and 30.0 cm of bony chest,
    0.69); the widths at other levels are those of drawings of the standing adult.
Skin to heart : Rahko 2008, J Am Soc Echocardiogr 21:761-764 (parasternal 32 mm, apical 31 mm).
Heart : the valves' surface projections put the middle of the LV base half an intercostal space
    above the fourth, and the apex into the fifth, at the midclavicular line.
Lungs : Hall et al. 2021, Eur Respir J 57:2000289 (2.5 l of gas in that woman and 3.2 l in that man
    at the end of expiration); tissue and blood of the lungs add 0.95 and 1.2 kg (ICRP 89).
"""

from __future__ import annotations

from collections.abc import Callable

import igl
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh
from fascicle.mesh.measures import signed_volumes, triangle_normals, turned_outwards
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.body_size import MM_PER_M, SQUARENESS, BodySize
from fascicle.torso.electrode_sites import standard_electrodes
from fascicle.torso.enclosure import check_within
from fascicle.torso.heart_pose import BodyFrame, Pose, body_frame, opening
from fascicle.torso.surfaces import Surface, TorsoSurfaces, remeshed, signed_distance

# Level (of the height), then half-width and half-depth of the outline (of those at V1's level)
SECTIONS = np.array(
    [
        (0.480, 0.88, 0.86),
        (0.530, 1.02, 0.96),  # hip
        (0.610, 0.92, 0.92),  # waist
        (0.680, 0.97, 0.98),
        (0.735, 1.00, 1.00),  # V1
        (0.770, 1.03, 0.96),
        (0.800, 1.10, 0.82),  # shoulder
        (0.825, 0.86, 0.66),
        (0.845, 0.46, 0.50),  # neck
        (0.870, 0.36, 0.44),
    ]
)
BOTTOM, TOP = 0.495, 0.850  # where the trunk is cut off
ROUNDING = 30.0  # mm, of the edges there
WIDEST = 1.2  # beyond every section above (of the half-width)
LEAST_RATIO = 1e-9  # of the distance from the trunk's axis to that of the outline

# Ribs and all within, as the sections above; level, half-width and half-depth
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

# Centroid of the myocardium: to the left (mm), to the front (of the half-depth), below V1 (mm)
HEART_LEFT, HEART_FRONT, HEART_BELOW = 33.0, 0.335, 5.0
SKIN_MARGIN = 5.0  # mm that must remain between heart and skin
SMALLEST_LUNG = 0.3  # litres; the girth of the thinnest adult leaves more

SKIN_GRID, LUNG_GRID = 12.0, 8.0  # mm, of the level sets
GRID_MARGIN = 3  # steps of the grid around the box
LEAST_LEVEL = 0.05  # of that spacing
SKIN_EDGE, LUNG_EDGE = 11.0, 9.0  # mm, of the triangles


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
    heart = frame.to_body(mesh.vertices[np.unique(mesh.triangles)])
    skin = trunk(body)
    _check_fits(mesh.name, heart, skin)
    base = frame.to_body(np.stack([opening(side) for side in _endocardia(mesh)]))
    lungs = _lungs(mesh.name, body, _kept_clear(heart, base))
    electrodes = standard_electrodes(body, skin)
    surfaces = TorsoSurfaces(
        Surface(frame.to_heart(skin.vertices), skin.triangles),
        tuple(Surface(frame.to_heart(lung.vertices), lung.triangles) for lung in lungs),
        frame.to_heart(electrodes),
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
    centres = mesh.vertices[mesh.tetrahedra].mean(axis=1)
    centroid = np.average(centres, axis=0, weights=signed_volumes(mesh.vertices, mesh.tetrahedra))
    place = np.array([HEART_LEFT, -HEART_FRONT * body.half_depth, -HEART_BELOW])
    return body_frame(*_endocardia(mesh), centroid, place, pose)


def _endocardia(mesh: LabelledMesh) -> tuple[Surface, Surface]:
    """Left and right."""
    return (
        Surface(mesh.vertices, mesh.having(Label.LV_ENDOCARDIUM)),
        Surface(mesh.vertices, mesh.having(Label.RV_ENDOCARDIUM)),
    )


def trunk(body: BodySize) -> Surface:
    """Skin of the trunk in the body frame (mm)."""
    lower, upper = body.level(BOTTOM), body.level(TOP)
    widest = WIDEST * body.half_width

    def outside(points: Floats) -> Floats:
        ends = np.maximum(lower - points[:, 2], points[:, 2] - upper)
        return _smooth_max(_beyond_sections(body, SECTIONS, points), ends, ROUNDING)

    box = np.array([[-widest, -widest, lower], [widest, widest, upper]])
    return remeshed(_level_set(outside, box, SKIN_GRID), SKIN_EDGE)


def _beyond_sections(body: BodySize, sections: Floats, points: Floats) -> Floats:
    """About the distance (mm) of points to a stack of superellipses, negative inside."""
    level = np.array([body.level(fraction) for fraction in sections[:, 0]])
    half = PchipInterpolator(level, sections[:, 1:] * (body.half_width, body.half_depth))
    half = half(np.clip(points[:, 2], level[0], level[-1]))
    relative = (np.abs(points[:, :2] / half) ** SQUARENESS).sum(axis=1) ** (1 / SQUARENESS)
    # exact along x and along y, where the outline is that far away
    reach = np.linalg.norm(points[:, :2], axis=1) / np.maximum(relative, LEAST_RATIO)
    return np.asarray((relative - 1) * np.clip(reach, half.min(axis=1), half.max(axis=1)))


def _smooth_max(a: Floats, b: Floats, width: float) -> Floats:
    """The larger of two distances (n,), rounded off where they differ by less than a width (mm)."""
    overlap = np.maximum(width - np.abs(a - b), 0) / width
    return np.asarray(np.maximum(a, b) + overlap**2 * width / 4)


def _level_set(outside: Callable[[Floats], Floats], box: Floats, spacing: float) -> Surface:
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


def _kept_clear(heart: Floats, base: Floats) -> Surface:
    """Convex hull of the ventricles and of room for the atria behind them."""
    towards_atria = base.mean(axis=0) - heart.mean(axis=0)
    towards_atria *= ATRIA / np.linalg.norm(towards_atria)
    near_base = heart[(heart - base.mean(axis=0)) @ towards_atria > -ATRIA * ATRIA / NEAR_BASE]
    points = np.concatenate([heart, near_base + towards_atria])
    hull = ConvexHull(points)
    vertices, triangles = without_unused_vertices(points, hull.simplices)
    outward = hull.equations[:, :3]
    inverted = np.einsum("ij,ij->i", triangle_normals(vertices, triangles), outward) < 0
    triangles[inverted] = triangles[inverted, ::-1]
    return Surface(vertices, triangles)


def _lungs(name: str, body: BodySize, clear: Surface) -> tuple[Surface, Surface]:
    """Left and right lung in the body frame (mm)."""
    lungs = []
    for side, which in ((1, "left"), (-1, "right")):
        lung = _lung(body, clear, side)
        if lung is None or lung.litres < SMALLEST_LUNG:
            raise InputError(
                f"{name}: leaves no room for the {which} lung in the idealised torso; check pose "
                "and units, or give a larger height, weight or chest girth"
            )
        lungs.append(lung)
    return lungs[0], lungs[1]


def _lung(body: BodySize, clear: Surface, side: int) -> Surface | None:
    """One lung: within the ribs, beside the mediastinum and the heart, above the diaphragm."""
    half_width, half_depth = body.half_width, body.half_depth
    height = MM_PER_M * body.height

    def outside(points: Floats) -> Floats:
        x, y, z = side * points[:, 0], points[:, 1] / half_depth, points[:, 2]
        ribs = _beyond_sections(body, CAGE, points)
        front, back = MEDIASTINUM
        widening = 1 + np.exp(-MEDIASTINUM_STEEPNESS * (y - MEDIASTINUM_MIDDLE))
        middle = half_width * (front + (back - front) / widening)
        radius = np.hypot((x / half_width - DOME_MIDDLE) / DOME_REACH[0], y / DOME_REACH[1])
        dome = body.level(DOMES[side]) - height * (DOME_DROP * radius**2 + DOME_TILT * y)
        beyond = _smooth_max(ribs, middle - x, BLEND)
        beyond = _smooth_max(beyond, dome - z, BLEND)
        beyond = _smooth_max(beyond, z - body.level(LUNG_TOP), BLEND)
        inside = beyond < 2 * LUNG_GRID  # elsewhere the heart makes no difference
        heart = CLEARANCE - signed_distance(points[inside], clear)
        beyond[inside] = _smooth_max(beyond[inside], heart, BLEND)
        return beyond

    reach = np.array([half_width, half_depth])
    lower, upper = body.level(CAGE[0, 0]), body.level(LUNG_TOP)
    box = np.stack([np.append(-reach, lower), np.append(reach, upper)])
    surface = _level_set(outside, box, LUNG_GRID)
    return remeshed(surface, LUNG_EDGE) if len(surface.triangles) else None
