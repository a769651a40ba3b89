"""The ECG as a function of the torso, prepared once for a heart and its conduction, and cached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS, lead_matrix
from fascicle.core.parameters import Infeasible
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.threads import one_thread
from fascicle.forward.electrocardiogram import Electrocardiograph, channel_weights, nodal_gradients
from fascicle.forward.preparation import ONCE, cached
from fascicle.heart.conduction import Conduction
from fascicle.heart.heart import Heart
from fascicle.kernels.jit import CHANNELS
from fascicle.mesh.measures import barycentric_gradients
from fascicle.torso.conductor import build_conductor, torso_of
from fascicle.torso.response import TorsoResponse
from fascicle.torso.training import build_response


@dataclass(frozen=True)
class TorsoModel:
    """Lead fields as a function of the torso, and the ECG weights of each of their modes."""

    response: TorsoResponse
    weights: NDArray[np.float32]  # (m, 3, k), of the `Electrocardiograph` for each mode
    additional: Sequence[str] = ()  # electrodes besides the nine

    def lead_coefficients(self, values: Mapping[str, float]) -> Floats | Infeasible:
        """Coefficients (8 + a, k) of the modes for the independent leads, then additional ones.

        Missing quantities leave the torso unchanged. The factor on the myocardium's conductivity
        divides the coefficients and multiplies the sources: only the ratio to the conductivities of
        other tissues counts.
        """
        coefficients = self.response.coefficients(values)
        if isinstance(coefficients, Infeasible):
            return coefficients
        matrix = lead_matrix(self.additional)
        rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(matrix))]
        return np.asarray(matrix[rows] @ coefficients)

    @one_thread
    def electrocardiograph(
        self, standard: Electrocardiograph, coefficients: Floats
    ) -> Electrocardiograph:
        """ECG integral in another torso, by its `lead_coefficients` and the standard torso's.

        The part of the standard torso's lead fields that the modes do not span is kept, scaled by
        the same factor as the part that they span.
        """
        neutral = self.lead_coefficients({})
        if isinstance(neutral, Infeasible):
            raise InputError("the heart touches the skin of its own torso; build the heart again")
        size = np.linalg.norm(coefficients, axis=1) / np.linalg.norm(neutral, axis=1)
        change = (coefficients - size[:, None] * neutral).astype(np.float32)
        flat = self.weights.reshape(-1, change.shape[1])
        size, groups = size.astype(np.float32), []
        for k, old in enumerate((standard.weights, *standard.additional)):
            part = slice(k * CHANNELS, (k + 1) * CHANNELS)
            weights = old[:, :, : len(size[part])]  # the last group is padded
            new = np.zeros_like(old)
            new[:, :, : weights.shape[2]] = size[part] * weights
            new[:, :, : weights.shape[2]] += (flat @ change[part].T).reshape(weights.shape)
            groups.append(new)
        return replace(standard, weights=groups[0], additional=groups[1:])


def torso_model(heart: Heart, conduction: Conduction, response: TorsoResponse) -> TorsoModel:
    """Torso model of a response, with the ECG weights of its modes."""
    barycentric = barycentric_gradients(heart.vertices, heart.tetrahedra)
    intracellular = conduction.intracellular(heart.fibres)
    gradients = nodal_gradients(response.modes, heart.tetrahedra, barycentric)
    weights = np.empty((len(heart.tetrahedra), 3, len(gradients)), dtype=np.float32)
    for start in range(0, len(gradients), CHANNELS):
        part = gradients[start : start + CHANNELS]
        channels = channel_weights(barycentric, heart.volumes, intracellular, part)
        weights[:, :, start : start + CHANNELS] = channels[:, :, : len(part)]
    return TorsoModel(response, weights, [*heart.additional_electrodes])


def prepare_response(
    heart: Heart, conduction: Conduction, names: Sequence[str], progress: Progress | None = None
) -> TorsoResponse:
    """Response of a heart's lead fields to the torso, cached; see `ForwardModel.torso`."""
    if not heart.has_torso:
        raise InputError(
            f"parameter '{names[0]}': {heart.name} has no torso; build the heart again with one "
            "(fascicle heart build), or leave the parameter out"
        )

    def make() -> TorsoResponse:
        torso = torso_of(heart, stage_progress(progress, "torso", ONCE))
        conductor = build_conductor(heart, torso, conduction)
        report = stage_progress(progress, "torso response", ONCE)
        # the same torsos are solved in every run
        return build_response(conductor, np.random.default_rng(0), report)

    return cached(
        heart, conduction, "body", make, TorsoResponse.arrays, lambda a: TorsoResponse(**a)
    )
