"""Ambient occlusion: how much of the half space before each triangle of a surface is open."""

from __future__ import annotations

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.classification.dual_graph import DualGraph
from fascicle.core.arrays import Floats, Integers
from fascicle.core.progress import StageProgress, no_progress
from fascicle.mesh.measures import unit

MOST_SAMPLES = 6000  # triangles that rays leave from; the others take it from the nearest of them
RAYS = 48  # of each triangle
CHUNK = 500  # triangles whose rays are traced at once
CLEARANCE = 1e-3  # mm, of a ray's origin from its own triangle
NEIGHBOURS = 4  # samples that a triangle's openness is averaged over
FACING = 10.0  # mm by which samples that face away count as farther, for one of unit length


def openness(graph: DualGraph, progress: StageProgress = no_progress) -> Floats:
    """Give one minus the ambient occlusion of each triangle, by Lambert's cosine.

    Rays leave over the half space before a triangle and either meet the surface again or do not;
    a triangle on a plane is open (1), one in a well is not (0).

    Parameters
    ----------
    graph : DualGraph
        The closed surface.
    progress : StageProgress
        Called with the triangles done and in all.

    Returns
    -------
    (m,) array
        Openness from 0 to 1.

    Notes
    -----
    `igl.ambient_occlusion` serves less well: it has no cosine, its rays come from a global random
    generator, so labels differ from run to run, and it takes 14 s for the 50,000 triangles of a
    statistical mean heart with as many rays, where this takes 5 s. The two correlate by 0.994.
    """
    count = len(graph.triangles)
    chosen = np.arange(count)
    if count > MOST_SAMPLES:
        share = graph.areas / graph.areas.sum()
        chosen = np.random.default_rng(0).choice(count, MOST_SAMPLES, replace=False, p=share)
    tree = igl.AABB()
    tree.init(graph.vertices, graph.triangles)
    directions = _cosine_directions()
    seen = np.empty(len(chosen))
    for start in range(0, len(chosen), CHUNK):
        some = chosen[start : start + CHUNK]
        normals = graph.normals[some]
        rays = np.einsum("rk,skj->srj", directions, _tangent_frames(normals)).reshape(-1, 3)
        origins = np.repeat(graph.centres[some] + CLEARANCE * normals, RAYS, axis=0)
        met, _, _ = tree.intersect_ray_first(
            graph.vertices, graph.triangles, origins, np.ascontiguousarray(rays)
        )
        seen[start : start + CHUNK] = (met.reshape(-1, RAYS) < 0).mean(axis=1)
        progress(min(start + CHUNK, len(chosen)), len(chosen))
    return _spread(graph, chosen, seen)


def _spread(graph: DualGraph, chosen: Integers, seen: Floats) -> Floats:
    """Average the nearest samples that face the same way, not those across a thin wall."""
    place = np.hstack([graph.centres, FACING * graph.smooth_normals])
    _, nearest = cKDTree(place[chosen]).query(place, k=NEIGHBOURS)
    return np.asarray(seen[nearest].mean(axis=1))


def _cosine_directions() -> Floats:
    """Directions of the half space about z by the cosine law: a sunflower's seeds, lifted."""
    golden = np.pi * (3 - np.sqrt(5))
    radius = np.sqrt((np.arange(RAYS) + 0.5) / RAYS)
    angle = golden * np.arange(RAYS)
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1
    )


def _tangent_frames(normals: Floats) -> Floats:
    """Two tangents and the normal for each normal, shape (k, 3, 3)."""
    aside = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = unit(np.cross(normals, aside))
    return np.stack([first, np.cross(normals, first), normals], axis=1)
