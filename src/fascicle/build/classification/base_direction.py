"""The way up out of the wall at the openings of the cavities."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.classification.dual_graph import DualGraph
from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.measures import unit

REACH = 10.0  # mm along the edge of an opening over which its direction is taken
FARTHEST = 50.0  # mm from an opening to which the base may reach


def cosine_to_base(graph: DualGraph, regions: Integers) -> Floats:
    """Cosine between each triangle's normal and the way up out of the wall.

    Up is normal to the plane of the nearest opening and, since rims undulate, to the opening's
    edge.

    Parameters
    ----------
    graph : DualGraph
        The closed surface.
    regions : (m,) array
        0 and 1 in the cavities, 2 outside them.

    Returns
    -------
    (m,) array
        Cosines; -1 farther than `FARTHEST` from both openings.
    """
    sides = regions[graph.edges[0]]
    middle = graph.vertices[graph.edges[1]].mean(axis=1)
    edges, directions = [], []
    for cavity in (0, 1):
        edge = middle[(sides == cavity).sum(axis=1) == 1]
        inside = graph.centres[regions == cavity].mean(axis=0)
        edges.append(edge)
        directions.append(_upwards(edge, inside))
    distance, nearest = cKDTree(np.vstack(edges)).query(graph.centres)
    up = np.vstack(directions)[nearest]
    cosine = np.einsum("ij,ij->i", graph.smooth_normals, up)
    return np.where(distance > FARTHEST, -1.0, cosine)


def _upwards(edge: Floats, inside: Floats) -> Floats:
    """Unit vectors up out of the wall at the points of an opening's edge."""
    centre = edge.mean(axis=0)
    normal = np.linalg.svd(edge - centre, full_matrices=False)[2][2]
    normal *= np.sign(normal @ (centre - inside))
    tangents = []
    for near in cKDTree(edge).query_ball_point(edge, REACH):
        piece = edge[near] - edge[near].mean(axis=0)
        tangents.append(np.linalg.svd(piece, full_matrices=False)[2][0])
    along = np.array(tangents)
    return unit(normal - (along @ normal)[:, np.newaxis] * along)
