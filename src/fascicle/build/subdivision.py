"""A closed surface that is coarse against the wanted edge length: a smooth finer one through it."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np

from fascicle.build.surface_repair import closed_surface
from fascicle.core.arrays import Floats, Integers
from fascicle.heart.labelled_surface import LabelledSurface
from fascicle.mesh.intersections import self_intersections
from fascicle.mesh.measures import closed_volume, mean_edge_length, triangle_areas

# Mean edge, in wanted edge lengths, above which a surface is coarse: remeshing keeps to its flat
# triangles, so the mesh would have their edges and creases.
COARSE = 3.0
FINE = 2.0  # mean edge, in wanted edge lengths, at which to stop; remeshing does the rest
LIMIT_LEVELS = 2  # of subdivision that show where a vertex comes to lie, to a few percent
OFFSETS = 3  # Newton steps for the volume; each leaves a thousandth of its error
SHARES = (1.0, 0.5, 0.0)  # of the correction, the first for which the surface does not cut itself
ML = 1e3  # mm³


def is_coarse(surface: LabelledSurface, edge_length: float) -> bool:
    """Whether a surface is too coarse to be remeshed at an edge length (mm) as it is."""
    return mean_edge_length(surface.vertices, surface.triangles) > COARSE * edge_length


def subdivided(surface: LabelledSurface, edge_length: float) -> tuple[LabelledSurface, str]:
    """Make a coarse surface smooth and finer: Loop subdivision, corrected for its shrinking.

    Loop's surface does not pass through the vertices that it comes from: walls of one or two
    triangles would shrink. So each vertex is first moved by as much as it would be missed by (one
    step of progressive interpolation; more make a flat base undulate), or by half of it where walls
    would cut one another. Then the finer surface is moved along its normals by the hundredths of a
    mm that give the volume back.

    Parameters
    ----------
    surface : LabelledSurface
        Coarse in the sense of `is_coarse`; small holes are closed first.
    edge_length : float
        The wanted mean edge length (mm).

    Returns
    -------
    surface : LabelledSurface
        Closed, with edges of at most `FINE` edge lengths (mean), and the label of each triangle
        that of the one it is part of.
    note : str
        What was done, for people.

    Raises
    ------
    InputError
        If the surface cannot be closed; the message says why.

    References
    ----------
    Loop 1987, Smooth subdivision surfaces based on triangles (thesis, University of Utah). Cheng,
    Fan, Lai et al. 2009, Loop subdivision surface based progressive interpolation, J Comput Sci
    Technol 24:39-46.
    """
    given = closed_surface(surface)
    before = mean_edge_length(given.vertices, given.triangles)
    levels = int(np.ceil(np.log2(before / (FINE * edge_length))))
    limit = _loop(given.vertices, given.triangles, LIMIT_LEVELS)[0][: len(given.vertices)]
    volume = closed_volume(given.vertices, given.triangles)
    for share in SHARES:
        vertices = given.vertices + share * (given.vertices - limit)
        vertices, triangles = _loop(vertices, given.triangles, levels)
        vertices = _with_volume(vertices, triangles, volume)
        if not len(self_intersections(vertices, triangles)):
            break
    labels = np.repeat(given.labels, 4**levels)  # four follow one another for each
    note = (
        f"surface: its triangles of {before:.3g} mm are coarse for edges of {edge_length:g} mm; "
        f"subdivided {levels} times (Loop) to a smooth one of "
        f"{mean_edge_length(vertices, triangles):.3g} mm; volume {volume / ML:.1f} ml before, "
        f"{closed_volume(vertices, triangles) / ML:.1f} ml after"
    )
    return replace(given, vertices=vertices, triangles=triangles, labels=labels), note


def _loop(vertices: Floats, triangles: Integers, levels: int) -> tuple[Floats, Integers]:
    """Subdivide so many times; the given vertices come first, moved."""
    finer, parts = igl.loop(vertices, triangles, levels)
    return np.asarray(finer, dtype=float), np.asarray(parts, dtype=np.int64)


def _with_volume(vertices: Floats, triangles: Integers, volume: float) -> Floats:
    """Vertices moved along their normals by one distance so that the volume is this one (mm³)."""
    for _ in range(OFFSETS):
        missing = volume - closed_volume(vertices, triangles)
        normals = np.asarray(igl.per_vertex_normals(vertices, triangles))
        vertices = vertices + missing / triangle_areas(vertices, triangles).sum() * normals
    return vertices
