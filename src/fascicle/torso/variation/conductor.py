"""Volume conductor of heart and torso, with unknown heart position, torso size and conductivities.

The heart is fixed, and the skin moves relative to it. A point x between them moves by the share
w(x) = d/(d + D) of the skin's motion, where d is its distance to the convex hull of heart and blood
and D its distance to the skin. Potentials on the moved torso are those on the unmoved mesh with the
conductivity σT, T = |J| J⁻¹J⁻ᵀ, where J is the Jacobian of that map at each tetrahedron's centre.
So nothing is meshed again, and flat tetrahedra, which would be inverted if their corners moved, do
no harm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import igl
import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart, Torso, TorsoTissue
from fascicle.mesh.measures import solid_centroid, unit
from fascicle.torso.electrode_sites import Electrode
from fascicle.torso.lead_fields import assemble_stiffness, outer_boundary, total_conductivity


@dataclass(frozen=True)
class TorsoState:
    """Differences of a torso from the one in the heart's folder.

    Attributes
    ----------
    geometry : (7,) array
        Shift of the heart to the left, posteriorly and up (mm), its rotation vector along the same
        axes (rad), and a factor on the size of the trunk.
    ratios : (3,) array
        Factors on the conductivities of the `TorsoTissue`, over the factor on the myocardium's.
    chest : (6, 2) array
        Shifts of V1 to V6 along the skin, to the left and up (mm).
    """

    geometry: Floats
    ratios: Floats
    chest: Floats
    # half-widths of the ranges in which the response is interpolated: of the geometry (shifts in
    # mm, rotations in rad, size), and of the logarithm of each conductivity
    reach: ClassVar[Floats] = np.array([20.0] * 3 + [np.radians(20.0)] * 3 + [0.15])
    log_factor: ClassVar[float] = np.log(2.0)

    @classmethod
    def of(cls, values: Mapping[str, float]) -> TorsoState:
        """State of the values of quantities; missing ones leave the torso unchanged."""
        pose = [
            values.get(f"heart_{turn}{axis}", 0.0)
            for turn in ("", "rotation_")
            for axis in ("left", "posterior", "up")
        ]
        tissues = ("body", "lung", "blood")  # in the order of `TorsoTissue`
        ratios = np.array([values.get(f"{tissue}_conductivity", 1.0) for tissue in tissues])
        all_up = values.get("chest_electrodes_up", 0.0)
        chest = [
            (values.get(f"v{k}_left", 0.0), values.get(f"v{k}_up", 0.0) + all_up)
            for k in range(1, 7)
        ]
        geometry = np.array([*pose, values.get("chest_size", 1.0)])
        myocardium = values.get("myocardium_conductivity", 1.0)
        return cls(geometry, ratios / myocardium, np.array(chest))


def torso_axes(electrodes: Floats) -> Floats:
    """Directions of the torso in the heart's coordinates, from the limb electrodes.

    The line from RA to LA points left; LL lies in the frontal plane with them, not necessarily
    midway below. Rows (3, 3): to the patient's left, to the back, up; orthonormal, right-handed.
    """
    left = unit(electrodes[Electrode.LA] - electrodes[Electrode.RA])
    upwards = electrodes[:2].mean(axis=0) - electrodes[Electrode.LL]
    back = unit(np.cross(upwards, left))
    return np.stack([left, back, np.cross(left, back)])


@dataclass(frozen=True)
class SkinMotion:
    """Motion of the skin relative to a fixed heart: x → c + Rᵀ(s(x − c) − t).

    c is the heart's centroid (mm), R its rotation about c, t its shift in the chest (mm), and s the
    factor on the size of the trunk, about c.
    """

    centroid: Floats
    rotation: Floats
    shift: Floats
    size: float

    @classmethod
    def of(cls, centroid: Floats, axes: Floats, state: TorsoState) -> SkinMotion:
        """Motion of a state, along the torso's axes."""
        rotation = Rotation.from_rotvec(state.geometry[3:6] @ axes).as_matrix()
        return cls(centroid, rotation, state.geometry[:3] @ axes, float(state.geometry[6]))

    def __call__(self, points: Floats) -> Floats:
        """Moved positions of points (..., 3) that move with the skin (mm)."""
        moved = self.size * (points - self.centroid) - self.shift
        return np.asarray(self.centroid + moved @ self.rotation)


@dataclass(frozen=True)
class Morph:
    """Map x → x + w(x)(y(x) − x) of the torso for a motion y of its skin, at points (m, 3), mm.

    The points are the centres of the torso's tetrahedra. `share` is w (m,), 0 in the convex hull of
    heart and blood and 1 on the skin; `slope` is ∇w (m, 3), 1/mm.
    """

    centres: Floats
    share: Floats
    slope: Floats
    # least |J| of a possible state: tissue may be compressed to a tenth of its volume
    least_compression: ClassVar[float] = 0.1

    def jacobians(self, motion: SkinMotion) -> Floats:
        """J = I + (y(x) − x)⊗∇w + w(∇y − I) for the skin's motion y, shape (m, 3, 3)."""
        displacement = motion(self.centres) - self.centres
        strain = motion.size * motion.rotation.T - np.eye(3)
        sheared = np.eye(3) + displacement[:, :, None] * self.slope[:, None, :]
        return np.asarray(sheared + self.share[:, None, None] * strain)

    def determinants(self, motion: SkinMotion) -> Floats:
        """|J| (m,): factors on volumes, at or below 0 where heart and skin touch."""
        columns = np.moveaxis(self.jacobians(motion), 2, 0)
        return np.asarray(np.einsum("mi,mi->m", columns[0], np.cross(columns[1], columns[2])))

    def at(self, chosen: Integers | Booleans | slice) -> Morph:
        """Map at some of the points."""
        return Morph(self.centres[chosen], self.share[chosen], self.slope[chosen])


def pulled_back(jacobians: Floats) -> Floats:
    """|J| J⁻¹J⁻ᵀ = C Cᵀ/|J| for the cofactors C of J, transposed; (m, 3, 3)."""
    columns = [jacobians[:, :, k] for k in range(3)]  # their cross products are rows of C
    cofactor = [np.cross(columns[(k + 1) % 3], columns[(k + 2) % 3]) for k in range(3)]
    determinant = np.einsum("mi,mi->m", columns[0], cofactor[0])
    tensors = np.empty_like(jacobians)
    for i in range(3):
        for j in range(i, 3):
            product = np.einsum("mi,mi->m", cofactor[i], cofactor[j])
            tensors[:, i, j] = tensors[:, j, i] = product / determinant
    return tensors


def build_morph(heart: Heart, torso: Torso, skin: Integers) -> Morph:
    """Map at the centres of a torso's tetrahedra, from the triangles (t, 3) of its skin."""
    blood = torso.tetrahedra[torso.tissues == TorsoTissue.BLOOD]
    inner = torso.vertices[np.union1d(heart.tetrahedra, blood)]
    hull = ConvexHull(inner)
    centres = torso.vertices[torso.tetrahedra].mean(axis=1)
    to_hull, from_hull = _distance_and_gradient(centres, inner, hull.simplices.astype(np.int64))
    to_skin, from_skin = _distance_and_gradient(centres, torso.vertices, skin)
    inside = Delaunay(inner[hull.vertices]).find_simplex(centres) >= 0
    distance = to_hull + to_skin
    slope = (to_skin[:, None] * from_hull - to_hull[:, None] * from_skin) / distance[:, None] ** 2
    slope[inside], share = 0.0, np.where(inside, 0.0, to_hull / distance)
    return Morph(centres, share, slope)


def _distance_and_gradient(
    points: Floats, vertices: Floats, triangles: Integers
) -> tuple[Floats, Floats]:
    """Distances (m,) to a surface (mm), and their gradients (m, 3), unit vectors."""
    squared, _, nearest = igl.point_mesh_squared_distance(points, vertices, triangles)
    distance = np.sqrt(np.maximum(squared, 1e-12))
    return distance, (points - nearest) / distance[:, None]


@dataclass(frozen=True)
class Conductor:
    """Mesh of heart and torso, with σ as a function of the state of the torso.

    `conductivity` (m, 3, 3) is σ of the heart's tetrahedra, then of the torso's (mS/cm), in the
    unchanged torso.
    """

    heart: Heart
    torso: Torso
    conductivity: Floats

    @cached_property
    def tetrahedra(self) -> Integers:
        """Tetrahedra (m, 4) of the heart, then of the torso."""
        return np.concatenate([self.heart.tetrahedra, self.torso.tetrahedra])

    @cached_property
    def skin(self) -> Integers:
        """Triangles of the skin (t, 3)."""
        return outer_boundary(self.torso.vertices, self.tetrahedra)

    @cached_property
    def morph(self) -> Morph:
        """Map at the centres of the torso's tetrahedra."""
        return build_morph(self.heart, self.torso, self.skin)

    @property
    def of_heart(self) -> Floats:
        """σ of the heart's tetrahedra (h, 3, 3)."""
        return self.conductivity[: len(self.heart.tetrahedra)]

    @property
    def around(self) -> Floats:
        """σ of the torso's tetrahedra (t, 3, 3)."""
        return self.conductivity[len(self.heart.tetrahedra) :]

    @cached_property
    def inside(self) -> Booleans:
        """Whether the torso's tetrahedra (t,) lie in the convex hull of heart and blood."""
        return np.asarray(self.morph.share == 0)

    @cached_property
    def in_hull(self) -> Integers:
        """Tetrahedra (i, 4) in the hull of heart and blood: the heart's, then the torso's."""
        return np.concatenate([self.heart.tetrahedra, self.torso.tetrahedra[self.inside]])

    @cached_property
    def hull_surface(self) -> Integers:
        """Vertices (s,) on the surface of the convex hull of heart and blood."""
        return np.intersect1d(self.in_hull, self.torso.tetrahedra[~self.inside])

    @cached_property
    def axes(self) -> Floats:
        """Unit vectors to the left, back and up, the rows of (3, 3)."""
        return torso_axes(self.heart.electrodes)

    @cached_property
    def centroid(self) -> Floats:
        """Centroid of the myocardium (3,), mm."""
        return solid_centroid(self.heart.vertices, self.heart.tetrahedra)

    def motion(self, state: TorsoState) -> SkinMotion:
        """Motion of the skin around the heart."""
        return SkinMotion.of(self.centroid, self.axes, state)

    def is_possible(self, state: TorsoState) -> bool:
        """True if no tissue between heart and skin is compressed too much, or inverted."""
        least = float(self.morph.determinants(self.motion(state)).min())
        return least > self.morph.least_compression

    def stiffness(self, state: TorsoState) -> csr_matrix:
        """Stiffness matrix (n, n) (1/kΩ), over the factor on the myocardium's conductivity."""
        sigma = np.concatenate([self.of_heart, self.moved(state)])
        return assemble_stiffness(self.torso.vertices, self.tetrahedra, sigma)

    def moved(self, state: TorsoState, chosen: Booleans | slice = slice(None)) -> Floats:
        """σT of the torso's tetrahedra, or of the chosen ones (c, 3, 3), in a state (mS/cm)."""
        factors = state.ratios[self.torso.tissues - min(TorsoTissue)]
        sigma = self.around[chosen] * factors[chosen, None, None]
        jacobians = self.morph.at(chosen).jacobians(self.motion(state))
        return np.asarray(sigma @ pulled_back(jacobians))


def build_conductor(heart: Heart, torso: Torso, conduction: Conduction) -> Conductor:
    """Build the conductor of a heart in its torso, with the conductivities of `conduction`."""
    return Conductor(heart, torso, total_conductivity(heart, torso, conduction))
