"""The ECG of a heart in random torsos, drawn from the priors of their quantities."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Infeasible, ParameterSpace, free
from fascicle.core.quantities import TORSO_QUANTITIES
from fascicle.forward.electrocardiogram import (
    Electrocardiograph,
    build_electrocardiograph,
    unbounded_gradients,
)
from fascicle.forward.model import ForwardModel
from fascicle.mesh.measures import barycentric_gradients, solid_centroid, unit
from fascicle.torso.electrode_sites import Electrode
from fascicle.torso.variation.conductor import SkinMotion, TorsoState, torso_axes


def random_bodies(
    model: ForwardModel, rng: np.random.Generator, count: int
) -> list[Electrocardiograph]:
    """ECG integrals of a model's heart in random torsos.

    Their quantities of the torso are drawn from their priors (docs/quantities.md); impossible
    torsos are drawn again. Each takes as much memory as the model's own integral.

    Parameters
    ----------
    model : ForwardModel
        The heart. With a torso or lead fields, `ForwardModel.torso` is built first: minutes, once.
    rng : numpy.random.Generator
        Generator of the draws: the same state gives the same torsos.
    count : int
        Number of torsos.
    """
    space = ParameterSpace(tuple(free(name) for name in TORSO_QUANTITIES))
    in_torso, integrals = electrocardiograph_in_body(model), list[Electrocardiograph]()
    while len(integrals) < count:
        integral = in_torso(space.from_unit(rng.random(len(space))))
        if not isinstance(integral, Infeasible):
            integrals.append(integral)
    return integrals


def electrocardiograph_in_body(
    model: ForwardModel,
) -> Callable[[Mapping[str, float]], Electrocardiograph | Infeasible]:
    """The ECG integral of a model's heart as a function of quantities of the torso.

    In an unbounded conductor electrodes move as with the skin, and conductivities, which scale the
    whole ECG there, do nothing.
    """
    heart, conduction = model.heart, model.conduction
    if heart.has_torso:
        return model.electrocardiograph_in_torso
    mesh = heart.vertices, heart.tetrahedra
    centroid, barycentric = solid_centroid(*mesh), barycentric_gradients(*mesh)
    intracellular, scale = conduction.intracellular(heart.fibres), conduction.scale(heart)

    def unbounded(values: Mapping[str, float]) -> Electrocardiograph:
        places = moved_electrodes(heart.electrode_positions, centroid, TorsoState.of(values))
        gradients = unbounded_gradients(*mesh, places, conduction.torso)
        volumes, more = heart.volumes, [*heart.additional_electrodes]
        return build_electrocardiograph(
            heart.tetrahedra, barycentric, volumes, intracellular, gradients,
            model.action_potential, more,
        ).scaled(scale)  # fmt: skip

    return unbounded


def moved_electrodes(electrodes: Floats, centroid: Floats, state: TorsoState) -> Floats:
    """Positions of moved electrodes (9 + a, 3) about a heart's centroid (mm), without a torso.

    V1 to V6 move to the left and up at right angles to the line from the centroid, then all
    electrodes by `SkinMotion`.
    """
    motion = SkinMotion.of(centroid, torso_axes(electrodes), state)
    chest = slice(Electrode.V1, Electrode.V6 + 1)
    outwards = unit(electrodes[chest] - centroid)
    upwards = torso_axes(electrodes)[2]
    up = unit(upwards - (outwards @ upwards)[:, None] * outwards)
    left, lifted = (state.chest / motion.size).T
    placed = electrodes.copy()
    placed[chest] += left[:, None] * np.cross(up, outwards) + lifted[:, None] * up
    return motion(placed)
