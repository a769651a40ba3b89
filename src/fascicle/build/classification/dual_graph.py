"""The dual graph of a closed surface: its triangles, linked across its edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.mesh.measures import edge_lengths, triangle_areas, triangle_normals, unit
from fascicle.mesh.topology import components_of, directed_edges

SMOOTHING = 1.0  # mm over which normals are averaged
CREASE = 0.5  # rad between neighbouring triangles at which their crease weight has fallen to 1/e
LEAST_WEIGHT = 1e-4  # of that in a plane; keeps the graph connected across sharp edges
LEAST_DISTANCE = 1e-3  # of the mean edge, between the centres of neighbouring triangles


@dataclass(frozen=True)
class DualGraph:
    """A closed surface as a graph of its triangles.

    Attributes
    ----------
    vertices, triangles : (n, 3) and (m, 3) arrays
        Positions (mm) and vertex indices, counter-clockwise seen from outside the tissue.
    """

    vertices: Floats
    triangles: Integers

    @cached_property
    def centres(self) -> Floats:
        """Centroids (mm), shape (m, 3)."""
        return np.asarray(self.vertices[self.triangles].mean(axis=1))

    @cached_property
    def areas(self) -> Floats:
        """Areas (mm²), shape (m,)."""
        return triangle_areas(self.vertices, self.triangles)

    @cached_property
    def normals(self) -> Floats:
        """Unit normals out of the tissue, shape (m, 3)."""
        return unit(triangle_normals(self.vertices, self.triangles))

    @cached_property
    def edges(self) -> tuple[Integers, Integers]:
        """Triangles on both sides of each edge (e, 2), and the edge's vertices (e, 2)."""
        edges = np.sort(directed_edges(self.triangles), axis=1)
        order = np.lexsort(edges.T)
        owner = np.repeat(np.arange(len(self.triangles)), 3)[order]
        return owner.reshape(-1, 2), edges[order][::2]

    @cached_property
    def lengths(self) -> Floats:
        """Length of each edge (mm), shape (e,)."""
        return edge_lengths(self.vertices, self.edges[1])

    @cached_property
    def smooth_normals(self) -> Floats:
        """Unit normals averaged over `SMOOTHING`, shape (m, 3)."""
        mass = diags_array(self.areas)
        system = mass + SMOOTHING**2 * self.laplacian(np.ones(len(self.lengths)))
        solved = splu(csc_array(system)).solve(self.areas[:, np.newaxis] * self.normals)
        return unit(np.asarray(solved))

    @cached_property
    def crease_weights(self) -> Floats:
        """Weight of each edge (e,): 1 between triangles in a plane, nearly 0 across a crease."""
        ahead, behind = self.normals[self.edges[0][:, 0]], self.normals[self.edges[0][:, 1]]
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", ahead, behind), -1.0, 1.0))
        return np.asarray(np.maximum(np.exp(-((angle / CREASE) ** 2)), LEAST_WEIGHT))

    def laplacian(self, weights: Floats) -> csr_array:
        """Finite-volume Laplacian on triangles, its fluxes times a weight for each edge."""
        pair = self.edges[0]
        between = np.linalg.norm(self.centres[pair[:, 0]] - self.centres[pair[:, 1]], axis=1)
        conductance = (
            weights * self.lengths / np.maximum(between, LEAST_DISTANCE * self.lengths.mean())
        )
        count = len(self.triangles)
        half = coo_array((conductance, (pair[:, 0], pair[:, 1])), shape=(count, count)).tocsr()
        whole = csr_array(half + half.T)
        return csr_array(diags_array(np.asarray(whole.sum(axis=1)).ravel()) - whole)

    def components(self, chosen: Booleans) -> Integers:
        """Number the connected pieces of chosen triangles, the largest area first; -1 elsewhere."""
        pair = self.edges[0][chosen[self.edges[0]].all(axis=1)]
        piece = components_of(pair, len(self.triangles))
        area = np.bincount(piece, np.where(chosen, self.areas, 0.0))
        rank = np.argsort(np.argsort(-area, kind="stable"), kind="stable")
        return np.where(chosen, rank[piece], -1)

    def random_walker(self, seeds: Integers, labels: int) -> Integers:
        """Label every triangle as a random walker from it would first arrive.

        The walker goes along the surface and seldom crosses creases.

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

        References
        ----------
        Grady 2006, IEEE Trans Pattern Anal Mach Intell 28:1768-1783 (random-walker segmentation).
        """
        free, fixed = np.flatnonzero(seeds < 0), np.flatnonzero(seeds >= 0)
        if not free.size:
            return seeds
        laplacian = self.laplacian(self.crease_weights)
        arrivals = np.eye(labels)[seeds[fixed]]
        inner = splu(csc_array(laplacian[free][:, free]))
        chance = inner.solve(np.asarray(-(laplacian[free][:, fixed] @ arrivals)))
        result = seeds.copy()
        result[free] = np.argmax(chance, axis=1)
        return result
