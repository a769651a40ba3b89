"""Checks on surfaces of the ventricles: volumes, wall thickness, left and right."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import long_axis
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledMesh, LabelledSurface
from fascicle.mesh.measures import closed_by_fan, closed_volume, triangle_areas, unit
from fascicle.mesh.topology import without_unused_vertices

Surface = tuple[Floats, Integers]  # vertices (n, 3) in mm, triangles (m, 3)


class Volumes(NamedTuple):
    """Volumes (ml) of the cavities, closed at their openings by fans, and of the myocardium."""

    lv: float
    rv: float
    myocardium: float


def volumes(tissue: LabelledSurface | LabelledMesh) -> Volumes:
    """Volumes of a closed labelled surface or of a mesh."""
    lv, rv = (abs(closed_by_fan(*tissue.part(label))[0]) / 1e3 for label in ENDOCARDIA)
    return Volumes(lv, rv, closed_volume(tissue.vertices, tissue.triangles) / 1e3)


def compared(built: Volumes, reference: Volumes, file: str) -> tuple[str, tuple[str, ...]]:
    """Line that compares the built volumes with the reference, and warnings where they differ."""
    rows, warnings, largest = [], [], 0.03  # change of a volume without a warning
    for part, volume, expected in zip(
        ("LV cavity", "RV cavity", "myocardium"), built, reference, strict=True
    ):
        change = volume / expected - 1 if expected > 0 else np.inf
        rows.append(f"{part} {volume:.1f} ml (input {expected:.1f}, {change:+.1%})")
        if abs(change) > largest:
            warnings.append(
                f"{file}: {part} {volume:.1f} ml, {expected:.1f} ml in the file ({change:+.1%}, "
                f"more than {largest:.0%}); give a shorter edge length, or correct the file "
                "where it was cut or filled (see the lines above)"
            )
    return f"volumes: {'; '.join(rows)}", tuple(warnings)


class Walls(NamedTuple):
    """Thickness (mm) of each wall at the vertices (k,) of its endocardium."""

    lv: Floats  # free wall
    septum: Floats
    rv: Floats  # free wall


def median_thickness(wall: Floats) -> float:
    """Median of a wall's thickness (mm); NaN where there is no wall."""
    return float(np.median(wall)) if wall.size else float("nan")


def wall_thickness(tissue: LabelledSurface | LabelledMesh) -> Walls:
    """Thickness of the walls at each vertex of the endocardia (mm).

    The thickness at a vertex is its distance to the other side: the epicardium for the free walls,
    the right endocardium for the septum. A vertex of the left endocardium belongs to the septum
    where the right endocardium is nearer than the epicardium; the septal part of the right one is
    left out. The distance never exceeds the thickness along any other direction.
    """
    vertices, epicardium = tissue.vertices, tissue.having(Label.EPICARDIUM)
    left, right = map(tissue.having, ENDOCARDIA)

    def distances(of: Integers, to: Integers) -> Floats:
        at = vertices[np.unique(of)]
        return np.asarray(np.sqrt(igl.point_mesh_squared_distance(at, vertices, to)[0]))

    outwards, across = distances(left, epicardium), distances(left, right)
    rv_outwards = distances(right, epicardium)
    is_septum, is_free = across < outwards, rv_outwards <= distances(right, left)
    return Walls(outwards[~is_septum], across[is_septum], rv_outwards[is_free])


def check_edge_length(walls: Walls, edge_length: float, name: str) -> None:
    """Refuse an edge length (mm) for which the walls are too thin.

    The median thickness of each wall must have room for two layers of tetrahedra even where they
    lie as flat as they can (an edge length over √2 each). A few thin places, such as those at the
    apex and next to the base, do not matter.
    """
    names = ("left ventricle's free wall", "septum", "right ventricle's free wall")
    thickness, thinnest = min(
        (median_thickness(wall), name) for name, wall in zip(names, walls, strict=True) if wall.size
    )
    largest = thickness / (2 * np.sqrt(0.5))
    if edge_length > largest:
        raise InputError(
            f"{name}: an edge length of {edge_length:g} mm is too coarse for the {thinnest}, "
            f"{thickness:.2g} mm thick (median): fewer than two elements fit across; give "
            f"{np.floor(largest * 100) / 100:.2f} mm or less"
        )


def leftness(first: Surface, second: Surface, epicardium: Surface) -> float:
    """Evidence that the first of two endocardia, rather than the second, is the left one.

    The left cavity is nearly convex and round, and its wall is thick; the right one is a crescent
    about the septum with a thin free wall. The evidence is the sum of the logarithms of the ratios
    of these three features, first over second: positive where the first is the left one.
    """
    ratios = _features(first, epicardium) / _features(second, epicardium)
    return float(np.log(ratios).sum())


def check_sides(tissue: LabelledSurface | LabelledMesh) -> None:
    """Refuse endocardia whose labels seem to be swapped.

    The cavity labelled LV then has the thinner free wall (median) and fills less of its convex
    hull: neither a right ventricle with a thick wall nor a round one is refused for that alone.
    """
    epicardium, lv, rv = map(tissue.part, (Label.EPICARDIUM, *ENDOCARDIA))
    walls = wall_thickness(tissue)
    thick, thin = median_thickness(walls.lv), median_thickness(walls.rv)
    left, right = (_features(endocardium, epicardium)[0] for endocardium in (lv, rv))
    if thick < thin and left < right:
        raise InputError(
            f"{tissue.name}: LV and RV endocardium seem to be swapped: the cavity labelled LV "
            f"fills {left:.0%} of its convex hull behind a wall of {thick:.1f} mm, the "
            f"one labelled RV {right:.0%} behind {thin:.1f} mm; exchange the two"
        )


def mirror_warning(mesh: LabelledMesh, space: str) -> tuple[str, ...]:
    """Warning, if any, that the heart seems to be mirrored.

    Its apex then points to the right, its right ventricle lies to the left, and their cross product
    points up instead of down. This can be seen only in the patient's coordinates (the space
    ``"RAS"`` or ``"LPS"``) and if the long axis is as oblique as in a chest: a map along the axes
    of its image shows nothing.
    """
    if space not in ("RAS", "LPS"):
        return ()
    left, right = (without_unused_vertices(*mesh.part(label)) for label in ENDOCARDIA)
    base, apex = long_axis(*left)
    to_right = np.array([1, 1, 1] if space == "RAS" else [-1, -1, 1])
    axis = unit(to_right * (apex - base))
    across = unit(to_right * (right[0].mean(axis=0) - left[0].mean(axis=0)))
    if axis[0] < 0.25 or across[0] > -0.25 or np.cross(axis, across)[2] < 0.25:
        return ()
    return (
        f"{mesh.name}: the apex points to the patient's right and the right ventricle lies to the "
        "left of the left one, so the map seems to be mirrored; unless the heart lies on the right "
        "side, check the orientation in the file's header",
    )


def _features(endocardium: Surface, epicardium: Surface) -> Floats:
    """Share of its convex hull that a cavity fills; 36πV²/A³ (1 for a ball); free wall (mm)."""
    vertices, triangles = endocardium
    points = np.ascontiguousarray(vertices[np.unique(triangles)])
    volume, cap = closed_by_fan(vertices, triangles)
    area = float(triangle_areas(vertices, triangles).sum()) + cap
    # the 40th percentile of the distances to the epicardium lies in the free wall
    wall = np.sqrt(np.percentile(igl.point_mesh_squared_distance(points, *epicardium)[0], 40.0))
    return np.array(
        [abs(volume) / ConvexHull(points).volume, 36 * np.pi * volume**2 / area**3, wall]
    )
