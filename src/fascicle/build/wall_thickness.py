"""How thick the walls of the ventricles are."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledMesh, LabelledSurface

# How thick a layer of regular tetrahedra of edge length 1 is that lie as flat as they can, between
# two opposite edges.
LAYER = np.sqrt(0.5)
LAYERS = 2.0  # that the wall must have room for


@dataclass(frozen=True)
class WallThickness:
    """The thickness of one wall.

    Attributes
    ----------
    vertices : (k,) array
        Vertices of the endocardium that the wall belongs to.
    thickness : (k,) array
        The distance from each to the other side of the wall (mm).
    """

    vertices: Integers
    thickness: Floats

    @property
    def median(self) -> float:
        """The thickness that a half of the wall exceeds (mm); NaN where there is no wall."""
        return float(np.median(self.thickness)) if self.thickness.size else float("nan")


@dataclass(frozen=True)
class Walls:
    """The free wall of the left ventricle, the septum, and the free wall of the right one."""

    lv: WallThickness
    septum: WallThickness
    rv: WallThickness


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
        lv=WallThickness(of_left[~is_septum], outwards[~is_septum]),
        septum=WallThickness(of_left[is_septum], across[is_septum]),
        rv=WallThickness(of_right[is_free], rv_outwards[is_free]),
    )


def _distances(vertices: Floats, at: Integers, to: Integers) -> Floats:
    squared, _, _ = igl.point_mesh_squared_distance(vertices[at], vertices, to)
    return np.asarray(np.sqrt(squared))


def check_edge_length(walls: Walls, edge_length: float, name: str) -> None:
    """Refuse an edge length for which the walls are too thin.

    The median thickness of each wall must have room for two layers of tetrahedra even where they
    lie as flat as they can (an edge length over √2 each). As medians count, a few thin places do
    not matter, such as those at the apex and next to the base.

    Parameters
    ----------
    walls : Walls
        Their thickness.
    edge_length : float
        Of the tetrahedra (mm).
    name : str
        What to call the heart in messages.

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
