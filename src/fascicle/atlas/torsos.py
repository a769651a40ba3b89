"""Hearts of the atlas in their torsos, and their lead fields in random variations of these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fascicle.atlas.population import AtlasHeart
from fascicle.atlas.shapes import HeartFamily
from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace, free
from fascicle.core.quantities import TORSO_QUANTITIES
from fascicle.core.threads import one_thread
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import solid_centroid
from fascicle.torso.conductor import TorsoState, build_conductor, mesh_torso
from fascicle.torso.heart_pose import TorsoFrame, default_position, standard_axes
from fascicle.torso.idealised import idealised_torso
from fascicle.torso.training import electrode_places, solve_torso


def heart_in_torso(family: HeartFamily, described: AtlasHeart, name: str = "atlas") -> Heart:
    """Heart of a family in its torso, with electrodes and without lead fields.

    Raises
    ------
    InputError
        If no deformation gives the heart's volumes, or it does not fit into the torso.
    """
    heart, size = family.deformed(described.size), described.trunk_size
    mesh = replace(family.mesh, vertices=heart.vertices, name=name)
    rotation = family.axes @ standard_axes(*described.axis).T
    centroid = solid_centroid(heart.vertices, heart.tetrahedra)
    position = default_position(size) + described.shift
    frame = TorsoFrame(rotation, centroid - rotation @ position)
    surfaces = idealised_torso(mesh, size, frame)
    assert surfaces.electrodes is not None
    torso = mesh_torso(mesh, surfaces.skin, surfaces.lungs)
    return replace(heart, name=name, electrodes=surfaces.electrodes, torso=torso)


@one_thread
def lead_fields_in_torsos(
    heart: Heart, conduction: Conduction, rng: np.random.Generator, count: int
) -> Floats:
    """Lead fields (1 + count, 9, n) (kΩ) of a heart in its torso, then in random variations of it.

    Quantities of the torso are drawn from their priors (docs/quantities.md). Fields are over the
    factor on the myocardium's conductivity, by which sources are multiplied.
    """
    assert heart.torso is not None
    conductor = build_conductor(heart, heart.torso, conduction)
    places = electrode_places(conductor)
    space = ParameterSpace(tuple(free(name) for name in TORSO_QUANTITIES))
    states = [TorsoState.of({})]
    while len(states) < 1 + count:
        state = TorsoState.of(space.from_unit(rng.random(len(space))))
        if conductor.is_possible(state):
            states.append(state)
    vertices = len(heart.vertices)
    fields = [solve_torso(conductor, places, state, 1e-3, 80)[:vertices].T for state in states]
    return np.array(fields)
