"""Building the response of a heart's lead fields to the body: solves, bases, reduced matrices.

See `fascicle.torso.variation.response` for what comes out, and why.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.linalg import qr
from scipy.linalg.lapack import dtrttf
from scipy.sparse import csr_matrix
from scipy.stats import qmc

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import ELECTRODES
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.torso import TorsoTissue
from fascicle.mesh.measures import barycentric_gradients, signed_volumes
from fascicle.torso.electrode_sites import V1
from fascicle.torso.lead_fields import MM_PER_CM, Contacts, assemble_stiffness, earthed
from fascicle.torso.variation.block_solver import block_cg, multigrid
from fascicle.torso.variation.body_axes import Motion
from fascicle.torso.variation.conductor import BodyState, Conductor
from fascicle.torso.variation.electrode_paths import LEFT, UP, electrode_places
from fascicle.torso.variation.morph import symmetric
from fascicle.torso.variation.response import BodyResponse

# Ends of what is trained: displacement (mm), rotation (rad), size, log of conductivities' factors
SHIFT, TURN, SIZE, LOG_FACTOR = 20.0, np.radians(20.0), 0.15, np.log(2.0)
LEFT_REACH, UP_REACH, TOGETHER_REACH = 25.0, 25.0, 40.0  # mm

ELECTRODE_BODIES, MODE_BODIES = 28, 44  # solved for electrodes and for modes
LOADS = 12  # random combinations of modes solved in a body
MODES, BASIS = 64, 320
ELECTRODE_WEIGHT = 0.1  # of fields of electrodes in the choice of the basis
TENSOR_BODIES, TENSOR_MODES, SAMPLED = 160, 32, 120
TENSOR_SUBSET = 6000  # tetrahedra that decide on the tensor modes
CRITICAL = 20  # tetrahedra of each body that are watched for the heart nearing the skin
TOLERANCE, MOST_ITERATIONS = 3e-3, 40  # of a snapshot: a direction of the basis, no result


def neutral() -> BodyState:
    """The body as it is."""
    return BodyState(np.array([0.0] * 6 + [1.0]), np.ones(3), np.zeros((6, 2)))


def random_bodies(conductor: Conductor, count: int, rng: np.random.Generator) -> list[BodyState]:
    """Possible bodies spread over the whole range: a Latin hypercube.

    Parameters
    ----------
    conductor : Conductor
        Says which bodies are possible.
    count : int
        How many of them.
    rng : numpy.random.Generator
        Source of randomness.
    """
    bodies: list[BodyState] = []
    while len(bodies) < count:
        unit = 2 * qmc.LatinHypercube(24, rng=rng).random(count) - 1
        for point in unit:
            geometry = np.concatenate([SHIFT * point[:3], TURN * point[3:6], 1 + SIZE * point[6:7]])
            factors = np.exp(LOG_FACTOR * point[7:11])
            chest = np.stack([LEFT_REACH * point[11:17], UP_REACH * point[17:23]], axis=1)
            chest[:, 1] += TOGETHER_REACH * point[23]
            state = BodyState(geometry, factors[:3] / factors[3], chest)
            if conductor.is_possible(state):
                bodies.append(state)
    return bodies[:count]


def build_response(
    conductor: Conductor, rng: np.random.Generator, progress: StageProgress = no_progress
) -> BodyResponse:
    """Learn how the lead fields depend on the body.

    Parameters
    ----------
    conductor : Conductor
        Heart, torso and electrodes.
    rng : numpy.random.Generator
        Which bodies are solved.
    progress : callable, optional
        Called with how many of how many steps are done.

    Returns
    -------
    BodyResponse
    """
    total = ELECTRODE_BODIES + MODE_BODIES + TENSOR_MODES
    places = electrode_places(
        conductor.torso.vertices, conductor.skin, conductor.heart.electrodes, conductor.axes
    )
    bodies = random_bodies(conductor, ELECTRODE_BODIES + MODE_BODIES, rng)
    energy = conductor.stiffness(neutral())
    snapshots: list[Floats] = []
    for body in bodies[:ELECTRODE_BODIES]:
        snapshots.append(
            solve_body(conductor, body, currents(places, body, len(energy.indptr) - 1))
        )
        progress(len(snapshots), total)
    modes, loads, weight = heart_modes(conductor, np.concatenate(snapshots, axis=1))
    for body in bodies[ELECTRODE_BODIES:]:
        mixture = rng.normal(size=(len(weight), LOADS)) * weight[:, None]
        snapshots.append(solve_body(conductor, body, loads @ mixture))
        progress(len(snapshots), total)
    of_electrodes = np.concatenate(snapshots[:ELECTRODE_BODIES], axis=1)
    of_modes = np.concatenate(snapshots[ELECTRODE_BODIES:], axis=1)
    basis = reduced_basis(of_electrodes, of_modes, energy)
    return _assembled(
        conductor, places, basis, modes, loads, rng, lambda k: progress(len(snapshots) + k, total)
    )


def currents(places: Contacts, body: BodyState, vertices: int) -> Floats:
    """Unit current into each electrode at the place nearest to a body's, (n, 9)."""
    chosen = list(range(V1))
    for k, (left, up) in enumerate(body.chest / body.geometry[6]):
        i, j = np.argmin(np.abs(LEFT - left)), np.argmin(np.abs(UP - up))
        chosen.append(V1 + int((k * len(LEFT) + i) * len(UP) + j))
    contacts = Contacts(places.triangles[chosen], places.weights[chosen], places.moved[chosen])
    return np.ascontiguousarray(contacts.currents(vertices).T)


def solve_body(
    conductor: Conductor,
    body: BodyState,
    loads: Floats,
    tolerance: float = TOLERANCE,
    most: int = MOST_ITERATIONS,
) -> Floats:
    """Potentials (n, c) of currents (n, c) in one body, as many threads as there are cores."""
    stiffness = earthed(conductor.stiffness(body))
    cycle = multigrid(stiffness)

    def solve(part: Floats) -> Floats:
        return block_cg(stiffness, cycle, part, np.zeros_like(part), tolerance, most)

    parts = np.array_split(loads, os.cpu_count() or 1, axis=1)
    with ThreadPoolExecutor(len(parts)) as pool:
        found = np.concatenate(list(pool.map(solve, map(np.ascontiguousarray, parts))), axis=1)
    return np.asarray(found - found.mean(axis=0))


def heart_modes(conductor: Conductor, fields: Floats) -> tuple[Floats, Floats, Floats]:
    """Modes that span lead fields in the heart, by proper orthogonal decomposition.

    Parameters
    ----------
    conductor : Conductor
        The conductor.
    fields : (n, f) array
        Lead fields at all vertices.

    Returns
    -------
    modes : (k, h) array
        Φ at the heart's vertices.
    loads : (n, k) array
        K_heart Φ, the currents that measure them.
    weights : (k,) array
        Their share in the fields, the first one's 1.
    """
    heart = conductor.heart
    stiffness = assemble_stiffness(
        heart.vertices, heart.tetrahedra, conductor.conductivity[: len(heart.tetrahedra)]
    )
    inside = fields[: len(heart.vertices)]
    inside = inside / np.sqrt(np.einsum("nf,nf->f", inside, stiffness @ inside))
    values, vectors = np.linalg.eigh(inside.T @ (stiffness @ inside))
    kept = np.argsort(values)[::-1][: min(MODES, len(values))]
    values, vectors = values[kept], vectors[:, kept]
    modes = inside @ (vectors / np.sqrt(values))
    loads = np.zeros((len(fields), len(kept)))
    loads[: len(heart.vertices)] = stiffness @ modes
    return modes.T.copy(), loads, np.sqrt(values / values[0])


def reduced_basis(of_electrodes: Floats, of_modes: Floats, energy: csr_matrix) -> Floats:
    """The directions (n, b), orthonormal in an energy, that hold most of the snapshots (n, s)."""

    def alike(fields: Floats) -> Floats:
        return np.asarray(fields / np.sqrt(np.einsum("ns,ns->s", fields, energy @ fields)))

    # most of an electrode's energy lies at the electrode, where no mode's potential needs it
    scaled = np.concatenate([ELECTRODE_WEIGHT * alike(of_electrodes), alike(of_modes)], axis=1)
    values, vectors = np.linalg.eigh(scaled.T @ (energy @ scaled))
    kept = np.argsort(values)[::-1][: min(BASIS, len(values))]
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))


def _assembled(
    conductor: Conductor,
    places: Contacts,
    basis: Floats,
    modes: Floats,
    loads: Floats,
    rng: np.random.Generator,
    progress: Callable[[int], None],
) -> BodyResponse:
    """Everything that the response needs of a basis."""
    heart, torso = conductor.heart, conductor.torso
    tissues, count = torso.tissues, len(heart.tetrahedra)
    sampled, weights, mixing, bodies = tensor_modes(conductor, rng)
    size = basis.shape[1]
    isotropic = conductor.conductivity[count:, 0, 0]
    own = assemble_stiffness(heart.vertices, heart.tetrahedra, conductor.conductivity[:count])
    in_heart = basis[: len(heart.vertices)]
    gradients = _Gradients(torso.vertices, torso.tetrahedra, basis)
    blood = tissues == TorsoTissue.BLOOD
    unit = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    fixed = [
        in_heart.T @ (own @ in_heart),
        gradients.product(np.flatnonzero(blood), isotropic[blood, None] * unit),
    ]
    moving = np.zeros((2, len(mixing), size, size))
    motions = [conductor.motion(body) for body in bodies]
    for row, tissue in enumerate((TorsoTissue.BODY, TorsoTissue.LUNG)):
        for part in _blocks(np.flatnonzero(tissues == tissue)):
            morph = conductor.morph.of(part)
            tensors = np.stack([morph.tensors(motion) for motion in motions]).astype(np.float32)
            gradient = gradients.of(part)
            for k, mix in enumerate(mixing):
                entries = isotropic[part, None] * np.tensordot(mix, tensors, axes=1)
                moving[row, k] += gradients.weighted(gradient, part, entries)
    progress(len(mixing))
    critical = conductor.morph.of(_critical(conductor, motions))
    at = conductor.morph.of(sampled)
    rows = np.einsum("ec,ecb->eb", places.weights, basis[places.triangles])
    return BodyResponse(
        modes, basis.T @ loads,
        np.array([_packed(f) for f in fixed], dtype=np.float32),
        np.array([_packed(m) for m in moving.reshape(-1, size, size)], dtype=np.float32),
        rows[:V1],
        rows[V1:].reshape(len(ELECTRODES) - V1, len(LEFT), len(UP), size),
        weights, at.centres, at.share, at.slope,
        critical.centres, critical.share, critical.slope,
        conductor.centroid, conductor.axes,
    )  # fmt: skip


def tensor_modes(
    conductor: Conductor, rng: np.random.Generator
) -> tuple[Integers, Floats, Floats, list[BodyState]]:
    """Which bodies' tensors, mixed how, span those of all, and where they are told from.

    Parameters
    ----------
    conductor : Conductor
        Heart, torso and electrodes.
    rng : numpy.random.Generator
        Which bodies and tetrahedra are looked at.

    Returns
    -------
    sampled : (s,) array
        Tetrahedra of the torso from whose tensors the coefficients of the modes are told.
    weights : (k, s, 6) array
        Coefficients of the modes for these tensors' entries.
    mixing : (k, b) array
        The modes as combinations of the bodies' tensors.
    bodies : list of BodyState
        b of them.
    """
    moves = np.flatnonzero(
        (conductor.morph.share > 0) & (conductor.torso.tissues != TorsoTissue.BLOOD)
    )
    bodies = random_bodies(conductor, TENSOR_BODIES, rng)
    volumes = signed_volumes(conductor.torso.vertices, conductor.torso.tetrahedra)
    # near the heart, where its currents are, conductivity counts most
    distance = np.linalg.norm(conductor.morph.centres - conductor.centroid, axis=1)
    importance = volumes / (1 + (distance / 60.0) ** 4)
    share = importance[moves] / importance[moves].sum()
    subset = rng.choice(moves, min(TENSOR_SUBSET, len(moves)), replace=False, p=share)
    morph = conductor.morph.of(subset)
    tensors = np.stack([morph.tensors(conductor.motion(body)) for body in bodies])
    flat = tensors.reshape(len(bodies), -1)
    left, values, right = np.linalg.svd(flat, full_matrices=False)
    count = min(TENSOR_MODES, len(values))
    mixing = (left[:, :count] / values[:count]).T
    modes = right[:count]
    _, _, order = qr(modes, mode="economic", pivoting=True)
    chosen = list(dict.fromkeys((order // 6).tolist()))[:SAMPLED]
    at = modes.reshape(count, len(subset), 6)[:, chosen].reshape(count, -1)
    weights = np.linalg.pinv(at.T).reshape(count, len(chosen), 6)
    return subset[chosen], weights, mixing, bodies


class _Gradients:
    """∇V of a basis in tetrahedra, and energies of it."""

    def __init__(self, vertices: Floats, tetrahedra: Integers, basis: Floats) -> None:
        self.tetrahedra, self.basis = tetrahedra, basis
        self.barycentric = barycentric_gradients(vertices, tetrahedra)
        self.volumes = signed_volumes(vertices, tetrahedra) / MM_PER_CM

    def of(self, part: Integers) -> Floats:
        """∇V (3, m, b) (per mm) in some tetrahedra, in single precision."""
        values = self.basis[self.tetrahedra[part]]
        gradient = np.einsum("mki,mkb->imb", self.barycentric[part], values, optimize=True)
        return np.ascontiguousarray(gradient, dtype=np.float32)

    def weighted(self, gradient: Floats, part: Integers, entries: Floats) -> Floats:
        """∫ ∇V·σ∇V over them for σ of these entries (m, 6), in mS/cm; (b, b)."""
        sigma = symmetric(self.volumes[part, None] * entries).astype(np.float32)
        total = np.zeros((gradient.shape[2], gradient.shape[2]))
        for i in range(3):
            flux = sum(sigma[:, i, j, None] * gradient[j] for j in range(3))
            total += gradient[i].T @ flux
        return np.asarray(total)

    def product(self, chosen: Integers, entries: Floats) -> Floats:
        """The same over any number of tetrahedra."""
        size = self.basis.shape[1]
        total = np.zeros((size, size))
        position = 0
        for part in _blocks(chosen):
            total += self.weighted(self.of(part), part, entries[position : position + len(part)])
            position += len(part)
        return total


def _packed(matrix: Floats) -> Floats:
    """A symmetric matrix in rectangular full packed format."""
    packed, failed = dtrttf(matrix)
    assert not failed
    return np.asarray(packed)


def _blocks(chosen: Integers, size: int = 10_000) -> Iterator[Integers]:
    for start in range(0, len(chosen), size):
        yield chosen[start : start + size]


def _critical(conductor: Conductor, motions: Sequence[Motion]) -> Integers:
    """Tetrahedra that are compressed most in some body."""
    found: set[int] = set()
    for motion in motions:
        found.update(
            np.argsort(np.linalg.det(conductor.morph.jacobians(motion)))[:CRITICAL].tolist()
        )
    return np.array(sorted(found))
