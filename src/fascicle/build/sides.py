"""Which of two endocardia is the left one."""

from __future__ import annotations

import igl
import numpy as np
from scipy.spatial import ConvexHull

from fascicle.build.wall_thickness import wall_thickness
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh, LabelledSurface
from fascicle.mesh.measures import closed_volume, triangle_areas

Surface = tuple[Floats, Integers]  # vertices (n, 3) in mm, triangles (m, 3)

FREE_WALL = 40.0  # percentile of the distances to the epicardium that stands for the free wall
# `leftness` of the left endocardium below which the two are taken for swapped: neither a right
# ventricle with a thick wall nor a round one is refused for that alone.
SWAPPED = -0.5


def leftness(one: Surface, other: Surface, epicardium: Surface) -> float:
    """How much more the first of two endocardia looks like the left one than the second does.

    The left cavity is nearly convex and round, and its wall is thick; the right one is a crescent
    about the septum with a thin free wall. The logarithms of the three ratios, each of which
    speaks for the left where it is larger, are added.

    Parameters
    ----------
    one, other, epicardium : pair of (n, 3) and (m, 3) arrays
        Vertices (mm) and triangles of surfaces that are open at the base.

    Returns
    -------
    float
        Positive where the first one is the left one.
    """
    first, second = (_features(endocardium, epicardium) for endocardium in (one, other))
    return float(np.log(first / second).sum())


def check_sides(name: str, epicardium: Surface, lv: Surface, rv: Surface) -> None:
    """Refuse endocardia that seem to have each other's label.

    Parameters
    ----------
    name : str
        What to call the heart in messages.
    epicardium, lv, rv : pair of (n, 3) and (m, 3) arrays
        Vertices (mm) and triangles of surfaces that are open at the base.

    Raises
    ------
    InputError
        With the shape of both cavities and the thickness of both walls.
    """
    if leftness(lv, rv, epicardium) < SWAPPED:
        (left, _, lv_wall), (right, _, rv_wall) = (_features(side, epicardium) for side in (lv, rv))
        raise _swapped(name, (left, right), (lv_wall, rv_wall))


def check_labelled_sides(body: LabelledSurface | LabelledMesh) -> None:
    """Refuse a body whose endocardia seem to have each other's label.

    This asks less than `check_sides`, which must not refuse parts for one strange feature: the one
    labelled LV has the thinner free wall (median) and fills less of its convex hull. `leftness`
    misses that where the walls are nearly as thick.
    """
    epicardium, lv, rv = (
        (body.vertices, body.having(label))
        for label in (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    )
    walls = wall_thickness(body)
    left, right = (_features(endocardium, epicardium)[0] for endocardium in (lv, rv))
    if walls.lv.median < walls.rv.median and left < right:
        raise _swapped(body.name, (left, right), (walls.lv.median, walls.rv.median))


def _swapped(name: str, share: tuple[float, float], wall: tuple[float, float]) -> InputError:
    """The error, with the share of its hull that each cavity fills, and each wall (mm)."""
    return InputError(
        f"{name}: LV and RV endocardium seem to be swapped: the cavity labelled LV fills "
        f"{share[0]:.0%} of its convex hull behind a wall of {wall[0]:.1f} mm, the one labelled "
        f"RV {share[1]:.0%} behind {wall[1]:.1f} mm; exchange the two"
    )


def cavity_volume(vertices: Floats, triangles: Integers) -> float:
    """Volume between an open surface and a fan over its opening (mm³), however it is oriented."""
    return _capped(vertices, triangles)[0]


def _features(endocardium: Surface, epicardium: Surface) -> Floats:
    """Share of its convex hull that a cavity fills; 36πV²/A³ (1 for a ball); free wall (mm)."""
    vertices, triangles = endocardium
    own = np.ascontiguousarray(vertices[np.unique(triangles)])
    volume, cap = _capped(vertices, triangles)
    area = float(triangle_areas(vertices, triangles).sum()) + cap
    squared = igl.point_mesh_squared_distance(own, *epicardium)[0]
    wall = np.sqrt(np.percentile(squared, FREE_WALL))
    return np.array([volume / ConvexHull(own).volume, 36 * np.pi * volume**2 / area**3, wall])


def _capped(vertices: Floats, triangles: Integers) -> tuple[float, float]:
    """Volume of an open surface closed by a fan (mm³), and the fan's area (mm²)."""
    rim = np.asarray(igl.boundary_facets(triangles)[0], dtype=np.int64)
    centred = vertices - vertices[np.unique(rim)].mean(axis=0)  # the fan adds no volume there
    fan = np.cross(centred[rim[:, 0]], centred[rim[:, 1]]) / 2
    return abs(closed_volume(centred, triangles)), float(np.linalg.norm(fan, axis=1).sum())
