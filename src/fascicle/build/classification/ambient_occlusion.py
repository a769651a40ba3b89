"""What each triangle of a closed surface sees of the sky, and the graph of its triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from fascicle.mesh.measures import triangle_normals

Told = Callable[[int, int], None]

MOST_SAMPLES = 6000  # triangles that rays leave from; the others take it from the nearest of them
RAYS = 48  # of each triangle
CHUNK = 500  # triangles whose rays are traced at once
CLEARANCE = 1e-3  # mm, of a ray's origin from its own triangle
NEIGHBOURS = 4  # samples that a triangle's share of the sky is averaged over
FACING = 10.0  # mm by which samples that face away count as farther, for one of unit length
SMOOTHING = 1.0  # mm over which normals are averaged
CREASE = 0.5  # rad between neighbouring triangles at which their bond has fallen to 1/e
LEAST_BOND = 1e-4  # of the bond in a plane; keeps the graph connected across sharp edges


@dataclass(frozen=True)
class Patchwork:
    """A closed surface as a graph of triangles.

    Attributes
    ----------
    vertices : (n, 3) array
        Positions (mm).
    triangles : (m, 3) array
        Vertex indices, counter-clockwise seen from outside the tissue.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Centroids (mm), shape (m, 3)."""
        return np.asarray(self.vertices[self.triangles].mean(axis=1))

    @cached_property
    def areas(self) -> NDArray[np.float64]:
        """Areas (mm²), shape (m,)."""
        return np.asarray(np.linalg.norm(triangle_normals(self.vertices, self.triangles), axis=1))

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals out of the tissue, shape (m, 3)."""
        return unit(triangle_normals(self.vertices, self.triangles))

    @cached_property
    def edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Triangles on both sides of each edge (e, 2), and the edge's vertices (e, 2)."""
        edges = np.sort(self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        order = np.lexsort(edges.T)
        owner = np.repeat(np.arange(len(self.triangles)), 3)[order]
        return owner.reshape(-1, 2), edges[order][::2]

    @cached_property
    def lengths(self) -> NDArray[np.float64]:
        """Length of each edge (mm), shape (e,)."""
        ends = self.vertices[self.edges[1]]
        return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))

    @cached_property
    def smooth_normals(self) -> NDArray[np.float64]:
        """Unit normals averaged over `SMOOTHING`, shape (m, 3)."""
        mass = diags_array(self.areas)
        system = mass + SMOOTHING**2 * self.laplacian(np.ones(len(self.lengths)))
        solved = splu(csc_array(system)).solve(self.areas[:, np.newaxis] * self.normals)
        return unit(np.asarray(solved))

    @cached_property
    def bonds(self) -> NDArray[np.float64]:
        """How much each edge's two triangles belong together: 1 in a plane, ~0 over a crease."""
        ahead, behind = self.normals[self.edges[0][:, 0]], self.normals[self.edges[0][:, 1]]
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", ahead, behind), -1.0, 1.0))
        return np.asarray(np.maximum(np.exp(-((angle / CREASE) ** 2)), LEAST_BOND))

    def laplacian(self, weights: NDArray[np.float64]) -> csr_array:
        """Finite-volume Laplacian on triangles, its fluxes times a weight for each edge."""
        pair = self.edges[0]
        between = np.linalg.norm(self.centres[pair[:, 0]] - self.centres[pair[:, 1]], axis=1)
        conductance = weights * self.lengths / np.maximum(between, 1e-3 * self.lengths.mean())
        count = len(self.triangles)
        half = coo_array((conductance, (pair[:, 0], pair[:, 1])), shape=(count, count)).tocsr()
        whole = csr_array(half + half.T)
        return csr_array(diags_array(np.asarray(whole.sum(axis=1)).ravel()) - whole)

    def components(self, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Number the connected pieces of chosen triangles, the largest area first; -1 elsewhere."""
        pair = self.edges[0][chosen[self.edges[0]].all(axis=1)]
        count = len(self.triangles)
        graph = coo_array((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), shape=(count, count))
        _, piece = connected_components(graph, directed=False)
        area = np.bincount(piece, np.where(chosen, self.areas, 0.0))
        rank = np.argsort(np.argsort(-area, kind="stable"), kind="stable")
        return np.where(chosen, rank[piece], -1)

    def walk(self, seeds: NDArray[np.int64], labels: int) -> NDArray[np.int64]:
        """Label every triangle as a random walker from it would first arrive.

        The walker goes along the surface and seldom crosses creases (random-walker segmentation:
        Grady, IEEE Trans. Pattern Anal. Mach. Intell. 28, 1768, 2006).

        Parameters
        ----------
        seeds : (m,) array
            Label of the triangles that have one, -1 elsewhere.
        labels : int
            Number of labels.

        Returns
        -------
        (m,) array
            Labels.
        """
        free, fixed = np.flatnonzero(seeds < 0), np.flatnonzero(seeds >= 0)
        if not free.size:
            return seeds
        laplacian = self.laplacian(self.bonds)
        arrivals = np.eye(labels)[seeds[fixed]]
        inner = splu(csc_array(laplacian[free][:, free]))
        chance = inner.solve(np.asarray(-(laplacian[free][:, fixed] @ arrivals)))
        result = seeds.copy()
        result[free] = np.argmax(chance, axis=1)
        return result


def sky_seen(patchwork: Patchwork, told: Told | None = None) -> NDArray[np.float64]:
    """Share of the sky that each triangle sees, by Lambert's cosine.

    Rays leave over the half space before a triangle and either meet the surface again or do not;
    a triangle on a plane sees everything (1), one in a well nothing (0).

    Parameters
    ----------
    patchwork : Patchwork
        The closed surface.
    told : callable, optional
        Told triangles done and in all.

    Returns
    -------
    (m,) array
        Shares from 0 to 1.
    """
    count = len(patchwork.triangles)
    chosen = np.arange(count)
    if count > MOST_SAMPLES:
        share = patchwork.areas / patchwork.areas.sum()
        chosen = np.random.default_rng(0).choice(count, MOST_SAMPLES, replace=False, p=share)
    tree = igl.AABB()
    tree.init(patchwork.vertices, patchwork.triangles)
    dome = _dome()
    seen = np.empty(len(chosen))
    for start in range(0, len(chosen), CHUNK):
        some = chosen[start : start + CHUNK]
        normals = patchwork.normals[some]
        rays = np.einsum("rk,skj->srj", dome, _frames(normals)).reshape(-1, 3)
        origins = np.repeat(patchwork.centres[some] + CLEARANCE * normals, RAYS, axis=0)
        met, _, _ = tree.intersect_ray_first(
            patchwork.vertices, patchwork.triangles, origins, np.ascontiguousarray(rays)
        )
        seen[start : start + CHUNK] = (met.reshape(-1, RAYS) < 0).mean(axis=1)
        if told is not None:
            told(min(start + CHUNK, len(chosen)), len(chosen))
    return _spread(patchwork, chosen, seen)


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors of length 1; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def _spread(
    patchwork: Patchwork, chosen: NDArray[np.int64], seen: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Average the nearest samples that face the same way, not those across a thin wall."""
    place = np.hstack([patchwork.centres, FACING * patchwork.smooth_normals])
    _, nearest = cKDTree(place[chosen]).query(place, k=NEIGHBOURS)
    return np.asarray(seen[nearest].mean(axis=1))


def _dome() -> NDArray[np.float64]:
    """Directions of the half space about z by the cosine law: a sunflower's seeds, lifted."""
    golden = np.pi * (3 - np.sqrt(5))
    radius = np.sqrt((np.arange(RAYS) + 0.5) / RAYS)
    angle = golden * np.arange(RAYS)
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1
    )


def _frames(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two tangents and the normal for each normal, shape (k, 3, 3)."""
    aside = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = unit(np.cross(normals, aside))
    return np.stack([first, np.cross(normals, first), normals], axis=1)
