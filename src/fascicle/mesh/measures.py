"""Lengths, areas, normals and volumes; quality of tetrahedra; triangles that intersect."""

from __future__ import annotations

from typing import NamedTuple

import igl
import igl.predicates
import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.topology import boundary_loops, fan

# Quadrature of degree 2 on a tetrahedron (Hammer and Stroud, 1956): four points of equal weight,
# each nearer to one corner, in barycentric coordinates
HAMMER_STROUD_POINTS = (5 - np.sqrt(5)) / 20 + np.sqrt(5) / 5 * np.eye(4)


def unit(vectors: Floats) -> Floats:
    """Vectors (..., d) scaled to length 1; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1 if np.ndim(vectors) > 1 else None, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))


def edge_lengths(vertices: Floats, edges: NDArray[np.integer]) -> Floats:
    """Length of each edge (e, 2), shape (e,)."""
    return np.asarray(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))


def loop_length(vertices: Floats, loop: Integers) -> float:
    """Length of a closed line through some vertices (k,)."""
    points = vertices[loop]
    return float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum())


def mean_edge_length(vertices: Floats, cells: Integers) -> float:
    """Mean edge length of triangles (m, 3) or tetrahedra (m, 4)."""
    return float(edge_lengths(vertices, np.asarray(igl.edges(cells))).mean())


def triangle_normals(vertices: Floats, triangles: Integers) -> Floats:
    """Normals whose length is the triangle's area, shape (m, 3)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a) / 2)


def triangle_areas(vertices: Floats, triangles: Integers) -> Floats:
    """Area of each triangle, shape (m,)."""
    return np.asarray(np.linalg.norm(triangle_normals(vertices, triangles), axis=1))


def signed_volumes(vertices: Floats, tetrahedra: Integers) -> Floats:
    """Signed volume of each tetrahedron, shape (m,)."""
    origin, a, b, c = (vertices[tetrahedra[:, k]] for k in range(4))
    return np.asarray(np.einsum("ij,ij->i", a - origin, np.cross(b - origin, c - origin)) / 6)


def solid_centroid(vertices: Floats, tetrahedra: Integers) -> Floats:
    """Centroid (3,) of tetrahedra, by volume."""
    volumes = signed_volumes(vertices, tetrahedra)
    return np.asarray(np.average(vertices[tetrahedra].mean(axis=1), axis=0, weights=volumes))


def principal_axes(vectors: Floats) -> Floats:
    """Principal axes (m, 3) of Σ v⊗v over vectors v (m, k, 3): their mean axes, regardless of sign.

    Long vectors count more. The axes are unit vectors of arbitrary sign.
    """
    _, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", vectors, vectors))
    return np.asarray(axes[:, :, -1])


def closed_volume(vertices: Floats, triangles: Integers) -> float:
    """Signed volume within a closed surface (mm³), positive where normals point outwards."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def closed_by_fan(vertices: Floats, triangles: Integers) -> tuple[float, float]:
    """Signed volume (mm³) of an open surface closed by a fan over each opening; the fans' area.

    The volume is negative if the normals point into the cavity, as those of an `Endocardium` do.
    """
    rim = np.asarray(igl.boundary_facets(triangles)[0], dtype=np.int64)
    centred = vertices - vertices[np.unique(rim)].mean(axis=0)  # fans about 0 add no volume
    area = np.linalg.norm(np.cross(centred[rim[:, 0]], centred[rim[:, 1]]), axis=1).sum() / 2
    return closed_volume(centred, triangles), float(area)


def winding_number(vertices: Floats, triangles: Integers, points: Floats) -> Floats:
    """Absolute winding number about points (k, 3) of a surface closed by fans over its openings.

    It is about 1 within and 0 outside, whatever the orientation of the triangles.
    """
    loops = boundary_loops(triangles)
    closed = np.vstack([vertices, *(vertices[loop].mean(axis=0) for loop in loops)])
    lids = [fan(loop, number) for number, loop in enumerate(loops, start=len(vertices))]
    faces = np.vstack([triangles, *lids])
    return np.asarray(np.abs(igl.fast_winding_number(closed, faces, np.ascontiguousarray(points))))


def turned_outwards(vertices: Floats, triangles: Integers) -> Integers:
    """Triangles of a closed surface, all reversed if their normals point inwards."""
    if closed_volume(vertices, triangles) < 0:
        triangles = triangles[:, ::-1]
    return np.ascontiguousarray(triangles, dtype=np.int64)


def barycentric_gradients(vertices: Floats, corners: NDArray[np.integer]) -> Floats:
    """Gradients of the four barycentric coordinates of each tetrahedron (1/mm), (m, 4, 3)."""
    inner = np.swapaxes(np.linalg.inv(vertices[corners[:, 1:]] - vertices[corners[:, :1]]), 1, 2)
    return np.ascontiguousarray(np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1))


def best_plane(points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Centre (3,) of points (n, 3) with weights (n,), and the axes (3, 3) of their best plane.

    The axes are rows, the normal last.
    """
    centre = weights @ points / weights.sum()
    spread = np.sqrt(weights)[:, np.newaxis] * (points - centre)
    return centre, np.linalg.svd(spread, full_matrices=False)[2]


class Quality(NamedTuple):
    """Shape and size of the tetrahedra of a mesh.

    Attributes
    ----------
    vertices : int
        Number of vertices.
    volumes, angles : (m,) arrays
        Volume (mm³) and smallest dihedral angle (degrees; 70.5 if regular) of each tetrahedron.
    radius_ratios : (m,) array
        Three times the radius of the inscribed sphere over that of the circumscribed sphere (1 if
        regular, 0 if flat).
    edges : (e,) array
        Lengths of the edges (mm).
    """

    vertices: int
    volumes: Floats
    angles: Floats
    radius_ratios: Floats
    edges: Floats

    def __str__(self) -> str:
        return (
            f"{self.vertices} vertices, {len(self.volumes)} tetrahedra, "
            f"{self.volumes.sum() / 1000:.1f} ml, edges {self.edges.mean():.2f} mm "
            f"({self.edges.min():.2f} to {self.edges.max():.2f}), smallest dihedral angle "
            f"{self.angles.min():.1f} degrees (median {np.median(self.angles):.1f}; "
            f"{(self.angles < 10.0).mean():.2%} below 10), radius ratio "
            f"{self.radius_ratios.mean():.2f} (worst {self.radius_ratios.min():.2f})"
        )


def quality(vertices: Floats, tetrahedra: Integers) -> Quality:
    """Measure the positively oriented tetrahedra (m, 4) of a mesh (mm).

    Dihedral angles are libigl's. With edges a, b, c from one corner, volume V and area A of the
    faces, the radius of the inscribed sphere is 3V/A, and that of the circumscribed one
    |a²(b×c) + b²(c×a) + c²(a×b)|/(12V).
    """
    edges = np.moveaxis(vertices[tetrahedra[:, 1:]] - vertices[tetrahedra[:, :1]], 1, 0)  # a, b, c
    normals = np.cross(np.roll(edges, -1, axis=0), np.roll(edges, -2, axis=0))
    faces = np.linalg.norm([*normals, normals.sum(axis=0)], axis=2).sum(axis=0) / 2
    centre = np.einsum("kmi,kmi,kmj->mj", edges, edges, normals)
    volumes = signed_volumes(vertices, tetrahedra)
    angles, _ = igl.dihedral_angles(vertices, tetrahedra)
    return Quality(
        vertices=len(vertices),
        volumes=volumes,
        angles=np.degrees(angles).min(axis=1),
        radius_ratios=108 * volumes**2 / (faces * np.linalg.norm(centre, axis=1)),
        edges=edge_lengths(vertices, np.asarray(igl.edges(tetrahedra))),
    )


def self_intersections(vertices: Floats, triangles: Integers) -> Integers:
    """Pairs (k, 2) of triangles that intersect or overlap, by exact predicates.

    Triangles that only share a vertex or an edge do not intersect.
    """
    _, pairs, _ = igl.predicates.find_self_intersections(
        np.ascontiguousarray(vertices, dtype=float), np.ascontiguousarray(triangles, np.int64)
    )
    return np.unique(np.sort(np.reshape(pairs, (-1, 2)), axis=1), axis=0)


def intersections(first: tuple[Floats, Integers], second: tuple[Floats, Integers]) -> Integers:
    """Pairs (k, 2) of triangles of two surfaces (vertices and triangles) that meet."""
    arrays = [
        np.ascontiguousarray(array, kind)
        for surface in (first, second)
        for array, kind in zip(surface, (np.float64, np.int64), strict=True)
    ]
    _, pairs, _ = igl.predicates.find_intersections(*arrays)
    return np.unique(np.reshape(pairs, (-1, 2)), axis=0)
