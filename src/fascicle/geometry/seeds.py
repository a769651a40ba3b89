"""Where the bundles enter, when the user does not say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fascicle.geometry.endocardium import boundary_loops

# Depth below the base, as a fraction of the way to the apex, at which the seeds are looked for:
# the bundle branches appear subendocardially in the upper septum.
ROOT_DEPTH = (0.08, 0.22)
DIRECTION_DEPTH = (0.4, 0.55)
NEXT_TO_BAND = 0.05


def septal_seeds(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    opposite: NDArray[np.float64],
) -> tuple[int, int]:
    """Root near the base and direction towards the apex, both in the middle of the septum.

    The septum is where this endocardium comes nearest to the other ventricle's.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        This endocardium (mm).
    opposite : (k, 3) array
        Vertices of the other ventricle's endocardium (mm).

    Returns
    -------
    root, direction : int
        Vertex indices.
    """
    loop = boundary_loops(triangles)[0]
    base = vertices[loop].mean(axis=0)
    apex = vertices[np.argmax(np.linalg.norm(vertices - base, axis=1))]
    axis = (apex - base) / np.linalg.norm(apex - base)
    depth = (vertices - base) @ axis / np.linalg.norm(apex - base)
    to_other, _ = cKDTree(opposite).query(vertices)
    inner = np.ones(len(vertices), dtype=bool)
    inner[loop] = False
    direction = _nearest_in(DIRECTION_DEPTH, depth, to_other, inner)
    # of the septal vertices near the base, the one from which the way down is straightest
    sideways = vertices - vertices[direction]
    sideways = np.linalg.norm(sideways - np.outer(sideways @ axis, axis), axis=1)
    root = _nearest_in(ROOT_DEPTH, depth, to_other + sideways, inner)
    return root, direction


def _nearest_in(
    band: tuple[float, float],
    depth: NDArray[np.float64],
    score: NDArray[np.float64],
    allowed: NDArray[np.bool_],
) -> int:
    beyond = np.maximum(np.maximum(band[0] - depth, depth - band[1]), 0)
    nearest = float(beyond[allowed].min())
    # a coarse surface may have no vertex in the band: then those next to it
    inside = allowed & (beyond <= (nearest + NEXT_TO_BAND if nearest > 0 else 0))
    return int(np.argmin(np.where(inside, score, np.inf)))
