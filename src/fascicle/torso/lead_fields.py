"""Lead fields of a heart in its torso, by finite elements.

The lead field Z of an electrode is the potential that unit current through the electrode sets up,

    −∇·(σ∇Z) = δ(electrode) − common reference,    σ∂Z/∂n = 0 on the skin,

with σ = Gᵢ + Gₑ in the myocardium. By reciprocity a current dipole p at x then puts the potential
p·∇Z(x) on the electrode (McFee and Johnston, Circulation 8, 1953, 554-568; Geselowitz, Biophys. J.
7, 1967, 1-11; Colli Franzone, Guerri, Viganotti, Macchi, Baruffi, Spaggiari and Taccardi, Circ.
Res. 51, 1982, 330-346).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import igl
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart, LeadFields, Torso, TorsoTissue, digest_of
from fascicle.heart.laplace import smoothed_aggregation
from fascicle.mesh.checks import refuse
from fascicle.mesh.topology import boundary_triangles
from fascicle.torso.electrode_sites import check_on_skin

if TYPE_CHECKING:
    from skfem import Basis

Preconditioner = Callable[[Floats], Floats]

MM_PER_CM = 10.0


@dataclass(frozen=True)
class Contacts:
    """Contacts of electrodes with the skin.

    Vertices of the triangle that each electrode touches (e, 3), and barycentric coordinates in it
    (e, 3), which are also the shares of the current; distances (mm) from the given positions (e,).
    """

    triangles: Integers
    weights: Floats
    moved: Floats

    def points(self, values: Floats) -> Floats:
        """Interpolate values at the vertices (n, k), such as positions, to the contacts (e, k)."""
        return np.asarray((self.weights[:, :, None] * values[self.triangles]).sum(axis=1))

    def currents(self, vertices: int) -> Floats:
        """Unit current into each electrode, out through the nine equally: (e, vertices), in µA.

        It leaves through all electrodes equally if there are fewer than nine.
        """
        inflow = np.zeros((len(self.triangles), vertices))
        np.add.at(inflow, (np.arange(len(inflow))[:, None], self.triangles), self.weights)
        return np.asarray(inflow - inflow[: len(ELECTRODES)].mean(axis=0))


def resolve_lead_fields(
    heart: Heart, conduction: Conduction, progress: StageProgress = no_progress
) -> LeadFields | None:
    """Lead fields of a heart: the stored ones if up to date, else solved in its torso.

    None where the volume conductor is unbounded; an error if the heart's own are out of date and
    there is no torso to compute others in.
    """
    torso = heart.torso
    if is_up_to_date(heart, conduction) or (torso is None and heart.lead_fields is None):
        return heart.lead_fields
    if torso is None:
        raise InputError(
            f"{heart.name}: its lead fields are for other electrodes, fibres or conductivities, "
            "and there is no torso to compute new ones in; build the heart again with a torso"
        )
    values = lead_fields(heart, torso, conduction, progress)
    return LeadFields(values, key_of(heart, conduction), torso_key(torso))


def is_up_to_date(heart: Heart, conduction: Conduction) -> bool:
    """True if a heart's own lead fields are those of its electrodes, fibres, torso and tissues."""
    fields = heart.lead_fields
    return (
        fields is not None
        and fields.key == key_of(heart, conduction)
        and (heart.torso is None or fields.torso == torso_key(heart.torso))
    )


def torso_key(torso: Torso | None) -> str:
    """SHA-256 of a torso; empty for a heart that carries its lead fields without one."""
    return "" if torso is None else digest_of(torso.vertices, torso.tetrahedra, torso.tissues)


def key_of(heart: Heart, conduction: Conduction) -> str:
    """SHA-256 of the heart, electrodes and conductivities, on which lead fields in a torso depend.

    The torso itself is left out, so that a heart can carry its lead fields without it.
    """
    c = conduction
    of_muscle = c.intracellular_l, c.intracellular_t, c.extracellular_l, c.extracellular_t
    conductivities = np.array([*of_muscle, c.body, c.lung, c.blood])
    of_heart = heart.vertices, heart.tetrahedra, heart.fibres, heart.electrode_positions
    return digest_of(*of_heart, conductivities)


def lead_fields(
    heart: Heart, torso: Torso, conduction: Conduction, progress: StageProgress = no_progress
) -> Floats:
    """Lead fields (9 + a, n) of the heart's electrodes, at its vertices (mV/µA, that is kΩ).

    Fields of the nine sum to zero at every vertex: a field, of additional electrodes too, is for
    unit current that leaves through all nine equally, which affects no lead. Scar
    (`Conduction.regions`) is treated as intact: tissue that is not activated still conducts
    extracellularly, and its conductivity is not known. InputError if an electrode is far from the
    skin, the mesh falls into pieces, or the solver does not converge.
    """
    tetrahedra = np.concatenate([heart.tetrahedra, torso.tetrahedra])
    contacts = place_electrodes(torso.vertices, tetrahedra, heart.electrode_positions)
    check_on_skin(heart, contacts.moved)
    conductivity = total_conductivity(heart, torso, conduction)
    progress(0, len(heart.electrode_names))
    stiffness = assemble_stiffness(torso.vertices, tetrahedra, conductivity)
    fields = solve_neumann(stiffness, contacts.currents(len(torso.vertices)), progress)
    return fields[:, : len(heart.vertices)].copy()


def place_electrodes(vertices: Floats, tetrahedra: Integers, electrodes: Floats) -> Contacts:
    """Contacts on the whole conductor's skin nearest to electrodes (e, 3) (mm)."""
    return contacts_on(vertices, outer_boundary(vertices, tetrahedra), electrodes)


def contacts_on(vertices: Floats, skin: Integers, points: Floats) -> Contacts:
    """Contacts on the triangles (t, 3) of a skin nearest to points (e, 3) (mm)."""
    squared, nearest, points = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points, dtype=float), vertices, skin
    )
    triangles = skin[nearest]
    corners = (np.ascontiguousarray(vertices[triangles[:, k]]) for k in range(3))
    return Contacts(triangles, igl.barycentric_coordinates(points, *corners), np.sqrt(squared))


def total_conductivity(heart: Heart, torso: Torso, conduction: Conduction) -> Floats:
    """σ (m, 3, 3) of the heart's tetrahedra, Gᵢ + Gₑ, then of the torso's, isotropic (mS/cm)."""
    of_tissue = np.zeros(max(TorsoTissue) + 1)
    of_tissue[TorsoTissue.OTHER] = conduction.body
    of_tissue[TorsoTissue.LUNG] = conduction.lung
    of_tissue[TorsoTissue.BLOOD] = conduction.blood
    around = of_tissue[torso.tissues][:, None, None] * np.eye(3)
    return np.concatenate([conduction.bulk(heart.fibres), around])


def assemble_stiffness(vertices: Floats, tetrahedra: Integers, conductivity: Floats) -> csr_matrix:
    """Kᵢⱼ = ∫ ∇λᵢ·σ∇λⱼ dx for the hat functions λ of linear elements.

    Conductances (n, n) (mS, that is 1/kΩ) for σ (m, 3, 3) (mS/cm) on a mesh in mm, each of whose
    vertices belongs to a tetrahedron.
    """
    unused = np.bincount(tetrahedra.ravel(), minlength=len(vertices)) == 0
    name = "mesh of heart and torso"
    refuse(name, unused, "vertices belong to no tetrahedron", "leave them out", vertices)
    return stiffness_of(hat_functions(vertices, tetrahedra), conductivity)


def hat_functions(vertices: Floats, tetrahedra: Integers) -> Basis:
    """Hat functions of a mesh in mm, up to the last vertex that belongs to a tetrahedron."""
    from skfem import Basis, ElementTetP1, MeshTet

    points = np.ascontiguousarray(vertices.T) / MM_PER_CM
    mesh = MeshTet(points, np.ascontiguousarray(tetrahedra.T), validate=False)
    # one quadrature point, as gradients are constant in an element
    return Basis(mesh, ElementTetP1(), intorder=1)


def stiffness_of(functions: Basis, conductivity: Floats) -> csr_matrix:
    """Stiffness matrix (n, n) of `hat_functions`, as in `assemble_stiffness`."""
    from skfem import BilinearForm
    from skfem.helpers import dot, mul

    @BilinearForm
    def conductance(u, v, w):  # type: ignore[no-untyped-def]
        return dot(mul(w["sigma"], u.grad), v.grad)

    sigma = np.ascontiguousarray(np.moveaxis(conductivity, 0, 2))[..., None]
    return conductance.assemble(functions, sigma=sigma).tocsr()


def solve_neumann(
    stiffness: csr_matrix,
    currents: Floats,
    progress: StageProgress = no_progress,
    most_iterations: int = 500,
) -> Floats:
    """Potentials (e, n) (mV), each of mean zero, for currents into an insulated conductor.

    The stiffness (n, n) is that of `assemble_stiffness` (1/kΩ); currents (e, n) into each vertex
    are in µA, and each row sums to zero. Good meshes of 300,000 vertices take 30 iterations.

    Conjugate gradients, preconditioned by smoothed aggregation (Vaněk, Mandel and Brezina,
    Computing 56, 1996, 179-196). The conductor is grounded at one vertex: the system is then
    regular, and as the currents are balanced none flows to ground, so the potentials change by
    constants only.
    """
    pieces, _ = connected_components(stiffness, directed=False)
    if pieces > 1:
        raise InputError(
            f"the mesh of heart and torso falls into {pieces} pieces that share no vertex; mesh "
            "them together"
        )
    conductor = grounded(stiffness)
    preconditioner = smoothed_aggregation(conductor).aspreconditioner(cycle="V")

    def solve(current: Floats) -> Floats:
        # then ∇Z in the heart is accurate to 1e-7, and reciprocity holds to 1e-6
        potential, failed = cg(
            conductor, current, rtol=1e-9, maxiter=most_iterations, M=preconditioner
        )
        if failed:
            raise InputError(
                f"no lead field in {most_iterations} iterations; the mesh of heart and torso has "
                "flat elements, remesh it"
            )
        return np.asarray(potential - potential.mean())

    potentials = np.empty_like(currents)
    # threads, as smoothing and products are compiled and release the interpreter lock
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for done, potential in enumerate(pool.map(solve, currents)):
            potentials[done] = potential
            progress(done + 1, len(currents))
    return potentials


def grounded(stiffness: csr_matrix) -> csr_matrix:
    """A stiffness matrix (n, n) with its first vertex grounded, which makes it regular."""
    to_ground = csr_matrix(([stiffness[0, 0]], ([0], [0])), shape=stiffness.shape)
    return csr_matrix(stiffness + to_ground)


def block_cg(
    stiffness: csr_matrix,
    precondition: Preconditioner,
    currents: Floats,
    tolerance: float,
    most: int,
) -> Floats:
    """Preconditioned conjugate gradients for several right-hand sides (n, c) simultaneously.

    A product with all columns together costs a fraction of that with each. Iterations end when all
    residuals are below the tolerance, relative to the right-hand side, or after `most` of them.
    """
    potential = np.zeros_like(currents)
    residual = currents.copy()
    target = tolerance * np.linalg.norm(currents, axis=0)
    direction, previous = np.zeros_like(residual), np.ones(currents.shape[1])
    for _ in range(most):
        if (np.linalg.norm(residual, axis=0) <= target).all():
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
    """V-cycle of smoothed aggregation on columns (n, c), with two ℓ₁-Jacobi sweeps a side.

    The smoother converges for every symmetric positive definite matrix (Baker, Falgout, Kolev and
    Yang, SIAM J. Sci. Comput. 33, 2011, 2864-2887). Single precision is enough for a preconditioner
    and halves the memory traffic.
    """
    hierarchy = smoothed_aggregation(stiffness)
    levels = [
        tuple(csr_matrix(matrix).astype(np.float32) for matrix in (a.A, a.P, a.R))
        for a in hierarchy.levels[:-1]
    ]
    inverse = [1 / np.asarray(abs(matrix).sum(axis=1)) for matrix, _, _ in levels]
    # the coarsest level has some tens of unknowns
    coarsest = np.linalg.inv(hierarchy.levels[-1].A.toarray()).astype(np.float32)

    def cycle(depth: int, residual: Floats) -> Floats:
        if depth == len(levels):
            return np.asarray(coarsest @ residual)
        matrix, prolong, restrict = levels[depth]
        correction = inverse[depth] * residual
        correction += inverse[depth] * (residual - matrix @ correction)
        correction += prolong @ cycle(depth + 1, restrict @ (residual - matrix @ correction))
        for _ in range(2):
            correction += inverse[depth] * (residual - matrix @ correction)
        return np.asarray(correction)

    return lambda residual: cycle(0, residual.astype(np.float32))


def outer_boundary(vertices: Floats, tetrahedra: Integers) -> Integers:
    """Triangles of the boundary, without those of holes inside."""
    triangles, _ = boundary_triangles(tetrahedra)
    count, piece = igl.facet_components(triangles)
    corners = vertices[triangles]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return np.asarray(triangles[piece == np.argmax(np.abs(np.bincount(piece, volume, count)))])
