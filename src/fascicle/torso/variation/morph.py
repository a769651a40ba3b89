"""How the conductor around a heart changes, in the heart's frame, as the body moves around it.

A point x of the torso moves by a share w(x) of what the skin moves by, w = d/(d + D) for its
distances d to the convex hull of heart and blood and D to the skin. The potentials on the moved
body are those on the unmoved mesh with the conductivity σT, T = |J| J⁻¹J⁻ᵀ with the Jacobian J of
that map, taken at each tetrahedron's centre: nothing is meshed again, and flat tetrahedra, which
moving their corners would turn over, do no harm.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from scipy.spatial import ConvexHull

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.heart import Heart, Torso, TorsoTissue
from fascicle.torso.variation.body_axes import Motion


@dataclass(frozen=True)
class Morph:
    """The map at some points: the centres of the torso's tetrahedra.

    Attributes
    ----------
    centres : (m, 3) array
        Where (mm).
    share : (m,) array
        w: 0 in the heart's convex hull, 1 on the skin.
    slope : (m, 3) array
        ∇w (1/mm).
    """

    centres: Floats
    share: Floats
    slope: Floats

    def jacobians(self, motion: Motion) -> Floats:
        """J = I + (y(x) − x)⊗∇w + w(∇y − I) for the skin's motion y, shape (m, 3, 3)."""
        away = motion.of_skin(self.centres) - self.centres
        linear = motion.size * motion.turn.T - np.eye(3)
        return np.asarray(
            np.eye(3)
            + away[:, :, None] * self.slope[:, None, :]
            + self.share[:, None, None] * linear
        )

    def determinants(self, motion: Motion) -> Floats:
        """|J| (m,): what becomes of volumes, at or below 0 where heart and skin touch.

        For J = M + a⊗∇w with M = I + wL it is |M| + ∇w·adj(M)a, a polynomial in w.
        """
        away = motion.of_skin(self.centres) - self.centres
        linear = motion.size * motion.turn.T - np.eye(3)
        trace, square = np.trace(linear), linear @ linear
        minors = (trace**2 - np.trace(square)) / 2
        adjugate = square - trace * linear + minors * np.eye(3)
        w = self.share
        own = 1 + w * (trace + w * (minors + w * np.linalg.det(linear)))
        first = away @ (trace * np.eye(3) - linear).T
        second = away @ adjugate.T
        moved = away + w[:, None] * (first + w[:, None] * second)
        return np.asarray(own + np.einsum("mi,mi->m", self.slope, moved))

    def compression(self, motion: Motion) -> float:
        """Least determinant of J: 0 where heart and skin touch."""
        return float(self.determinants(motion).min())

    def tensors(self, motion: Motion) -> Floats:
        """T, the factor on an isotropic conductivity, as its six entries `UPPER`; (m, 6)."""
        return pulled_back(self.jacobians(motion))

    def of(self, chosen: Integers | Booleans | slice) -> Morph:
        """The same for some of the points."""
        return Morph(self.centres[chosen], self.share[chosen], self.slope[chosen])


UPPER = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def pulled_back(jacobians: Floats) -> Floats:
    """Entries `UPPER` of |J| J⁻¹J⁻ᵀ = C Cᵀ/|J| for the cofactors C of J, transposed; (m, 6)."""
    rows = [jacobians[:, :, k] for k in range(3)]  # columns of J, as their products are rows of C
    cofactor = [np.cross(rows[(k + 1) % 3], rows[(k + 2) % 3]) for k in range(3)]
    determinant = np.einsum("mi,mi->m", rows[0], cofactor[0])
    products = [np.einsum("mi,mi->m", cofactor[i], cofactor[j]) for i, j in UPPER]
    return np.asarray(np.stack(products, axis=1) / determinant[:, None])


def symmetric(entries: Floats) -> Floats:
    """Matrices (m, 3, 3) of their entries `UPPER` (m, 6)."""
    full = np.empty((len(entries), 3, 3))
    for column, (i, j) in enumerate(UPPER):
        full[:, i, j] = full[:, j, i] = entries[:, column]
    return full


def build_morph(heart: Heart, torso: Torso, skin: Integers) -> Morph:
    """The map at the centres of a torso's tetrahedra.

    Parameters
    ----------
    heart, torso : Heart, Torso
        The myocardium and what is around it.
    skin : (t, 3) array
        Triangles of the skin.
    """
    blood = torso.tetrahedra[torso.tissues == TorsoTissue.BLOOD]
    inner = torso.vertices[np.union1d(heart.tetrahedra, blood)]
    hull = ConvexHull(inner)
    centres = torso.vertices[torso.tetrahedra].mean(axis=1)
    to_hull, from_hull = _away(centres, inner, hull.simplices.astype(np.int64))
    to_skin, from_skin = _away(centres, torso.vertices, skin)
    inside = (centres @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1) <= 0
    whole = to_hull + to_skin
    slope = (to_skin[:, None] * from_hull - to_hull[:, None] * from_skin) / whole[:, None] ** 2
    slope[inside], share = 0.0, np.where(inside, 0.0, to_hull / whole)
    return Morph(centres, share, slope)


def _away(points: Floats, vertices: Floats, triangles: Integers) -> tuple[Floats, Floats]:
    """Distances (m,) to a surface (mm), and the unit vectors (m, 3) along which they grow."""
    squared, _, nearest = igl.point_mesh_squared_distance(points, vertices, triangles)
    distance = np.sqrt(np.maximum(squared, 1e-12))
    return distance, (points - nearest) / distance[:, None]
