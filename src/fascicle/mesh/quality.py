"""How well shaped the tetrahedra of a mesh are."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from fascicle.mesh.measures import edge_lengths, signed_volumes

SHARP = 10.0  # degrees; tetrahedra with a smaller dihedral angle count as sharp
# Corners of the face opposite each corner of a tetrahedron, seen from outside counter-clockwise.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True)
class Quality:
    """Shape and size of the tetrahedra of a mesh.

    Attributes
    ----------
    vertices, tetrahedra : int
        How many there are.
    volume : float
        Of all tetrahedra (mm³).
    smallest_angle, median_angle : float
        The smallest dihedral angle of a tetrahedron: the least and the median (degrees). That of
        a regular tetrahedron is 70.5.
    sharp : float
        Share of tetrahedra with a dihedral angle below 10 degrees.
    worst_radius_ratio, mean_radius_ratio : float
        Three times the inscribed sphere's radius over the circumscribed one's: 1 for a regular
        tetrahedron, 0 for a flat one.
    mean_edge, shortest_edge, longest_edge : float
        Lengths (mm).
    """

    vertices: int
    tetrahedra: int
    volume: float
    smallest_angle: float
    median_angle: float
    sharp: float
    worst_radius_ratio: float
    mean_radius_ratio: float
    mean_edge: float
    shortest_edge: float
    longest_edge: float

    def __str__(self) -> str:
        """One line for the reader."""
        return (
            f"{self.vertices} vertices, {self.tetrahedra} tetrahedra, {self.volume / 1000:.1f} ml, "
            f"edges {self.mean_edge:.2f} mm ({self.shortest_edge:.2f} to {self.longest_edge:.2f}), "
            f"smallest dihedral angle {self.smallest_angle:.1f} degrees (median "
            f"{self.median_angle:.1f}; {self.sharp:.2%} below {SHARP:g}), radius ratio "
            f"{self.mean_radius_ratio:.2f} (worst {self.worst_radius_ratio:.2f})"
        )


def quality(vertices: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> Quality:
    """Measure the tetrahedra of a mesh.

    Parameters
    ----------
    vertices : (n, 3) array
        Positions (mm).
    tetrahedra : (m, 4) array
        Vertex indices, positively oriented.
    """
    angles = _smallest_dihedral_angles(vertices, tetrahedra)
    ratios = _radius_ratios(vertices, tetrahedra)
    edges = np.asarray(igl.edges(tetrahedra))
    lengths = edge_lengths(vertices, edges)
    return Quality(
        vertices=len(vertices),
        tetrahedra=len(tetrahedra),
        volume=float(signed_volumes(vertices, tetrahedra).sum()),
        smallest_angle=float(angles.min()),
        median_angle=float(np.median(angles)),
        sharp=float((angles < SHARP).mean()),
        worst_radius_ratio=float(ratios.min()),
        mean_radius_ratio=float(ratios.mean()),
        mean_edge=float(lengths.mean()),
        shortest_edge=float(lengths.min()),
        longest_edge=float(lengths.max()),
    )


def _face_normals(
    vertices: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Normals (m, 4, 3) of the faces opposite each corner, as long as twice the face's area."""
    a, b, c = (vertices[tetrahedra[:, FACES[:, k]]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _smallest_dihedral_angles(
    vertices: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> NDArray[np.float64]:
    """The smallest angle between two faces of each tetrahedron (degrees), shape (m,)."""
    normals = _face_normals(vertices, tetrahedra)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    one, other = np.triu_indices(4, 1)
    cosines = -np.einsum("mij,mij->mi", normals[:, one], normals[:, other])
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))).min(axis=1))


def _radius_ratios(
    vertices: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Three times the inscribed radius over the circumscribed one, shape (m,).

    With edges a, b, c from one corner the circumscribed radius is
    ‖a²(b×c) + b²(c×a) + c²(a×b)‖ / 12V, the inscribed one 3V over the area of the faces.
    """
    a, b, c = (vertices[tetrahedra[:, k]] - vertices[tetrahedra[:, 0]] for k in (1, 2, 3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    area = np.linalg.norm(_face_normals(vertices, tetrahedra), axis=2).sum(axis=1) / 2
    square_a, square_b, square_c = (
        np.einsum("ij,ij->i", edge, edge)[:, None] for edge in (a, b, c)
    )
    centre = square_a * np.cross(b, c) + square_b * np.cross(c, a) + square_c * np.cross(a, b)
    inscribed = 3 * volume / area
    circumscribed = np.linalg.norm(centre, axis=1) / (12 * volume)
    return np.asarray(3 * inscribed / circumscribed)
