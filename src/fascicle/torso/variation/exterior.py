"""What is outside the hull of heart and blood, as the hull's surface sees it.

A potential B on the hull's surface sets up a potential E(body) outside, insulated at the skin. The
energy of E is what the outside adds to the hull's, and E at an electrode is, by reciprocity,
the current that a unit current into that electrode drives into the hull. Nothing else of the
outside is felt within: static condensation (Huynh, Knezevic and Patera, ESAIM: Math. Model. Numer.
Anal. 47, 2013, 213-251).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial.distance import cdist

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.lead_fields import MM_PER_CM, Contacts, assemble_stiffness, multigrid_levels
from fascicle.torso.variation.conductor import BodyState, Conductor

Preconditioner = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Exterior:
    """The outside of a heart's hull, for B (s, k) on the hull's surface, the `values`.

    And for the places of electrodes on the skin; with a relative tolerance for the potentials
    outside.
    """

    conductor: Conductor
    values: Floats
    contacts: Contacts
    tolerance: float = 3e-4

    @cached_property
    def part(self) -> Part:
        """The tetrahedra outside."""
        conductor = self.conductor
        return Part.of(conductor, conductor.torso.tetrahedra[~conductor.inside])

    @cached_property
    def at_contacts(self) -> csr_matrix:
        """Values at the contacts of values at the part's vertices (p, n)."""
        columns = np.searchsorted(self.part.used, self.contacts.triangles)
        rows = np.repeat(np.arange(len(columns)), 3)
        shape = len(columns), len(self.part.used)
        return csr_matrix((self.contacts.weights.ravel(), (rows, columns.ravel())), shape=shape)

    def __call__(self, state: BodyState) -> tuple[Floats, Floats]:
        """Energy of E (k, k), and E at the contacts (p, k), over the body's conductivity.

        The factor on the lungs' conductivity counts through its ratio to the body's.
        """
        sigma = self.conductor.moved(state, ~self.conductor.inside) / state.ratios[0]
        stiffness, found = self.part.extended(sigma, self.values, self.tolerance, 60)
        return found.T @ (stiffness @ found), self.at_contacts @ found


class Part(NamedTuple):
    """Some tetrahedra of a conductor, with vertices numbered among themselves.

    Numbers (n,) of the vertices used in the whole mesh, their points (n, 3) (mm), the corners (m,
    4) of the tetrahedra, and which vertices lie on the hull's surface (n,).
    """

    used: Integers
    points: Floats
    corners: Integers
    on_surface: Booleans

    @classmethod
    def of(cls, conductor: Conductor, tetrahedra: Integers) -> Part:
        """Of tetrahedra numbered in the whole mesh."""
        used = np.unique(tetrahedra)
        points, corners = without_unused_vertices(conductor.torso.vertices, tetrahedra)
        return cls(used, points, corners, np.isin(used, conductor.hull_surface))

    def stiffness(self, conductivity: Floats) -> csr_matrix:
        """Conductances (n, n) (1/kΩ) for σ (m, 3, 3)."""
        return assemble_stiffness(self.points, self.corners, conductivity)

    def extended(
        self, conductivity: Floats, values: Floats, tolerance: float, most: int
    ) -> tuple[csr_matrix, Floats]:
        """The stiffness, and the harmonic extension (n, k) of values (s, k) on the surface."""
        stiffness, free = self.stiffness(conductivity), ~self.on_surface
        inner = stiffness[free]
        load = -(inner[:, self.on_surface] @ values)
        matrix = inner[:, free].tocsr()
        found = np.empty((len(self.points), values.shape[1]))
        found[self.on_surface] = values
        found[free] = block_cg(matrix, multigrid(matrix), load, tolerance, most)
        return stiffness, found


@dataclass(frozen=True)
class NearField:
    """What an electrode in plain body tissue without end would drive into the hull.

    Attributes
    ----------
    points : (s, 3) array
        Of the hull's surface (mm).
    projection : (s, k) array
        Makes coefficients of B of 1/distance (1/mm) to the points: the potential of a unit current
        into an insulated plane, 1/(2πσr), projected in the energy of a hull of plain tissue.
    filled : (k, k) array
        Energy of B in that hull (1/kΩ).
    """

    points: Floats
    projection: Floats
    filled: Floats

    def __call__(self, electrodes: Floats, outer: Floats) -> Floats:
        """E at electrodes (e, 3) on the skin as they stand to the heart, for an energy outside."""
        within = (1.0 / cdist(electrodes, self.points)) @ self.projection
        return np.asarray(within @ (outer + self.filled))


def near_field(conductor: Conductor, values: Floats) -> NearField:
    """Of B (s, k) on the hull's surface."""
    part = Part.of(conductor, conductor.in_hull)
    isotropic = conductor.around[conductor.torso.tissues == TorsoTissue.BODY][0]
    sigma = np.broadcast_to(isotropic, (len(part.corners), 3, 3))
    stiffness, found = part.extended(sigma, values, 1e-6, 500)
    flux = stiffness[part.on_surface] @ found
    filled = values.T @ flux
    filled = (filled + filled.T) / 2
    amplitude = MM_PER_CM / (2 * np.pi * isotropic[0, 0])
    projection = amplitude * np.linalg.solve(filled, flux.T).T
    return NearField(part.points[part.on_surface], projection, filled)


def block_cg(
    stiffness: csr_matrix,
    precondition: Preconditioner,
    currents: Floats,
    tolerance: float,
    most: int,
) -> Floats:
    """Conjugate gradients, preconditioned, for several right-hand sides (n, c) in step.

    Products with all columns at once cost a fraction of as many products with one. It ends when all
    residuals are below the tolerance, relative to the right-hand side, or after so many iterations.
    """
    potential = np.zeros_like(currents)
    residual = currents.copy()
    wanted = tolerance * np.linalg.norm(currents, axis=0)
    direction, previous = np.zeros_like(residual), np.ones(currents.shape[1])
    for _ in range(most):
        if (np.linalg.norm(residual, axis=0) <= wanted).all():
            break
        corrected = precondition(residual)
        product = np.einsum("nc,nc->c", residual, corrected)
        direction = corrected + direction * (product / previous)
        along = stiffness @ direction
        curvature = np.einsum("nc,nc->c", direction, along)
        step = np.divide(product, curvature, out=np.zeros_like(product), where=curvature > 0)
        potential += step * direction
        residual -= step * along
        previous = np.where(product > 0, product, 1.0)
    return potential


def multigrid(stiffness: csr_matrix) -> Preconditioner:
    """One V-cycle of smoothed aggregation on columns (n, c), with two ℓ₁-Jacobi sweeps a side.

    That smoother converges for every symmetric positive definite matrix (Baker, Falgout, Kolev and
    Yang, SIAM J. Sci. Comput. 33, 2011, 2864-2887). In single precision, which is enough for a
    preconditioner and takes half the memory's time.
    """
    hierarchy = multigrid_levels(stiffness)
    levels = [
        tuple(csr_matrix(matrix).astype(np.float32) for matrix in (a.A, a.P, a.R))
        for a in hierarchy.levels[:-1]
    ]
    inverse = [1 / np.asarray(abs(matrix).sum(axis=1)) for matrix, _, _ in levels]
    # some tens of unknowns
    coarsest = np.linalg.inv(hierarchy.levels[-1].A.toarray()).astype(np.float32)

    def cycle(depth: int, residual: Floats) -> Floats:
        if depth == len(levels):
            return np.asarray(coarsest @ residual)
        matrix, prolong, restrict = levels[depth]
        found = inverse[depth] * residual
        found += inverse[depth] * (residual - matrix @ found)
        found += prolong @ cycle(depth + 1, restrict @ (residual - matrix @ found))
        for _ in range(2):
            found += inverse[depth] * (residual - matrix @ found)
        return np.asarray(found)

    return lambda residual: cycle(0, residual.astype(np.float32))
