"""Endocardial surfaces: open at the base, one boundary loop, normals into the cavity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.ranges import short_repr
from fascicle.mesh.checks import check_edges, open_loops, oriented_piece
from fascicle.mesh.measures import closed_by_fan, triangle_areas, unit
from fascicle.mesh.topology import boundary_loops

# A vertex by its number, a position (mm), or neither: then the anatomy decides
ChosenSeed = int | tuple[float, float, float] | None


@dataclass(frozen=True)
class Endocardium:
    """Endocardial surface of one ventricle, ``"lv"`` or ``"rv"``, with the entry of its bundle.

    Vertices (n, 3) (mm); triangles (m, 3), counter-clockwise seen from inside the cavity; the
    vertex where the bundle starts, and one that it heads for; and perhaps which triangles (m,) span
    a valve opening within the surface, under which there is no tissue, and which have no Purkinje
    fibres. Purkinje networks end at both.
    """

    side: str
    vertices: Floats
    triangles: Integers
    root: int
    direction: int
    valves: Booleans | None = None
    bare: Booleans | None = None

    __repr__ = short_repr

    @property
    def area(self) -> float:
        """Surface area (mm²)."""
        return float(triangle_areas(self.vertices, self.triangles).sum())


def oriented_into_cavity(vertices: Floats, triangles: Integers, name: str) -> Integers:
    """Triangles (m, 3) of an endocardium, counter-clockwise seen from inside the cavity.

    An error if the surface, called `name`, is not one manifold piece with the topology of a disk.
    """
    check_edges(name, vertices, triangles)
    oriented = oriented_piece(name, vertices, triangles, "the one that is the endocardium")
    open_loops(name, vertices, oriented)
    euler = np.unique(oriented).size - len(igl.edges(oriented)) + len(oriented)
    if euler != 1:
        raise InputError(
            f"{name}: the surface has handles (Euler characteristic {euler}, a disk has 1); repair "
            "or remesh it"
        )
    if closed_by_fan(vertices, oriented)[0] > 0:  # normals point away from the cavity
        oriented = oriented[:, ::-1]
    return np.ascontiguousarray(oriented, dtype=np.int64)


Axis = tuple[Floats, Floats]  # middle of an opening and apex, (3,) each (mm)


def long_axis(vertices: Floats, triangles: Integers, left: Axis | None = None) -> Axis:
    """Middle of an endocardium's opening, and its apex: the vertex furthest from there (mm).

    Of a right ventricle, whose outflow tract may be further, only vertices in the apical half of
    the `left` axis count.
    """
    base = vertices[boundary_loops(triangles)[0]].mean(axis=0)
    distance = np.linalg.norm(vertices - base, axis=1)
    if left is not None:
        middle, down = (left[0] + left[1]) / 2, left[1] - left[0]
        distance[(vertices - middle) @ down < 0] = 0
    return np.asarray(base), np.asarray(vertices[np.argmax(distance)])


def about_long_axis(
    vertices: Floats, triangles: Integers, points: Floats, left: Axis | None = None
) -> tuple[Floats, Floats, Floats]:
    """Points (n, 3) about the `long_axis` of an endocardium.

    Height (n,), 0 at the opening and 1 at the apex; offset from the axis (n, 3) (mm); and the unit
    direction (3,) to the apex.
    """
    base, apex = long_axis(vertices, triangles, left)
    away, down = points - base, unit(apex - base)
    height = away @ down / np.linalg.norm(apex - base)
    return height, away - np.outer(away @ down, down), down


def septal_seeds(
    vertices: Floats,
    triangles: Integers,
    opposite: Floats,
    valves: Booleans | None = None,
    left: Axis | None = None,
) -> tuple[int, int]:
    """Root near the base and direction towards the apex: vertices in the middle of the septum.

    The septum is where this endocardium is near the vertices `opposite` (k, 3) of the other one.
    Its middle is in the plane through the long axis and the mean of those vertices; the nearest
    vertices would be wrong, as the septum is thinnest where it joins the free walls. The bundle
    branches become subendocardial in the upper septum; roots are not on a valve. `left` is as in
    `long_axis`.
    """
    depth, around, axis = about_long_axis(vertices, triangles, vertices, left)
    middle = about_long_axis(vertices, triangles, opposite, left)[1].mean(axis=0)
    across = around @ np.cross(axis, unit(middle))
    to_other, _ = cKDTree(opposite).query(vertices)
    score = to_other + np.abs(across)
    allowed = np.ones(len(vertices), dtype=bool)
    allowed[boundary_loops(triangles)[0]] = False
    if valves is not None:
        allowed[triangles[valves]] = False

    def best(low: float, high: float) -> int:
        beyond = np.maximum(np.maximum(low - depth, depth - high), 0)
        nearest = float(beyond[allowed].min())
        # a coarse surface may have no vertex in the band: then those nearest to it, within 5 %
        inside = allowed & (beyond <= (nearest + 0.05 if nearest > 0 else 0))
        return int(np.argmin(np.where(inside, score, np.inf)))

    # bands of the depth below the base, as a fraction of the way to the apex
    return best(0.08, 0.22), best(0.4, 0.55)


def seeded_endocardia(
    surfaces: Mapping[str, tuple[str, Floats, Integers, Booleans | None]],
    chosen: Mapping[str, tuple[ChosenSeed, ChosenSeed]],
) -> tuple[Endocardium, Endocardium]:
    """LV and RV endocardium with root and direction as chosen, or as the anatomy suggests.

    Surfaces are, by side, a name for errors, and vertices, triangles and valves as in
    `septal_seeds`.
    """
    seeded, left = [], long_axis(*surfaces["lv"][1:3])
    for side, other in (("lv", "rv"), ("rv", "lv")):
        name, vertices, triangles, valves = surfaces[side]
        suggestions = septal_seeds(vertices, triangles, surfaces[other][1], valves, left)
        seeds = zip(("root", "direction"), chosen[side], suggestions, strict=True)
        root, direction = (
            suggested if seed is None else _vertex(f"{name}: {side.upper()} {role}", seed, vertices)
            for role, seed, suggested in seeds
        )
        if root == direction:
            raise InputError(
                f"{name}: {side.upper()} root and direction are the same point ({root}); give two "
                "different ones"
            )
        seeded.append(Endocardium(side, vertices, triangles, root, direction, valves))
    return seeded[0], seeded[1]


def _vertex(name: str, seed: int | tuple[float, float, float], vertices: Floats) -> int:
    """Vertex by its number, or the one nearest to a position (mm)."""
    if isinstance(seed, int):
        if not 0 <= seed < len(vertices):
            raise InputError(
                f"{name} {seed} is not one of its points; give a number from 0 to "
                f"{len(vertices) - 1}"
            )
        return seed
    distance = np.linalg.norm(vertices - np.array(seed), axis=1)
    nearest = int(np.argmin(distance))
    if not distance[nearest] <= 5:  # mm
        where = ", ".join(f"{x:g}" for x in seed)
        raise InputError(
            f"{name} ({where}) is {distance[nearest]:.1f} mm from the endocardium; give a "
            "position on it (within 5 mm), in the heart's frame"
        )
    return nearest
