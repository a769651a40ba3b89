"""Building the response of a heart's lead fields to the body: solves, modes, what is interpolated.

See `fascicle.torso.variation.response` for what comes out, and why.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.linalg

from fascicle.core.arrays import Floats, Integers, Singles
from fascicle.core.progress import StageProgress, no_progress
from fascicle.core.threads import one_thread
from fascicle.heart.heart import TorsoTissue
from fascicle.torso.electrode_sites import Electrode
from fascicle.torso.lead_fields import Contacts, grounded
from fascicle.torso.variation.conductor import BodyState, Conductor
from fascicle.torso.variation.exterior import Exterior, Part, block_cg, multigrid, near_field
from fascicle.torso.variation.response import (
    LEFT,
    LOG_FACTOR,
    REACH,
    UP,
    BodyResponse,
    electrode_places,
    exterior_inputs,
)

T = TypeVar("T")


@dataclass(frozen=True)
class Effort:
    """How closely a response follows the body.

    Bodies solved for all electrodes, modes kept of their fields, bodies between which the outside
    is interpolated, and functions kept of the places on the skin.
    """

    mode_bodies: int = 30
    modes: int = 64
    outer_bodies: int = 240
    patterns: int = 50


def random_bodies(conductor: Conductor, count: int, rng: np.random.Generator) -> list[BodyState]:
    """Possible bodies of a conductor spread over the whole range: a Latin hypercube."""
    from scipy.stats import qmc  # takes long to load

    bodies: list[BodyState] = []
    while len(bodies) < count:
        for point in 2 * qmc.LatinHypercube(24, rng=rng).random(count) - 1:
            geometry = [0, 0, 0, 0, 0, 0, 1] + REACH * point[:7]
            factors = np.exp(LOG_FACTOR * point[7:11])
            # mm: each electrode alone, and all of the chest together upwards
            chest = np.stack([25.0 * point[11:17], 25.0 * point[17:23]], axis=1)
            chest[:, 1] += 40.0 * point[23]
            state = BodyState(geometry, factors[:3] / factors[3], chest)
            if conductor.is_possible(state):
                bodies.append(state)
    return bodies[:count]


def build_response(
    conductor: Conductor,
    rng: np.random.Generator,
    progress: StageProgress = no_progress,
    effort: Effort | None = None,
) -> BodyResponse:
    """Learn how the lead fields of a conductor depend on the body.

    `progress` is called with how many of how many steps are done; the random bodies are the same
    for a generator of the same seed.
    """
    effort = effort if effort is not None else Effort()
    heart, torso = conductor.heart, conductor.torso
    places = electrode_places(torso.vertices, conductor.skin, heart.electrodes, conductor.axes)
    total = effort.mode_bodies + effort.outer_bodies

    def solve(body: BodyState) -> Floats:
        return solve_body(conductor, body, currents(places, body, len(torso.vertices)))

    bodies = random_bodies(conductor, effort.mode_bodies, rng)
    fields = _in_parallel(solve, bodies, lambda done: progress(done, total))
    modes = hull_modes(conductor, np.concatenate(fields, axis=1), effort.modes)
    on_surface = modes[conductor.hull_surface]
    exterior, near = Exterior(conductor, on_surface, places), near_field(conductor, on_surface)
    points = np.einsum("ec,eci->ei", places.weights, torso.vertices[places.triangles])
    upper = np.triu_indices(modes.shape[1])

    def outside(body: BodyState) -> tuple[Singles, Singles]:
        """Upper triangle of A, and what f has beyond the near field at the places."""
        energy, driven = exterior(body)
        beyond = driven - near(conductor.motion(body)(points), energy)
        return energy[upper].astype(np.float32), beyond.astype(np.float32)

    bodies = random_bodies(conductor, effort.outer_bodies, rng)
    found = _in_parallel(outside, bodies, lambda done: progress(effort.mode_bodies + done, total))
    outer, remainders = (np.array(of_bodies) for of_bodies in zip(*found, strict=True))
    patterns = place_patterns(remainders, effort.patterns)
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
def _in_parallel(
    work: Callable[[BodyState], T], bodies: Sequence[BodyState], progress: Callable[[int], None]
) -> list[T]:
    """What comes out for each body; `progress` is called with how many are done."""
    found = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for result in pool.map(work, bodies):
            found.append(result)
            progress(len(found))
    return found


def currents(places: Contacts, body: BodyState, vertices: int) -> Floats:
    """Unit current into each electrode at the place nearest to a body's, (n, 9)."""
    chosen = list(range(Electrode.V1))
    for k, (left, up) in enumerate(body.chest / body.geometry[6]):
        i, j = np.argmin(np.abs(LEFT - left)), np.argmin(np.abs(UP - up))
        chosen.append(Electrode.V1 + int((k * len(LEFT) + i) * len(UP) + j))
    contacts = Contacts(places.triangles[chosen], places.weights[chosen], places.moved[chosen])
    return np.ascontiguousarray(contacts.currents(vertices).T)


def solve_body(
    conductor: Conductor, body: BodyState, loads: Floats, tolerance: float = 3e-3, most: int = 40
) -> Floats:
    """Potentials (n, c) of currents (n, c) in one body, as closely as modes need them."""
    stiffness = grounded(conductor.stiffness(body))
    found = block_cg(stiffness, multigrid(stiffness), loads, tolerance, most)
    return np.asarray(found - found.mean(axis=0))


def hull_modes(conductor: Conductor, fields: Floats, count: int) -> Floats:
    """Modes (n, k) that hold most of fields (n, f) in the hull, orthonormal in its energy.

    By proper orthogonal decomposition; 0 outside the hull.
    """
    part = Part.of(conductor, conductor.in_hull)
    sigma = np.concatenate([conductor.of_heart, conductor.around[conductor.inside]])
    energy = part.stiffness(sigma)
    within = fields[part.used]
    within = within / np.sqrt(np.einsum("nf,nf->f", within, energy @ within))
    values, vectors = np.linalg.eigh(within.T @ (energy @ within))
    kept = np.argsort(values)[::-1][: min(count, len(values))]
    modes = np.zeros((len(fields), len(kept)))
    modes[part.used] = within @ (vectors[:, kept] / np.sqrt(values[kept]))
    return modes


def inner_energies(conductor: Conductor, modes: Floats) -> Floats:
    """Energies (4, k, k) of modes in the hull's myocardium, body, lung and blood."""
    parts = [(conductor.heart.tetrahedra, conductor.of_heart)]
    for tissue in TorsoTissue:
        chosen = conductor.inside & (conductor.torso.tissues == tissue)
        parts.append((conductor.torso.tetrahedra[chosen], conductor.around[chosen]))
    found = np.zeros((len(parts), modes.shape[1], modes.shape[1]))
    for k, (tetrahedra, sigma) in enumerate(parts):
        if len(tetrahedra):
            part = Part.of(conductor, tetrahedra)
            within = modes[part.used]
            found[k] = within.T @ (part.stiffness(sigma) @ within)
    return found


def place_patterns(remainders: Singles, count: int) -> Floats:
    """Functions (p, q) of places that hold most of fields (b, p, k): principal components.

    Each limb electrode has one of its own: there are many more places of the chest's.
    """
    chest = np.concatenate(list(remainders[:, Electrode.V1 :]), axis=1)
    _, vectors = np.linalg.eigh(chest @ chest.T)
    limbs = np.eye(Electrode.V1)
    return np.asarray(scipy.linalg.block_diag(limbs, vectors[:, ::-1][:, :count]))


def _critical(conductor: Conductor, bodies: Sequence[BodyState]) -> Integers:
    """The eight tetrahedra that are compressed most in each body."""
    determinants = [conductor.morph.determinants(conductor.motion(body)) for body in bodies]
    return np.unique([np.argsort(of_body)[:8] for of_body in determinants])
