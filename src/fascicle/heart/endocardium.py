"""Endocardial surfaces: open at the base, one boundary loop, normals into the cavity."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.short_repr import short_repr
from fascicle.mesh.measures import enclosed_volume, triangle_areas
from fascicle.mesh.topology import boundary_loops, unique_edges


@dataclass(frozen=True)
class Endocardium:
    """The endocardial surface of one ventricle and where its bundle enters.

    Attributes
    ----------
    side : str
        ``"lv"`` or ``"rv"``.
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices, counter-clockwise seen from inside the cavity.
    root, direction : int
        Vertex where the bundle starts, and one that it heads for.
    valves : (m,) array, optional
        Which triangles span a valve opening within the surface; no tissue lies under them, and
        trees end at its edge.
    """

    side: str
    vertices: Floats
    triangles: Integers
    root: int
    direction: int
    valves: Booleans | None = None

    __repr__ = short_repr

    @property
    def area(self) -> float:
        """Surface area (mm²)."""
        return float(triangle_areas(self.vertices, self.triangles).sum())


def oriented_into_cavity(vertices: Floats, triangles: Integers, name: str) -> Integers:
    """Check that a surface is an endocardium and turn its triangles to face the cavity.

    Parameters
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices, in any orientation.
    name : str
        What to call the surface in an error.

    Returns
    -------
    (m, 3) array
        The triangles, counter-clockwise seen from inside the cavity.

    Raises
    ------
    InputError
        If the surface is not one manifold piece with the topology of a disk.
    """
    edges, count = unique_edges(triangles)
    bad = np.flatnonzero(count > 2)
    if bad.size:
        a, b = edges[bad[0]]
        raise InputError(
            f"{name}: {bad.size} non-manifold edges (first: {a}-{b}, shared by "
            f"{count[bad[0]]} triangles); repair or remesh the surface"
        )
    oriented, pieces = igl.bfs_orient(triangles)
    if pieces.max() > 0:
        raise InputError(
            f"{name}: the surface falls into {pieces.max() + 1} pieces; "
            "keep the one that is the endocardium"
        )
    _check_disk(oriented, len(edges), name)
    if enclosed_volume(vertices, oriented) > 0:  # normals point away from the cavity
        oriented = oriented[:, ::-1]
    return np.ascontiguousarray(oriented, dtype=np.int64)


def _check_disk(triangles: Integers, edges: int, name: str) -> None:
    loops = boundary_loops(triangles)
    if len(loops) != 1:
        found = "no boundary loop (it is closed)" if not loops else f"{len(loops)} boundary loops"
        raise InputError(
            f"{name}: the surface has {found}; it must be open at the base, with exactly one"
        )
    euler = np.unique(triangles).size - edges + len(triangles)
    boundary = loops[0]
    if euler != 1 or np.unique(boundary).size != boundary.size:
        raise InputError(
            f"{name}: the surface has handles or a pinched boundary (Euler characteristic "
            f"{euler}, a disk has 1); repair or remesh it"
        )


def long_axis(vertices: Floats, triangles: Integers) -> tuple[Floats, Floats]:
    """Middle of an endocardium's opening, and its apex: the vertex furthest from there (mm)."""
    base = vertices[boundary_loops(triangles)[0]].mean(axis=0)
    apex = vertices[np.argmax(np.linalg.norm(vertices - base, axis=1))]
    return np.asarray(base), np.asarray(apex)
