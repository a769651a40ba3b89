"""Building the response of a heart's lead fields to the body: solves, modes, what is interpolated.

See `fascicle.torso.variation.response` for what comes out, and why.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.stats import qmc

from fascicle.core.arrays import Floats, Integers
from fascicle.core.progress import StageProgress, no_progress
from fascicle.core.threads import one_thread
from fascicle.torso.electrode_sites import V1
from fascicle.torso.lead_fields import Contacts, assemble_stiffness, grounded
from fascicle.torso.variation.block_solver import block_cg, multigrid
from fascicle.torso.variation.conductor import TISSUES, BodyState, Conductor
from fascicle.torso.variation.electrode_paths import LEFT, UP, electrode_places
from fascicle.torso.variation.exterior import Exterior, NearField, Part, near_field
from fascicle.torso.variation.response import (
    LOG_FACTOR,
    SHIFT,
    SIZE,
    TURN,
    BodyResponse,
    exterior_inputs,
)

LEFT_REACH, UP_REACH, TOGETHER_REACH = 25.0, 25.0, 40.0  # mm, of what modes are taken from
MODE_BODIES, MODES = 30, 64  # solved for all electrodes; kept of their fields
OUTER_BODIES = 240  # between which the outside is interpolated
PATTERNS = 50  # of places on the skin
CRITICAL = 8  # tetrahedra of each body that are watched for the heart nearing the skin
TOLERANCE, MOST_ITERATIONS = 3e-3, 40  # of a field that modes are taken from


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
    heart, torso = conductor.heart, conductor.torso
    places = electrode_places(torso.vertices, conductor.skin, heart.electrodes, conductor.axes)
    total = MODE_BODIES + OUTER_BODIES
    fields = _fields(conductor, places, rng, lambda done: progress(done, total))
    modes = hull_modes(conductor, fields)
    surface = np.intersect1d(conductor.in_hull, torso.tetrahedra[~conductor.inside])
    exterior = Exterior(conductor, surface, modes[surface], places)
    near = near_field(conductor, surface, modes[surface])
    points = np.einsum("ec,eci->ei", places.weights, torso.vertices[places.triangles])
    bodies = random_bodies(conductor, OUTER_BODIES, rng)
    outer, remainders = _outside(
        exterior, near, bodies, points, lambda done: progress(MODE_BODIES + done, total)
    )
    patterns = place_patterns(remainders)
    critical = conductor.morph.of(_critical(conductor, bodies))
    return BodyResponse(
        modes[: len(heart.vertices)].T.copy(), inner_energies(conductor, modes),
        np.array([exterior_inputs(body) for body in bodies]), outer,
        points, patterns, (patterns.T @ remainders).astype(np.float32),
        near.points, near.projection, near.filled,
        critical.centres, critical.share, critical.slope,
        conductor.centroid, conductor.axes,
    )  # fmt: skip


@one_thread  # a body on each core: threads of threads wait for each other
def _fields(
    conductor: Conductor,
    places: Contacts,
    rng: np.random.Generator,
    progress: Callable[[int], None],
) -> Floats:
    """Lead fields (n, 9·b) of random bodies."""
    vertices = len(conductor.torso.vertices)

    def solve(body: BodyState) -> Floats:
        return solve_body(conductor, body, currents(places, body, vertices))

    found = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for field in pool.map(solve, random_bodies(conductor, MODE_BODIES, rng)):
            found.append(field)
            progress(len(found))
    return np.concatenate(found, axis=1)


@one_thread
def _outside(
    exterior: Exterior,
    near: NearField,
    bodies: Sequence[BodyState],
    points: Floats,
    progress: Callable[[int], None],
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Upper triangles of A (b, k(k+1)/2), and what f at points (p, 3) has beyond the near field."""
    size = exterior.values.shape[1]
    upper = np.triu_indices(size)
    outer = np.empty((len(bodies), len(upper[0])), dtype=np.float32)
    remainders = np.empty((len(bodies), len(points), size), dtype=np.float32)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, (energy, driven) in enumerate(pool.map(exterior, bodies)):
            at = exterior.conductor.motion(bodies[k]).of_skin(points)
            outer[k], remainders[k] = energy[upper], driven - near(at, energy)
            progress(k + 1)
    return outer, remainders


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
    """Potentials (n, c) of currents (n, c) in one body."""
    stiffness = grounded(conductor.stiffness(body))
    found = block_cg(stiffness, multigrid(stiffness), loads, np.zeros_like(loads), tolerance, most)
    return np.asarray(found - found.mean(axis=0))


def hull_modes(conductor: Conductor, fields: Floats) -> Floats:
    """Modes (n, k) that hold most of fields (n, f) in the hull, orthonormal in its energy.

    By proper orthogonal decomposition; 0 outside the hull.
    """
    part = Part.of(conductor.torso.vertices, conductor.in_hull)
    sigma = np.concatenate([conductor.of_heart, conductor.around[conductor.inside]])
    energy = assemble_stiffness(part.points, part.corners, sigma)
    within = fields[part.used]
    within = within / np.sqrt(np.einsum("nf,nf->f", within, energy @ within))
    values, vectors = np.linalg.eigh(within.T @ (energy @ within))
    kept = np.argsort(values)[::-1][: min(MODES, len(values))]
    modes = np.zeros((len(fields), len(kept)))
    modes[part.used] = within @ (vectors[:, kept] / np.sqrt(values[kept]))
    return modes


def inner_energies(conductor: Conductor, modes: Floats) -> Floats:
    """Energies (4, k, k) of modes in the hull's myocardium, body, lung and blood."""
    torso = conductor.torso
    found = np.zeros((1 + len(TISSUES), modes.shape[1], modes.shape[1]))
    parts = [(conductor.heart.tetrahedra, conductor.of_heart)]
    for tissue in TISSUES:
        chosen = conductor.inside & (torso.tissues == tissue)
        parts.append((torso.tetrahedra[chosen], conductor.around[chosen]))
    for k, (tetrahedra, sigma) in enumerate(parts):
        if len(tetrahedra):
            part = Part.of(torso.vertices, tetrahedra)
            within = modes[part.used]
            stiffness = assemble_stiffness(part.points, part.corners, sigma)
            found[k] = within.T @ (stiffness @ within)
    return found


def place_patterns(remainders: NDArray[np.float32]) -> Floats:
    """Functions (p, q) of places that hold most of fields (b, p, k): principal components.

    Each limb electrode has one of its own: there are many more places of the chest's.
    """
    chest = np.concatenate(list(remainders[:, V1:]), axis=1)
    _, vectors = np.linalg.eigh(chest @ chest.T)
    return np.asarray(scipy.linalg.block_diag(np.eye(V1), vectors[:, ::-1][:, :PATTERNS]))


def _critical(conductor: Conductor, bodies: Sequence[BodyState]) -> Integers:
    """Tetrahedra that are compressed most in some body."""
    found: set[int] = set()
    for body in bodies:
        determinants = conductor.morph.determinants(conductor.motion(body))
        found.update(np.argsort(determinants)[:CRITICAL].tolist())
    return np.array(sorted(found))
