"""Building the response of a heart's lead fields to the torso: solves, modes, interpolation.

A potential B on the surface of the hull of heart and blood sets up a potential E(torso) outside,
insulated at the skin. The tissue outside adds the energy of E to that of the hull, and E at an
electrode is, by reciprocity, the current that a unit current into that electrode drives into the
hull. It has no other effect on the potential in the hull: static condensation (Huynh, Knezevic and
Patera, ESAIM: Math. Model. Numer. Anal. 47, 2013, 213-251).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np
import scipy.linalg
from scipy.sparse import csr_matrix

from fascicle.core.arrays import Booleans, Floats, Integers, Singles
from fascicle.core.parameters import ParameterSpace, free
from fascicle.core.progress import Progress, StageProgress, no_progress, stage_progress
from fascicle.core.quantities import TORSO_QUANTITIES
from fascicle.core.threads import one_thread
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart, TorsoTissue
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.mesh.topology import without_unused_vertices
from fascicle.torso.conductor import Conductor, TorsoState, build_conductor, torso_of
from fascicle.torso.electrode_sites import Electrode
from fascicle.torso.lead_fields import (
    MM_PER_CM,
    Contacts,
    assemble_stiffness,
    block_cg,
    contacts_on,
    grounded,
    multigrid,
)
from fascicle.torso.response import (
    FIXED,
    LEFT,
    SPACING,
    UPWARD,
    TorsoResponse,
    exterior_inputs,
    near_field,
)

T = TypeVar("T")


def build_response(
    conductor: Conductor,
    rng: np.random.Generator,
    progress: StageProgress = no_progress,
    *,
    mode_torsos: int = 30,
    modes: int = 64,
    outer_torsos: int = 240,
    patterns: int = 50,
) -> TorsoResponse:
    """Learn how the lead fields of a conductor depend on the torso, from torsos drawn by `rng`.

    `mode_torsos` are solved for all electrodes, and `modes` of their fields are kept; the outside
    is interpolated between `outer_torsos`; `patterns` functions of the places on the skin are kept.
    """
    heart, total = conductor.heart, mode_torsos + outer_torsos
    places = electrode_places(conductor)
    points = places.points(conductor.torso.vertices)
    fields = _in_parallel(
        lambda state: solve_torso(conductor, places, state),
        random_torsos(conductor, mode_torsos, rng),
        lambda done: progress(done, total),
    )
    basis = hull_modes(conductor, np.concatenate(fields, axis=1), modes)
    on_surface = basis[conductor.hull_surface]
    solve_outside = exterior(conductor, on_surface, places)
    hull, projection, filled = plain_hull(conductor, on_surface)
    upper = np.triu_indices(len(filled))

    def outside(state: TorsoState) -> tuple[Singles, Singles]:
        """Upper triangle of A, and the remainder of f beyond the near field at the places."""
        energy, driven = solve_outside(state)
        moved = conductor.motion(state)(points)
        beyond = driven - near_field(moved, hull, projection, energy + filled)
        return energy[upper].astype(np.float32), beyond.astype(np.float32)

    states = random_torsos(conductor, outer_torsos, rng)
    responses = _in_parallel(outside, states, lambda done: progress(mode_torsos + done, total))
    outer, remainders = (np.array(of_states) for of_states in zip(*responses, strict=True))
    functions = _place_patterns(remainders, patterns)
    # the eight tetrahedra that are compressed most in each torso
    determinants = [conductor.morph.determinants(conductor.motion(state)) for state in states]
    critical = conductor.morph.at(np.unique([np.argsort(factors)[:8] for factors in determinants]))
    return TorsoResponse(
        basis[: len(heart.vertices)].T.copy(), inner_energies(conductor, basis),
        np.array([exterior_inputs(state) for state in states]), outer,
        points, functions, (functions.T @ remainders).astype(np.float32),
        hull, projection, filled, critical.centres, critical.share, critical.slope,
        conductor.centroid, conductor.axes,
    )  # fmt: skip


@one_thread  # a torso on each core: threads of threads wait for each other
def _in_parallel(
    work: Callable[[TorsoState], T], states: Sequence[TorsoState], progress: Callable[[int], None]
) -> list[T]:
    """Do work for each state, in parallel; `progress` is called with the number done."""
    outcomes = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for outcome in pool.map(work, states):
            outcomes.append(outcome)
            progress(len(outcomes))
    return outcomes


def random_torsos(conductor: Conductor, count: int, rng: np.random.Generator) -> list[TorsoState]:
    """Latin hypercube of possible states of a conductor, over the range of the response."""
    from scipy.stats import qmc  # takes long to load

    states: list[TorsoState] = []
    while len(states) < count:
        for point in 2 * qmc.LatinHypercube(24, rng=rng).random(count) - 1:
            geometry = [0, 0, 0, 0, 0, 0, 1] + TorsoState.reach * point[:7]
            factors = np.exp(TorsoState.log_factor * point[7:11])
            # mm: each electrode alone, and all of the chest together upwards
            chest = np.stack([25.0 * point[11:17], 25.0 * point[17:23]], axis=1)
            chest[:, 1] += 40.0 * point[23]
            state = TorsoState(geometry, factors[:3] / factors[3], chest)
            if conductor.is_possible(state):
                states.append(state)
    return states[:count]


def torsos_of_the_prior(
    rng: np.random.Generator,
    count: int,
    is_possible: Callable[[TorsoState], bool] = lambda state: True,
) -> list[TorsoState]:
    """Possible torsos whose quantities are drawn from their priors (docs/quantities.md)."""
    space = ParameterSpace(tuple(free(name) for name in TORSO_QUANTITIES))
    states: list[TorsoState] = []
    while len(states) < count:
        state = TorsoState.of(space.from_unit(rng.random(len(space))))
        if is_possible(state):
            states.append(state)
    return states


def lead_fields_in_torsos(
    heart: Heart,
    conduction: Conduction,
    rng: np.random.Generator,
    count: int,
    progress: Progress | None = None,
) -> Floats:
    """Lead fields (1 + count, 9 + a, n) (kΩ) of a heart in its torso, then in random ones.

    The random ones are `torsos_of_the_prior`. Fields are over the factor on the myocardium's
    conductivity, by which sources are multiplied.
    """
    torso = torso_of(heart, stage_progress(progress, "torso"))
    conductor = build_conductor(heart, torso, conduction)
    places = electrode_places(conductor)
    states = [TorsoState.of({}), *torsos_of_the_prior(rng, count, conductor.is_possible)]
    report, vertices = stage_progress(progress, "lead fields in torsos"), len(heart.vertices)
    fields = _in_parallel(
        lambda state: solve_torso(conductor, places, state, 1e-3, 80)[:vertices].T,
        states,
        lambda done: report(done, len(states)),
    )
    return np.array(fields)


def electrode_places(conductor: Conductor) -> Contacts:
    """Contacts of the limb electrodes, then of V1 to V6 at every place of a grid along the skin.

    Contacts of the additional electrodes, which do not move along the skin, come last.

    From its position an electrode goes up or down along the skin first, then horizontally. Limb and
    chest electrodes have 3 + 6 · len(LEFT) · len(UPWARD) places: by electrode, leftwards, then up.
    """
    vertices, skin = conductor.torso.vertices, conductor.skin
    to_left, _, upwards = conductor.axes
    vertex_normals = np.zeros_like(vertices)  # weighted by areas
    for corner in skin.T:
        np.add.at(vertex_normals, corner, triangle_normals(vertices, skin))

    def line(start: Floats, direction: Floats, places: Floats) -> Floats:
        """Points (places, n, 3) at distances (mm) along the skin from the start (n, 3)."""
        origin = int(np.argmin(np.abs(places)))
        reached = {origin: contacts_on(vertices, skin, start).points(vertices)}
        for sign, last in ((1, len(places)), (-1, -1)):
            for k in range(origin + sign, last, sign):
                point = reached[k - sign]
                for _ in range(3):  # steps between two places, back onto the skin after every step
                    contacts = contacts_on(vertices, skin, point)
                    normal = unit(contacts.points(vertex_normals))
                    along = sign * direction - (normal @ (sign * direction))[:, None] * normal
                    step = contacts.points(vertices) + SPACING / 3 * unit(along)
                    point = contacts_on(vertices, skin, step).points(vertices)
                reached[k] = point
        return np.array([reached[k] for k in range(len(places))])

    limbs, chest = np.split(conductor.heart.electrodes, [Electrode.V1])
    rows = line(chest, upwards, UPWARD)  # (up, 6, 3)
    grid = line(rows.reshape(-1, 3), to_left, LEFT).reshape(len(LEFT), len(UPWARD), len(chest), 3)
    more = conductor.heart.electrode_positions[len(conductor.heart.electrodes) :]
    places = np.concatenate([limbs, grid.transpose(2, 0, 1, 3).reshape(-1, 3), more])
    return contacts_on(vertices, skin, places)


def currents(places: Contacts, state: TorsoState, vertices: int) -> Floats:
    """Unit current into each electrode at the place nearest to a state's, (n, 9 + a)."""
    chosen = list(range(Electrode.V1))
    for k, (left, up) in enumerate(state.chest / state.geometry[6]):
        i, j = np.argmin(np.abs(LEFT - left)), np.argmin(np.abs(UPWARD - up))
        chosen.append(Electrode.V1 + int((k * len(LEFT) + i) * len(UPWARD) + j))
    chosen += range(FIXED, len(places.moved))
    contacts = Contacts(places.triangles[chosen], places.weights[chosen], places.moved[chosen])
    return np.ascontiguousarray(contacts.currents(vertices).T)


def solve_torso(
    conductor: Conductor,
    places: Contacts,
    state: TorsoState,
    tolerance: float = 3e-3,
    most: int = 40,
) -> Floats:
    """Potentials (n, 9 + a) of the electrodes in one torso, as closely as modes need them."""
    loads = currents(places, state, len(conductor.torso.vertices))
    stiffness = grounded(conductor.stiffness(state))
    potentials = block_cg(stiffness, multigrid(stiffness), loads, tolerance, most)
    return np.asarray(potentials - potentials.mean(axis=0))


class Part(NamedTuple):
    """Some tetrahedra of a conductor, with their own numbering of vertices.

    Numbers (n,) in the whole mesh of the vertices used, their points (n, 3) (mm), the corners (m,
    4) of the tetrahedra, and whether vertices lie on the hull's surface (n,).
    """

    used: Integers
    points: Floats
    corners: Integers
    on_surface: Booleans

    @classmethod
    def of(cls, conductor: Conductor, tetrahedra: Integers) -> Part:
        """Make a part of tetrahedra numbered in the whole mesh."""
        used = np.unique(tetrahedra)
        points, corners = without_unused_vertices(conductor.torso.vertices, tetrahedra)
        return cls(used, points, corners, np.isin(used, conductor.hull_surface))

    def stiffness(self, conductivity: Floats) -> csr_matrix:
        """Conductances (n, n) (1/kΩ) for σ (m, 3, 3)."""
        return assemble_stiffness(self.points, self.corners, conductivity)

    def extended(
        self, conductivity: Floats, values: Floats, tolerance: float, most: int
    ) -> tuple[csr_matrix, Floats]:
        """Stiffness, and the harmonic extension (n, k) of values (s, k) on the surface."""
        stiffness, free = self.stiffness(conductivity), ~self.on_surface
        inner = stiffness[free]
        load = -(inner[:, self.on_surface] @ values)
        matrix = inner[:, free].tocsr()
        extension = np.empty((len(self.points), values.shape[1]))
        extension[self.on_surface] = values
        extension[free] = block_cg(matrix, multigrid(matrix), load, tolerance, most)
        return stiffness, extension


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
    """Energies (4, k, k) of modes in the hull's myocardium, then in each `TorsoTissue`."""
    parts = [(conductor.heart.tetrahedra, conductor.of_heart)]
    for tissue in TorsoTissue:
        chosen = conductor.inside & (conductor.torso.tissues == tissue)
        parts.append((conductor.torso.tetrahedra[chosen], conductor.around[chosen]))
    energies = np.zeros((len(parts), modes.shape[1], modes.shape[1]))
    for k, (tetrahedra, sigma) in enumerate(parts):
        if len(tetrahedra):
            part = Part.of(conductor, tetrahedra)
            within = modes[part.used]
            energies[k] = within.T @ (part.stiffness(sigma) @ within)
    return energies


def exterior(
    conductor: Conductor, values: Floats, contacts: Contacts, tolerance: float = 3e-4
) -> Callable[[TorsoState], tuple[Floats, Floats]]:
    """Solver of the outside of the hull for potentials B (s, k) on its surface, by state.

    It returns the energy of E (k, k) and E at the contacts (p, k), for a factor of 1 on plain
    tissue's conductivity; the lungs' factor counts relative to it. `tolerance` is relative.
    """
    part = Part.of(conductor, conductor.torso.tetrahedra[~conductor.inside])
    columns = np.searchsorted(part.used, contacts.triangles)
    rows = np.repeat(np.arange(len(columns)), 3)
    at_contacts = csr_matrix(
        (contacts.weights.ravel(), (rows, columns.ravel())), shape=(len(columns), len(part.used))
    )

    def solve(state: TorsoState) -> tuple[Floats, Floats]:
        sigma = conductor.moved(state, ~conductor.inside) / state.ratios[0]
        stiffness, extension = part.extended(sigma, values, tolerance, 60)
        return extension.T @ (stiffness @ extension), at_contacts @ extension

    return solve


def plain_hull(conductor: Conductor, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Points (s, 3) (mm) and `near_field`'s projection (s, k) for B (s, k) on the hull's surface.

    Also returns the energy (k, k) of B in a hull of plain tissue (1/kΩ).
    """
    part = Part.of(conductor, conductor.in_hull)
    isotropic = conductor.around[conductor.torso.tissues == TorsoTissue.OTHER][0]
    sigma = np.broadcast_to(isotropic, (len(part.corners), 3, 3))
    stiffness, extension = part.extended(sigma, values, 1e-6, 500)
    flux = stiffness[part.on_surface] @ extension
    filled = values.T @ flux
    filled = (filled + filled.T) / 2
    amplitude = MM_PER_CM / (2 * np.pi * isotropic[0, 0])
    projection = amplitude * np.linalg.solve(filled, flux.T).T
    return part.points[part.on_surface], projection, filled


def _place_patterns(remainders: Singles, count: int) -> Floats:
    """Principal components (p, q), functions of places that hold most of fields (b, p, k).

    Limb and additional electrodes have a function each, as the chest has many more places.
    """
    chest = np.concatenate(list(remainders[:, Electrode.V1 : FIXED]), axis=1)
    _, vectors = np.linalg.eigh(chest @ chest.T)
    limbs, more = np.eye(Electrode.V1), np.eye(remainders.shape[1] - FIXED)
    return np.asarray(scipy.linalg.block_diag(limbs, vectors[:, ::-1][:, :count], more))
