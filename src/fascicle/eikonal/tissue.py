"""What the sweep needs of the myocardium; computed once per heart."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from fascicle.geometry.conduction import Conduction
from fascicle.geometry.heart import Heart
from fascicle.kernels import ball

EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


@dataclass(frozen=True)
class Site:
    """Points of the myocardium: where they lie, in which element.

    Attributes
    ----------
    positions : (n, 3) array
        Positions on the tissue's surface (mm).
    elements : (n,) array
        Tetrahedron of each.
    distances : (n,) array
        How far the points asked for are from these (mm).
    """

    positions: NDArray[np.float64]
    elements: NDArray[np.int64]
    distances: NDArray[np.float64]


@dataclass(frozen=True)
class Tissue:
    """Mesh, metric and adjacency of the myocardium as the kernels want them.

    Attributes
    ----------
    vertices, corners : (n, 3) and (m, 4) arrays
        The mesh (mm).
    metric : (m, 3, 3) array
        D⁻¹ of each tetrahedron (ms²/mm²).
    squares : (m, 6) array
        Squared travel times along its edges (ms²).
    gradients : (m, 4, 3) array
        Gradients of the barycentric coordinates (1/mm).
    neighbours : (m, 4) array
        Tetrahedron across the face opposite each corner; -1 at the boundary.
    vertex_start, vertex_tetrahedra : (n + 1,) and (4m,) arrays
        The tetrahedra of each vertex, as 4·tetrahedron + corner.
    surface, owner : (b, 3) and (b,) arrays
        Boundary triangles and the tetrahedron of each.
    tree : igl.AABB
        Finds the nearest boundary triangle.
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int64]
    metric: NDArray[np.float64]
    squares: NDArray[np.float64]
    gradients: NDArray[np.float64]
    neighbours: NDArray[np.int64]
    vertex_start: NDArray[np.int64]
    vertex_tetrahedra: NDArray[np.int64]
    surface: NDArray[np.int64]
    owner: NDArray[np.int64]
    tree: igl.AABB

    def locate(self, points: NDArray[np.float64]) -> Site:
        """Nearest points of the tissue's surface to `points` of shape (n, 3)."""
        square, triangle, nearest = self.tree.squared_distance(
            self.vertices, self.surface, np.ascontiguousarray(points)
        )
        return Site(np.asarray(nearest), self.owner[triangle], np.sqrt(square))

    def balls(
        self, site: Site, radius: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Vertices within `radius` mm of each point and the time to them (`kernels.ball`)."""
        start, vertex, time = ball.balls(
            site.positions, site.elements, radius, self.vertices, self.corners, self.neighbours,
            self.gradients, self.metric, self.vertex_start, self.vertex_tetrahedra,
        )  # fmt: skip
        return start, vertex, time

    def squares_to_corners(self, site: Site) -> NDArray[np.float64]:
        """Squared travel times from each point to its element's corners (ms²), shape (n, 4)."""
        offset = self.vertices[self.corners[site.elements]] - site.positions[:, None, :]
        return np.asarray(
            np.einsum("nki,nij,nkj->nk", offset, self.metric[site.elements], offset), dtype=float
        )


def build_tissue(heart: Heart, conduction: Conduction) -> Tissue:
    """Precompute metric, gram tables and adjacency of a heart's tissue."""
    corners = np.ascontiguousarray(heart.tetrahedra)
    vertices = np.ascontiguousarray(heart.vertices)
    metric = np.ascontiguousarray(conduction.metric(heart.fibres))
    edges = np.stack([vertices[corners[:, j]] - vertices[corners[:, i]] for i, j in EDGES], axis=1)
    squares = np.einsum("mei,mij,mej->me", edges, metric, edges)
    order = np.argsort(corners.ravel(), kind="stable")
    counts = np.bincount(corners.ravel(), minlength=len(vertices))
    surface, owner = heart.boundary
    tree = igl.AABB()
    tree.init(vertices, surface)
    return Tissue(
        vertices=vertices,
        corners=corners,
        metric=metric,
        squares=np.ascontiguousarray(squares),
        gradients=barycentric_gradients(vertices, corners),
        neighbours=_face_neighbours(corners),
        vertex_start=np.concatenate([[0], np.cumsum(counts)]),
        vertex_tetrahedra=np.ascontiguousarray(order),  # flat index = 4·tetrahedron + corner
        surface=surface,
        owner=owner,
        tree=tree,
    )


def barycentric_gradients(
    vertices: NDArray[np.float64], corners: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Gradients of the four barycentric coordinates of each tetrahedron (1/mm), (m, 4, 3)."""
    edges = vertices[corners[:, 1:]] - vertices[corners[:, :1]]
    inner = np.swapaxes(np.linalg.inv(edges), 1, 2)
    return np.ascontiguousarray(np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1))


def _face_neighbours(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Tetrahedron across the face opposite each corner, or -1; shape (m, 4)."""
    faces = np.stack([np.delete(corners, k, axis=1) for k in range(4)], axis=1).reshape(-1, 3)
    faces = np.sort(faces, axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    neighbours = np.full(len(faces), -1, dtype=np.int64)
    first, second = order[:-1][same], order[1:][same]
    neighbours[first], neighbours[second] = second // 4, first // 4
    return neighbours.reshape(-1, 4)
