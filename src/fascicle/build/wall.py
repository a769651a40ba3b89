"""The walls of the ventricles: how thick they are, and which ventricle is which."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh, LabelledSurface
from fascicle.mesh.topology import boundary_loops

# How thick a layer of regular tetrahedra of edge length 1 is that lie as flat as they can, between
# two opposite edges.
LAYER = np.sqrt(0.5)
LAYERS = 2.0  # that the wall must have room for


@dataclass(frozen=True)
class Wall:
    """The thickness of one wall.

    Attributes
    ----------
    vertices : (k,) array
        Vertices of the endocardium that the wall belongs to.
    thickness : (k,) array
        The distance from each to the other side of the wall (mm).
    """

    vertices: NDArray[np.int64]
    thickness: NDArray[np.float64]

    @property
    def median(self) -> float:
        """The thickness that a half of the wall exceeds (mm); NaN where there is no wall."""
        return float(np.median(self.thickness)) if self.thickness.size else float("nan")


@dataclass(frozen=True)
class Walls:
    """The free wall of the left ventricle, the septum, and the free wall of the right one."""

    lv: Wall
    septum: Wall
    rv: Wall


def wall_thickness(body: LabelledSurface | LabelledMesh) -> Walls:
    """How thick the walls are at each vertex of the endocardia.

    The thickness at a vertex is its distance to the other side: the epicardium for the free walls,
    the right endocardium for the septum. A vertex of the left endocardium belongs to the septum
    where the right endocardium is nearer than the epicardium; the septal part of the right one is
    left out. The distance never exceeds the thickness along any other direction.

    Parameters
    ----------
    body : LabelledSurface or LabelledMesh
        With both endocardia and the epicardium labelled.
    """
    epicardium, left, right = (
        body.having(label)
        for label in (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    )
    of_left, of_right = np.unique(left), np.unique(right)
    outwards, across = (_distances(body.vertices, of_left, side) for side in (epicardium, right))
    rv_outwards, rv_across = (
        _distances(body.vertices, of_right, side) for side in (epicardium, left)
    )
    is_septum, is_free = across < outwards, rv_outwards <= rv_across
    return Walls(
        lv=Wall(of_left[~is_septum], outwards[~is_septum]),
        septum=Wall(of_left[is_septum], across[is_septum]),
        rv=Wall(of_right[is_free], rv_outwards[is_free]),
    )


def _distances(
    vertices: NDArray[np.float64], at: NDArray[np.int64], to: NDArray[np.int64]
) -> NDArray[np.float64]:
    squared, _, _ = igl.point_mesh_squared_distance(vertices[at], vertices, to)
    return np.asarray(np.sqrt(squared))


def check_edge_length(walls: Walls, edge_length: float, name: str) -> None:
    """Refuse an edge length for which the walls are too thin.

    The median thickness of each wall must have room for two layers of tetrahedra even where they
    lie as flat as they can (an edge length over √2 each). By the median a few thin places, as
    there are at the apex and next to the base, refuse nothing.

    Raises
    ------
    InputError
        Names the thinnest wall, its thickness, and the edge length that it needs.
    """
    medians = {
        "left ventricle's free wall": walls.lv.median,
        "septum": walls.septum.median,
        "right ventricle's free wall": walls.rv.median,
    }
    there = {wall: median for wall, median in medians.items() if np.isfinite(median)}
    thinnest = min(there, key=lambda wall: there[wall])
    largest = there[thinnest] / (LAYERS * LAYER)
    if edge_length > largest:
        raise InputError(
            f"{name}: an edge length of {edge_length:g} mm is too coarse for the {thinnest}, "
            f"{there[thinnest]:.2g} mm thick (median): fewer than two elements fit across; give "
            f"{np.floor(largest * 100) / 100:.2f} mm or less"
        )


def check_not_swapped(surface: LabelledSurface | LabelledMesh) -> None:
    """Refuse a body whose left and right endocardium have each other's label.

    The left ventricle has the thicker free wall and the rounder cavity: the right one is bent
    around it. Where both say the opposite of the labels these are swapped. One alone does not
    refuse: a hypertrophied right ventricle has a thick wall, and a dilated one is round.

    Raises
    ------
    InputError
        With both thicknesses and roundnesses.
    """
    walls = wall_thickness(surface)
    left, right = (
        _convexity(surface.vertices, surface.having(label))
        for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    )
    if walls.lv.median < walls.rv.median and left < right:
        raise InputError(
            f"{surface.name}: LV and RV endocardium seem to be swapped: the wall around the one "
            f"labelled LV is {walls.lv.median:.1f} mm thick and its cavity fills {left:.0%} of its "
            f"convex hull, for RV {walls.rv.median:.1f} mm and {right:.0%}; exchange the two labels"
        )


def _convexity(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """The share of its convex hull that a cavity fills, its openings closed by fans."""
    closed = [triangles]
    points = [vertices]
    for loop in boundary_loops(triangles):
        centre = len(vertices) + len(points) - 1
        points.append(vertices[loop].mean(axis=0, keepdims=True))
        closed.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), centre)]))
    a, b, c = np.concatenate(points)[np.concatenate(closed)].transpose(1, 0, 2)
    volume = abs(float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6))
    return volume / float(ConvexHull(vertices[np.unique(triangles)]).volume)
