"""Volume conductor: the torso's mesh around a heart, with unknown position, size, conductivities.

The heart is fixed, and the skin moves relative to it. A point x between them moves by the share
w(x) = d/(d + D) of the skin's motion, where d is its distance to the convex hull of heart and blood
and D its distance to the skin. Potentials on the moved torso are those on the unmoved mesh with the
conductivity σT, T = |J| J⁻¹J⁻ᵀ, where J is the Jacobian of that map at each tetrahedron's centre.
So nothing is meshed again, and flat tetrahedra, which would be inverted if their corners moved, do
no harm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import igl
import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart, Torso, TorsoTissue
from fascicle.heart.labelled_surface import ENDOCARDIA, LabelledMesh, labelled_mesh
from fascicle.mesh.measures import signed_volumes, solid_centroid, unit, winding_number
from fascicle.mesh.meshing import Interface, tetrahedralise
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.electrode_sites import FARTHEST, Electrode
from fascicle.torso.idealised import FITTED, fitted_torso, idealised_torso
from fascicle.torso.lead_fields import (
    hat_functions,
    outer_boundary,
    place_electrodes,
    stiffness_of,
    total_conductivity,
)
from fascicle.torso.surfaces import Surface

if TYPE_CHECKING:
    from skfem import Basis


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
        return least >= self.morph.least_compression

    def stiffness(self, state: TorsoState) -> csr_matrix:
        """Stiffness matrix (n, n) (1/kΩ), over the factor on the myocardium's conductivity."""
        heart, around = self._of_heart_and_around
        return heart + stiffness_of(around, self.moved(state))

    @cached_property
    def _of_heart_and_around(self) -> tuple[csr_matrix, Basis]:
        """Stiffness matrix of the heart, and hat functions of the torso around it."""
        vertices = self.torso.vertices
        heart = stiffness_of(hat_functions(vertices, self.heart.tetrahedra), self.of_heart)
        heart.resize(len(vertices), len(vertices))  # scikit-fem ends with the heart's vertices
        return heart, hat_functions(vertices, self.torso.tetrahedra)

    def moved(self, state: TorsoState, chosen: Booleans | slice = slice(None)) -> Floats:
        """σT of the torso's tetrahedra, or of the chosen ones (c, 3, 3), in a state (mS/cm)."""
        factors = state.ratios[self.torso.tissues - min(TorsoTissue)]
        sigma = self.around[chosen] * factors[chosen, None, None]
        jacobians = self.morph.at(chosen).jacobians(self.motion(state))
        return np.asarray(sigma @ pulled_back(jacobians))


def build_conductor(heart: Heart, torso: Torso, conduction: Conduction) -> Conductor:
    """Build the conductor of a heart in its torso, with the conductivities of `conduction`."""
    return Conductor(heart, torso, total_conductivity(heart, torso, conduction))


def torso_of(heart: Heart, progress: StageProgress = no_progress) -> Torso:
    """Torso of a heart; the idealised one if the heart is stored with lead fields only.

    The idealised torso is the standard one, or the one fitted to the heart's electrodes if its lead
    fields say `FITTED`. An error if electrodes are not on it: then it was another torso.
    """
    if heart.torso is not None:
        return heart.torso
    mesh = labelled_mesh(heart)
    if heart.lead_fields is not None and heart.lead_fields.torso == FITTED:
        surfaces, _ = fitted_torso(mesh, heart.electrodes, heart.name, {})
    else:
        surfaces = idealised_torso(mesh)
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs, progress)
    tetrahedra = np.concatenate([heart.tetrahedra, torso.tetrahedra])
    distance = place_electrodes(torso.vertices, tetrahedra, heart.electrodes).moved.max()
    if distance > FARTHEST:
        raise InputError(
            f"{heart.name}: its torso is not in the folder, and electrodes are {distance:.0f} mm "
            "from the skin of the idealised one; build the heart again with its torso"
        )
    return torso


def mesh_torso(
    mesh: LabelledMesh,
    skin: Surface,
    lungs: Sequence[Surface] = (),
    progress: StageProgress = no_progress,
) -> Torso:
    """Fill the space between myocardium, lungs and skin; the vertices begin with the heart's.

    No triangle of these surfaces, which `fascicle.torso.surfaces.check_within` accepts, is changed,
    so the result continues the heart's own mesh. Tetrahedra are blood if an endocardium and a lid
    over each of its openings enclose their centre: a winding number above one half (Jacobson, Kavan
    and Sorkine-Hornung 2013, ACM Trans Graph 32:33). The lid is not a surface of the mesh: the edge
    of a real heart's opening is too rough to hold one that nowhere cuts the tissue.
    """
    progress(0, 2)
    around, first_lung = 1, 2  # Netgen's numbers of the domains it fills; other lungs follow
    heart, triangles = without_unused_vertices(mesh.vertices, mesh.triangles)
    remedy = (
        "a surface crosses itself or another or is too rough; remesh the heart, the torso or the "
        "lungs more evenly"
    )
    # one optimisation step leaves no dihedral angle below 5 degrees around a good heart mesh
    vertices, tetrahedra, domains = tetrahedralise(
        [
            Interface(heart, triangles, 0, around),
            Interface(*skin, around),
            *(Interface(*lung, number, around) for number, lung in enumerate(lungs, first_lung)),
        ],
        f"{mesh.name}: the torso around it",
        remedy,
        maxh=15.0,
        grading=0.5,
        optsteps3d=1,
    )
    if flat := np.count_nonzero(signed_volumes(vertices, tetrahedra) <= 0):
        raise InputError(f"{mesh.name}: {flat} tetrahedra around it are flat; {remedy}")
    progress(1, 2)
    tissues = np.where(domains == around, int(TorsoTissue.OTHER), int(TorsoTissue.LUNG))
    centres = vertices[tetrahedra].mean(axis=1)
    for label in ENDOCARDIA:
        endocardium = mesh.having(label)
        lined = mesh.vertices[endocardium]
        low, high = lined.min(axis=(0, 1)), lined.max(axis=(0, 1))
        in_box = ((centres >= low) & (centres <= high)).all(axis=1)
        near = np.flatnonzero((domains == around) & in_box)
        within = winding_number(mesh.vertices, endocardium, centres[near]) > 0.5
        tissues[near[within]] = TorsoTissue.BLOOD
    used = np.unique(mesh.triangles)
    added = vertices[len(used) :]
    number = np.concatenate([used, len(mesh.vertices) + np.arange(len(added))])
    progress(2, 2)
    return Torso(np.concatenate([mesh.vertices, added]), number[tetrahedra], tissues)
