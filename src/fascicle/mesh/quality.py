"""Shapes of tetrahedra, and triangles that cut through one another."""

from __future__ import annotations

from typing import NamedTuple

import igl
import igl.predicates
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.measures import edge_lengths, signed_volumes


class Quality(NamedTuple):
    """Shape and size of the tetrahedra of a mesh.

    Number of vertices; of each tetrahedron (m,) the volume (mm³), the smallest dihedral angle
    (degrees; 70.5 if regular), and three times the radius of the inscribed sphere over that of the
    circumscribed one (1 if regular, 0 if flat); the lengths of the edges (e,) (mm).
    """

    vertices: int
    volumes: Floats
    angles: Floats
    radius_ratios: Floats
    edges: Floats

    @property
    def sharp(self) -> float:
        """Share of tetrahedra with a dihedral angle below 10 degrees."""
        return float((self.angles < 10.0).mean())

    def __str__(self) -> str:
        return (
            f"{self.vertices} vertices, {len(self.volumes)} tetrahedra, "
            f"{self.volumes.sum() / 1000:.1f} ml, edges {self.edges.mean():.2f} mm "
            f"({self.edges.min():.2f} to {self.edges.max():.2f}), smallest dihedral angle "
            f"{self.angles.min():.1f} degrees (median {np.median(self.angles):.1f}; "
            f"{self.sharp:.2%} below 10), radius ratio {self.radius_ratios.mean():.2f} "
            f"(worst {self.radius_ratios.min():.2f})"
        )


def quality(vertices: Floats, tetrahedra: Integers) -> Quality:
    """Measure the positively oriented tetrahedra (m, 4) of a mesh (mm).

    Radius ratios are VTK's, dihedral angles libigl's: VTK's ``min_angle`` looks at four of the six
    edges only.
    """
    import pyvista as pv

    grid = pv.UnstructuredGrid({TETRAHEDRON: tetrahedra}, vertices)
    angles, _ = igl.dihedral_angles(vertices, tetrahedra)
    return Quality(
        vertices=len(vertices),
        volumes=signed_volumes(vertices, tetrahedra),
        angles=np.degrees(angles).min(axis=1),
        # VTK's is the inverse: 1 for a regular tetrahedron, larger for worse ones
        radius_ratios=1 / np.asarray(grid.cell_quality("radius_ratio")["radius_ratio"]),
        edges=edge_lengths(vertices, np.asarray(igl.edges(tetrahedra))),
    )


def self_intersections(vertices: Floats, triangles: Integers) -> Integers:
    """Pairs (k, 2) of triangles that cut through or lie on one another, by exact predicates.

    Touching in a common vertex or edge is no cut.
    """
    _, pairs, _ = igl.predicates.find_self_intersections(
        np.ascontiguousarray(vertices, dtype=float), np.ascontiguousarray(triangles, np.int64)
    )
    return np.unique(np.sort(np.reshape(pairs, (-1, 2)), axis=1), axis=0)


def intersections(one: tuple[Floats, Integers], other: tuple[Floats, Integers]) -> Integers:
    """Pairs (k, 2) of triangles of two surfaces (vertices and triangles) that meet."""
    arrays = [
        np.ascontiguousarray(array, kind)
        for surface in (one, other)
        for array, kind in zip(surface, (np.float64, np.int64), strict=True)
    ]
    _, pairs, _ = igl.predicates.find_intersections(*arrays)
    return np.unique(np.reshape(pairs, (-1, 2)), axis=0)
