"""What is outside the hull of heart and blood, as the hull's surface sees it.

A potential B on the hull's surface sets up a potential E(body) outside, insulated at the skin. The
energy of E is what the outside adds to the hull's, and E at an electrode is, by reciprocity,
the current that a unit current into that electrode drives into the hull. Nothing else of the
outside is felt within: static condensation (Huynh, Knezevic and Patera, ESAIM: Math. Model. Numer.
Anal. 47, 2013, 213-251).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial.distance import cdist

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.heart import TorsoTissue
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.lead_fields import MM_PER_CM, Contacts, assemble_stiffness
from fascicle.torso.variation.block_solver import block_cg, multigrid
from fascicle.torso.variation.conductor import BodyState, Conductor

TOLERANCE, MOST_ITERATIONS = 3e-4, 60  # of the potentials outside
EXACTLY, MANY_ITERATIONS = 1e-6, 500


@dataclass(frozen=True)
class Part:
    """Some tetrahedra of a conductor, with vertices numbered among themselves.

    Attributes
    ----------
    used : (n,) array
        Their numbers in the whole mesh.
    points : (n, 3) array
        Vertices (mm).
    corners : (m, 4) array
        Tetrahedra.
    surface, free : arrays
        Vertices on the hull's surface, and the others.
    """

    used: Integers
    points: Floats
    corners: Integers
    surface: Integers
    free: Integers

    @classmethod
    def of(cls, vertices: Floats, tetrahedra: Integers, surface: Integers | tuple[()] = ()) -> Part:
        """Of tetrahedra and vertices of the surface, numbered in the whole mesh."""
        used = np.unique(tetrahedra)
        on = np.isin(used, surface)
        points, corners = without_unused_vertices(vertices, tetrahedra)
        return cls(used, points, corners, np.flatnonzero(on), np.flatnonzero(~on))

    def extended(
        self, conductivity: Floats, values: Floats, tolerance: float, most: int
    ) -> tuple[csr_matrix, Floats]:
        """The harmonic extension (n, k) of values (s, k) on the surface, and the stiffness."""
        stiffness = assemble_stiffness(self.points, self.corners, conductivity)
        inner = stiffness[self.free]
        load = -(inner[:, self.surface] @ values)
        matrix = inner[:, self.free].tocsr()
        found = np.empty((len(self.points), values.shape[1]))
        found[self.surface] = values
        found[self.free] = block_cg(
            matrix, multigrid(matrix), load, np.zeros_like(load), tolerance, most
        )
        return stiffness, found


@dataclass(frozen=True)
class Exterior:
    """The outside of a heart's hull.

    Attributes
    ----------
    conductor : Conductor
        Heart, torso and electrodes.
    surface : (s,) array
        Vertices of the hull's surface.
    values : (s, k) array
        B there.
    contacts : Contacts
        Places of electrodes on the skin.
    """

    conductor: Conductor
    surface: Integers
    values: Floats
    contacts: Contacts

    @cached_property
    def part(self) -> Part:
        """The tetrahedra outside."""
        torso = self.conductor.torso
        return Part.of(torso.vertices, torso.tetrahedra[~self.conductor.inside], self.surface)

    @cached_property
    def at_contacts(self) -> csr_matrix:
        """Values at the contacts of values at the part's vertices (p, n)."""
        used = self.part.used
        columns = np.searchsorted(used, self.contacts.triangles)
        rows = np.repeat(np.arange(len(columns)), 3)
        shape = len(columns), len(used)
        return csr_matrix((self.contacts.weights.ravel(), (rows, columns.ravel())), shape=shape)

    def __call__(self, state: BodyState) -> tuple[Floats, Floats]:
        """Energy of E (k, k), and E at the contacts (p, k), where the body conducts as it is.

        The factor on the lungs' conductivity counts through its ratio to the body's.
        """
        conductor, outside = self.conductor, ~self.conductor.inside
        sigma = conductor.moved(state, outside) / state.ratios[0]
        stiffness, found = self.part.extended(sigma, self.values, TOLERANCE, MOST_ITERATIONS)
        return found.T @ (stiffness @ found), self.at_contacts @ found


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


def near_field(conductor: Conductor, surface: Integers, values: Floats) -> NearField:
    """Of a hull's surface vertices (s,) and B there (s, k)."""
    part = Part.of(conductor.torso.vertices, conductor.in_hull, surface)
    tissue = conductor.torso.tissues == TorsoTissue.BODY
    isotropic = conductor.around[tissue][0]
    sigma = np.broadcast_to(isotropic, (len(part.corners), 3, 3))
    stiffness, found = part.extended(sigma, values, EXACTLY, MANY_ITERATIONS)
    flux = stiffness[part.surface] @ found
    filled = values.T @ flux
    filled = (filled + filled.T) / 2
    amplitude = MM_PER_CM / (2 * np.pi * isotropic[0, 0])
    return NearField(
        part.points[part.surface], amplitude * np.linalg.solve(filled, flux.T).T, filled
    )
