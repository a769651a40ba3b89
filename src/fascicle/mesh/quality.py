"""How well shaped the tetrahedra of a mesh are."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.formats.mesh_file import TETRAHEDRON
from fascicle.mesh.measures import edge_lengths, signed_volumes

SHARP = 10.0  # degrees; tetrahedra with a smaller dihedral angle count as sharp
MM3_PER_ML = 1000.0


@dataclass(frozen=True)
class Quality:
    """Shape and size of the tetrahedra of a mesh.

    Attributes
    ----------
    vertices : int
        How many there are.
    volumes : (m,) array
        Volume of each tetrahedron (mm³).
    angles : (m,) array
        Smallest dihedral angle of each (degrees). That of a regular tetrahedron is 70.5.
    radius_ratios : (m,) array
        Three times the inscribed sphere's radius over the circumscribed one's: 1 for a regular
        tetrahedron, 0 for a flat one.
    edges : (e,) array
        Lengths (mm).
    """

    vertices: int
    volumes: Floats
    angles: Floats
    radius_ratios: Floats
    edges: Floats

    @property
    def sharp(self) -> float:
        """Share of tetrahedra with a dihedral angle below 10 degrees."""
        return float((self.angles < SHARP).mean())

    def __str__(self) -> str:
        """One line for the reader."""
        return (
            f"{self.vertices} vertices, {len(self.volumes)} tetrahedra, "
            f"{self.volumes.sum() / MM3_PER_ML:.1f} ml, edges {self.edges.mean():.2f} mm "
            f"({self.edges.min():.2f} to {self.edges.max():.2f}), smallest dihedral angle "
            f"{self.angles.min():.1f} degrees (median {np.median(self.angles):.1f}; "
            f"{self.sharp:.2%} below {SHARP:g}), radius ratio {self.radius_ratios.mean():.2f} "
            f"(worst {self.radius_ratios.min():.2f})"
        )


def quality(vertices: Floats, tetrahedra: Integers) -> Quality:
    """Measure the tetrahedra of a mesh.

    Radius ratios are VTK's, dihedral angles libigl's: VTK's ``min_angle`` looks at four of the six
    edges only.

    Parameters
    ----------
    vertices, tetrahedra : (n, 3) and (m, 4) arrays
        Positions (mm) and vertex indices, positively oriented.
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
