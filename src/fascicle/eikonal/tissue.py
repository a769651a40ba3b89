"""What the sweep needs of the myocardium; computed once per heart."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fascicle.geometry.conduction import Conduction
from fascicle.geometry.heart import Heart
from fascicle.kernels.arrays import Mesh

EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # than each corner


@dataclass(frozen=True)
class Site:
    """Points of the myocardium: where they lie, in which element.

    Attributes
    ----------
    positions : (n, 3) array
        Positions in the tissue (mm).
    elements : (n,) array
        Tetrahedron of each; -1 where it does not conduct.
    distances : (n,) array
        How far the points asked for are from these (mm).
    """

    positions: NDArray[np.float64]
    elements: NDArray[np.int64]
    distances: NDArray[np.float64]


@dataclass(frozen=True)
class Tissue:
    """The myocardium as the sweep and the ECG want it.

    Attributes
    ----------
    mesh : Mesh
        Geometry, metric and adjacency of what conducts.
    conducts : (m,) bool array
        Which tetrahedra conduct.
    surface, owner : (b, 3) and (b,) arrays
        Boundary triangles of the whole tissue and the tetrahedron of each.
    tree : igl.AABB
        Finds the nearest boundary triangle.
    """

    mesh: Mesh
    conducts: NDArray[np.bool_]
    surface: NDArray[np.int64]
    owner: NDArray[np.int64]
    tree: igl.AABB

    def on_surface(self, points: NDArray[np.float64]) -> Site:
        """Nearest points of the tissue's surface to `points` of shape (n, 3)."""
        square, triangle, nearest = self.tree.squared_distance(
            self.mesh.vertices, self.surface, np.ascontiguousarray(points)
        )
        elements = self.owner[triangle]
        elements = np.where(self.conducts[elements], elements, -1)
        return Site(np.asarray(nearest), elements, np.sqrt(square))

    def inside(self, points: NDArray[np.float64]) -> Site:
        """The same points where they lie in the tissue, else the nearest of its surface."""
        site = self.on_surface(points)
        positions, elements, distances = site.positions.copy(), site.elements, site.distances
        for k, point in enumerate(points):
            weights = point @ self.mesh.planes[:, :3] + self.mesh.planes[:, 3]
            element = int(np.where(self.conducts, weights.min(axis=1), -np.inf).argmax())
            if weights[element].min() >= -1e-9:
                positions[k], elements[k], distances[k] = point, element, 0.0
        return Site(positions, elements, distances)


def build_tissue(heart: Heart, conduction: Conduction) -> Tissue:
    """Precompute metric, squared travel times and adjacency of a heart's tissue."""
    corners, vertices = heart.tetrahedra, np.ascontiguousarray(heart.vertices)
    scale = conduction.scale(heart)
    conducts = scale > 0
    metric = conduction.metric(heart.fibres) / np.where(conducts, scale, 1.0)[:, None, None]
    edges = np.stack([vertices[corners[:, j]] - vertices[corners[:, i]] for i, j in EDGES], axis=1)
    gradients = barycentric_gradients(vertices, corners)
    along, across = conduction.speeds
    fastest = max(along, across) * np.sqrt(scale.max())
    slowest = min(along, across)
    start, star = _stars(corners, conducts, len(vertices))
    squares = np.einsum("mei,mij,mej->me", edges, metric, edges)
    heights = 1 / np.sqrt(np.einsum("mki,mij,mkj->mk", gradients, np.linalg.inv(metric), gradients))
    tetrahedron, corner = star >> 2, star & 3
    star_vertex = corners[tetrahedron[:, None], OTHERS[corner]]
    height = _rounded_down(heights[tetrahedron[:, None], OTHERS[corner]])
    reach = _rounded_down(_reach(squares)[tetrahedron, corner])
    links = _links(corners[conducts], len(vertices))
    surface, owner = heart.boundary
    mesh = Mesh(
        vertices=vertices,
        corners=np.ascontiguousarray(corners, dtype=np.int32),
        metric=np.ascontiguousarray(metric[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
        squares=squares,
        planes=_planes(vertices, corners, gradients),
        neighbours=_face_neighbours(corners, conducts),
        star_start=start,
        star=star,
        star_vertex=np.ascontiguousarray(star_vertex, dtype=np.int32),
        reach=reach,
        height=height,
        link_start=links.indptr.astype(np.int64),
        link=links.indices.astype(np.int32),
        slowness=float(1 / fastest),
        slack=float((heart.edge_length / slowest) ** 2 / 8),
    )
    return Tissue(mesh, conducts, surface, owner, find_on_surface(vertices, surface))


def find_on_surface(vertices: NDArray[np.float64], surface: NDArray[np.int64]) -> igl.AABB:
    """Search tree that finds the nearest of a surface's triangles."""
    tree = igl.AABB()
    tree.init(vertices, surface)
    return tree


def barycentric_gradients(
    vertices: NDArray[np.float64], corners: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Gradients of the four barycentric coordinates of each tetrahedron (1/mm), (m, 4, 3)."""
    edges = vertices[corners[:, 1:]] - vertices[corners[:, :1]]
    inner = np.swapaxes(np.linalg.inv(edges), 1, 2)
    return np.ascontiguousarray(np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1))


def _planes(
    vertices: NDArray[np.float64], corners: NDArray[np.int64], gradients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Gradients and values at the origin of the barycentric coordinates, shape (m, 4, 4)."""
    at_origin = -np.einsum("mki,mi->mk", gradients, vertices[corners[:, 0]])
    at_origin[:, 0] += 1
    planes = np.concatenate([np.swapaxes(gradients, 1, 2), at_origin[:, None, :]], axis=1)
    return np.ascontiguousarray(planes)


def _stars(
    corners: NDArray[np.int64], conducts: NDArray[np.bool_], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The conducting tetrahedra of each vertex as 4·tetrahedron + corner, and where they start."""
    flat = np.flatnonzero(np.repeat(conducts, 4))  # flat index = 4·tetrahedron + corner
    vertex = corners.ravel()[flat]
    order = np.argsort(vertex, kind="stable")
    counts = np.bincount(vertex, minlength=count)
    return np.concatenate([[0], np.cumsum(counts)]), flat[order].astype(np.int32)


def _rounded_down(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Single precision, never above the value."""
    single = values.astype(np.float32)
    return np.nextafter(single, np.float32(-np.inf))


def _reach(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least delay (ms) between a corner and another one that is reached through it; (m, 4, 3).

    A front that comes to corner x from direction v, through the face that corner s belongs to,
    reaches x later than s by the projection of the edge from s to x on v, in the metric. Its least
    value over the face's cone of directions is on one of its edges, or inside the side that is
    opposite to s where the projection on that side's plane points away from it.
    """
    square = np.zeros((len(squares), 4, 4))
    for k, (i, j) in enumerate(EDGES):
        square[:, i, j] = square[:, j, i] = squares[:, k]
    least = np.empty((len(squares), 4, 3))
    for s in range(4):
        for turn, x in enumerate(OTHERS[s]):
            j, k = (c for c in OTHERS[s] if c != x)
            ss, jj, kk = square[:, s, x], square[:, j, x], square[:, k, x]
            sj, sk = (ss + jj - square[:, s, j]) / 2, (ss + kk - square[:, s, k]) / 2
            jk = (jj + kk - square[:, j, k]) / 2
            on_edges = np.minimum(np.sqrt(ss), np.minimum(sj / np.sqrt(jj), sk / np.sqrt(kk)))
            det = jj * kk - jk * jk
            along_j, along_k = (sj * kk - sk * jk) / det, (sk * jj - sj * jk) / det
            away = (along_j <= 0) & (along_k <= 0)
            projection = np.sqrt(np.maximum(along_j * sj + along_k * sk, 0))
            least[:, s, turn] = np.where(away, -projection, on_edges)
    return least


def _links(corners: NDArray[np.int64], count: int) -> sp.csr_array:
    """Which vertices share an edge, as a symmetric pattern."""
    one, other = (np.concatenate([corners[:, e[side]] for e in EDGES]) for side in (0, 1))
    ones = np.ones(2 * len(one), dtype=np.int8)
    rows, columns = np.concatenate([one, other]), np.concatenate([other, one])
    return sp.coo_array((ones, (rows, columns)), shape=(count, count)).tocsr()


def _face_neighbours(corners: NDArray[np.int64], conducts: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Tetrahedron across the face opposite each corner, -1 where none conducts; shape (m, 4)."""
    faces = np.stack([np.delete(corners, k, axis=1) for k in range(4)], axis=1).reshape(-1, 3)
    faces = np.sort(faces, axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    neighbours = np.full(len(faces), -1, dtype=np.int32)
    first, second = order[:-1][same], order[1:][same]
    neighbours[first], neighbours[second] = second // 4, first // 4
    neighbours[~conducts[neighbours]] = -1
    return neighbours.reshape(-1, 4)
