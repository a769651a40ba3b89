"""Where the bundles enter, when the user does not say."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import Endocardium, long_axis
from fascicle.mesh.measures import unit
from fascicle.mesh.topology import boundary_loops

# Depth below the base, as a fraction of the way to the apex, at which the seeds are looked for:
# the bundle branches appear subendocardially in the upper septum.
ROOT_DEPTH = (0.08, 0.22)
DIRECTION_DEPTH = (0.4, 0.55)
NEXT_TO_BAND = 0.05
FURTHEST_SEED = 5.0  # mm that a chosen seed may lie from the endocardium

# A vertex by its number, a position (mm), or neither: then the anatomy decides
ChosenSeed = int | tuple[float, float, float] | None


def septal_seeds(
    vertices: Floats, triangles: Integers, opposite: Floats, valves: Booleans | None = None
) -> tuple[int, int]:
    """Root near the base and direction towards the apex, both in the middle of the septum.

    The septum is where this endocardium comes nearest to the other ventricle's.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        This endocardium (mm).
    opposite : (k, 3) array
        Vertices of the other ventricle's endocardium (mm).
    valves : (m,) array, optional
        Triangles that span a valve opening; no bundle starts there.

    Returns
    -------
    root, direction : int
        Vertex indices.
    """
    loop = boundary_loops(triangles)[0]
    base, apex = long_axis(vertices, triangles)
    axis = unit(apex - base)
    depth = (vertices - base) @ axis / np.linalg.norm(apex - base)
    to_other, _ = cKDTree(opposite).query(vertices)
    inner = np.ones(len(vertices), dtype=bool)
    inner[loop] = False
    if valves is not None:
        inner[triangles[valves]] = False
    direction = _nearest_in(DIRECTION_DEPTH, depth, to_other, inner)
    # of the septal vertices near the base, the one from which the way down is straightest
    sideways = vertices - vertices[direction]
    sideways = np.linalg.norm(sideways - np.outer(sideways @ axis, axis), axis=1)
    root = _nearest_in(ROOT_DEPTH, depth, to_other + sideways, inner)
    return root, direction


def seeded_endocardia(
    surfaces: Mapping[str, tuple[str, Floats, Integers, Booleans | None]],
    chosen: Mapping[str, tuple[ChosenSeed, ChosenSeed]],
) -> tuple[Endocardium, Endocardium]:
    """LV and RV endocardium with root and direction as chosen, or as the anatomy suggests.

    Parameters
    ----------
    surfaces : mapping of side to (name, vertices, triangles, valves)
        What to call each in an error, and the surfaces as in `septal_seeds`.
    chosen : mapping of side to (root, direction)
        Each the number of a vertex, a position (mm), or None to have it found.

    Raises
    ------
    InputError
        If a seed is not on the endocardium, or both are one.
    """
    seeded = []
    for side, other in (("lv", "rv"), ("rv", "lv")):
        name, vertices, triangles, valves = surfaces[side]
        found = septal_seeds(vertices, triangles, surfaces[other][1], valves)
        root, direction = (
            _chosen(f"{name}: {side.upper()} {what}", seed, vertices) if seed is not None else own
            for what, seed, own in zip(("root", "direction"), chosen[side], found, strict=True)
        )
        if root == direction:
            raise InputError(
                f"{name}: {side.upper()} root and direction are the same point ({root}); give two "
                "different ones"
            )
        seeded.append(Endocardium(side, vertices, triangles, root, direction, valves))
    return seeded[0], seeded[1]


def _chosen(name: str, seed: int | tuple[float, float, float], vertices: Floats) -> int:
    if isinstance(seed, int):
        if not 0 <= seed < len(vertices):
            raise InputError(
                f"{name} {seed} is not one of its points; give a number from 0 to "
                f"{len(vertices) - 1}"
            )
        return seed
    distance = np.linalg.norm(vertices - np.array(seed), axis=1)
    nearest = int(np.argmin(distance))
    if not distance[nearest] <= FURTHEST_SEED:
        where = ", ".join(f"{x:g}" for x in seed)
        raise InputError(
            f"{name} ({where}) is {distance[nearest]:.1f} mm from the endocardium; give a "
            f"position on it (within {FURTHEST_SEED:g} mm), in the heart's frame"
        )
    return nearest


def _nearest_in(band: tuple[float, float], depth: Floats, score: Floats, allowed: Booleans) -> int:
    beyond = np.maximum(np.maximum(band[0] - depth, depth - band[1]), 0)
    nearest = float(beyond[allowed].min())
    # a coarse surface may have no vertex in the band: then those next to it
    inside = allowed & (beyond <= (nearest + NEXT_TO_BAND if nearest > 0 else 0))
    return int(np.argmin(np.where(inside, score, np.inf)))
