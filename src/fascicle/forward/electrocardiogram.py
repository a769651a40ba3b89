"""ECG from activation times: the twelve leads, and those of additional electrodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from fascicle.core.arrays import Floats, Integers, Singles
from fascicle.core.leads import INDEPENDENT_LEADS, INDEPENDENT_ROWS, LEADS, lead_matrix
from fascicle.kernels.deposit import deposit, respond, reweight
from fascicle.kernels.jit import CHANNELS
from fascicle.mesh.measures import HAMMER_STROUD_POINTS

SAMPLE_STEP = 1.0  # sampling of the ECG (ms)


@runtime_checkable
class ActionPotential(Protocol):
    """A template U of the time since activation.

    It may be computed by an ionic cable model or a closed form.
    """

    @property
    def span(self) -> tuple[float, float]:
        """Times (ms since activation) outside which U is constant to within 1e-6 of its rise."""

    def __call__(self, time: Floats) -> Floats:
        """Transmembrane potential (mV) at `time` (ms since activation)."""


def first_sample(activation: Floats) -> float:
    """Time of the first sample of the ECG (ms): 0, or the whole ms before an earlier activation."""
    return float(np.floor(min(0.0, activation.min()) / SAMPLE_STEP) * SAMPLE_STEP)


@dataclass(frozen=True)
class Electrocardiograph:
    """ECG integral of a heart: all that the ECG depends on besides activation times.

    Attributes
    ----------
    corners : (m, 4) array
        Vertices of each tetrahedron.
    weights : (m, 3, 8) array
        Contributions of the times of the last three corners, less that of the first, to
        |e|·(Gᵢ∇τ·∇Z) of each channel (`channel_weights`). In single precision, for memory: an
        element's contribution is wrong by a part in 10⁷ and keeps its form in time.
    additional : sequence of (m, 3, 8) arrays
        Weights of additional leads, eight in a group, the last group padded with zeros.
    additional_count : int
        Additional leads.
    action_potential : ActionPotential
        The template U.
    bins_per_step : int
        Resolution of the activation histogram. Two make an error of 1e-4 of the QRS; it falls with
        the fourth power.
    fields : (n, 8 + k) array, optional
        Lead field of each channel at the vertices (kΩ): weights are then (m, 3, 4), by which those
        at the corners of an element are multiplied for each ECG. That takes four times as long as
        with weights that are kept, and a tenth of the memory, if there are many torsos.
    """

    corners: NDArray[np.int32]
    weights: NDArray[np.float32]
    action_potential: ActionPotential
    additional: Sequence[NDArray[np.float32]] = ()
    additional_count: int = 0
    bins_per_step: int = 2
    fields: Singles | None = None

    @cached_property
    def response(self) -> tuple[int, Floats]:
        """Response to a bin of the histogram; see `bin_response`."""
        return bin_response(self.action_potential, SAMPLE_STEP / self.bins_per_step)

    def channels(self, activation: Floats) -> Floats:
        """Potential of each channel, every `SAMPLE_STEP` ms from `first_sample` until all is quiet.

        The channels are the `INDEPENDENT_LEADS`, then the additional leads.

        The paper's lead-field integral V(t) = −∫ Gᵢ∇Vm·∇Z dx with Vm = U(t − τ) is
        Σₑ |e|(Gᵢ∇τ·∇Z)ₑ ⟨U′(t − τ)⟩ₑ; the elements' fronts go into a histogram over time, which is
        convolved once with the response to a bin. A front that travels towards a positive electrode
        gives a positive deflection.

        Parameters
        ----------
        activation : (n,) array
            Time at each vertex (ms), +inf where the front never comes. Elements with such a vertex
            are left out of the integral.

        Returns
        -------
        (8 + k, n_time) array
            Potentials (mV).

        Raises
        ------
        ValueError
            If a time is NaN or -inf, or no vertex is ever activated.
        """
        activated = activation < np.inf
        if np.isnan(activation).any() or activation.min() == -np.inf:
            raise ValueError("activation times must be numbers, or +inf where never activated")
        if not activated.any():
            raise ValueError("activation: no vertex is ever activated, so there is no ECG")
        start = first_sample(activation)
        end = activation.max(where=activated, initial=-np.inf) + self.action_potential.span[1]
        samples = int(np.ceil((end - start) / SAMPLE_STEP)) + 1
        first, kernel = self.response
        width = SAMPLE_STEP / self.bins_per_step
        # sample 0 draws on the bins from the first, `last` before it, to the one `-first` after it
        last = first + len(kernel) - 1
        bins = (samples - 1) * self.bins_per_step + len(kernel)
        potentials = [
            respond(
                deposit(activation, self.corners, weights, start - last * width, width, bins),
                kernel, self.bins_per_step, samples,
            )
            for weights in self._of_channels()
        ]  # fmt: skip
        return np.concatenate(potentials)[: CHANNELS + self.additional_count]

    def _of_channels(self) -> Iterator[Singles]:
        """Weights (m, 3, 8) of the independent leads, then of each group of additional ones."""
        if self.fields is None:
            yield from (self.weights, *self.additional)
            return
        for first in range(0, self.fields.shape[1], CHANNELS):
            group = self.fields[:, first : first + CHANNELS]
            weights = np.zeros((*self.weights.shape[:2], CHANNELS), np.float32)
            np.matmul(self.weights, group[self.corners], out=weights[:, :, : group.shape[1]])
            yield weights

    def scaled(self, factors: Floats) -> Electrocardiograph:
        """ECG integral with the conductivity of each tetrahedron times a factor (m,); 0: no source.

        Lead fields do not change: tissue that is not activated still conducts currents of the rest.
        """
        if (factors == 1).all():
            return self
        conducting, corners = factors > 0, self.corners
        groups: Sequence[NDArray[np.float32]] = (self.weights, *self.additional)
        if not conducting.all():
            corners, groups = corners[conducting], [group[conducting] for group in groups]
        single = factors[conducting, None, None].astype(np.float32)
        weights, *more = (group * single for group in groups)
        return replace(self, corners=corners, weights=weights, additional=more)

    def with_sources(
        self, factors: Singles, axial: float, along: Singles, back: Singles
    ) -> Electrocardiograph:
        """ECG integral with the sources of each tetrahedron times a factor (m,); lead fields stay.

        First the axial part of the sources, along the fibre, changes by the share `axial`; `along`
        and `back` (m, 3) are those of `axial_projection`.
        """
        groups = []
        for old in (self.weights, *self.additional):
            new = np.empty_like(old)
            reweight(old, factors, np.float32(axial), along, back, new)
            groups.append(new)
        return replace(self, weights=groups[0], additional=groups[1:])

    def leads(self, activation: Floats) -> Floats:
        """The twelve leads and the additional ones (mV), shape (12 + k, n_time); see `channels`."""
        channels = self.channels(activation)
        twelve = leads_from_independent() @ channels[:CHANNELS]
        return np.concatenate([twelve, channels[CHANNELS:]])


def axial_projection(barycentric: Floats, fibres: Floats, excess: float) -> tuple[Floats, Floats]:
    """Projection of weights (3,) of each tetrahedron on its fibre: vectors b and a, (m, 3) each.

    With G the gradients of three barycentric coordinates and J = Gᵢ∇Z, the weights are w = GJ. What
    points along the fibre f beyond isotropic tissue, σₗ-σₜ of σₗ, is the share `excess` of f(f·J),
    so it gives the weights b(aᵀw) with b = `excess`·Gf and aᵀ = fᵀG⁻¹.
    """
    gradients = barycentric[:, 1:]
    along = np.einsum("mix,mx->mi", gradients, fibres)
    back = np.linalg.solve(gradients.transpose(0, 2, 1), fibres[:, :, None])[..., 0]
    return np.asarray(excess * along), np.asarray(back)


def leads_from_independent() -> Floats:
    """Matrix (12, 8) that completes the leads `INDEPENDENT_LEADS` to the twelve."""
    i, ii, *chest = np.eye(len(INDEPENDENT_LEADS))
    return np.array([i, ii, ii - i, -(i + ii) / 2, i - ii / 2, ii - i / 2, *chest])


def bin_response(action_potential: ActionPotential, width: float) -> tuple[int, Floats]:
    """Response kⱼ to a hat-shaped bin: Σⱼ kⱼ·hat(ξ/width − j) is nearest to U′(ξ).

    Nearest in least squares: the error is then orthogonal to every piecewise linear histogram, and
    what remains of it in V falls with width⁴.

    Parameters
    ----------
    action_potential : ActionPotential
        The template U.
    width : float
        From the peak of one bin to that of the next (ms).

    Returns
    -------
    first : int
        j of the first value.
    kernel : array
        kⱼ (mV/ms), every `width` from the bin's peak.
    """
    begin, end = action_potential.span
    ringing = 12  # bins after U has come to rest; the response is then below 1e-7 of its height
    first, last = int(np.floor(begin / width)) - ringing, int(np.ceil(end / width)) + ringing
    node, weight = np.polynomial.legendre.leggauss(8)
    times = (np.arange(first - 1, last + 1)[:, None] + (node + 1) / 2) * width
    mean = action_potential(times) @ weight / 2
    moments = np.diff(mean) / width  # integrals of U′ times each hat function, by parts
    overlaps = np.zeros(len(moments))
    overlaps[:2] = 2 / 3, 1 / 6  # integrals of a hat function times itself and the next one
    return first, np.asarray(scipy.linalg.solve_toeplitz(overlaps, moments))


def channel_weights(
    barycentric: Floats, volumes: Floats, intracellular: Floats, gradients: Floats
) -> Floats:
    """Weights (m, 3, 8) of `Electrocardiograph` for up to eight lead fields; other channels stay 0.

    For times in ms and U′ in mV/ms, these make mV. Of each tetrahedron: the gradients of its
    barycentric coordinates (m, 4, 3) (1/mm), its volume (m,) (mm³), Gᵢ (m, 3, 3) (mS/cm), and the
    mean ∇Z (c, m, 3) (kΩ/mm), c ≤ 8.
    """
    # mS/cm · mm³ · (1/mm) · (kΩ/mm) = 1/10
    current = np.einsum("m,mij,cmj->mci", volumes / 10, intracellular, gradients)
    weights = np.zeros((len(volumes), 3, CHANNELS))
    weights[:, :, : len(gradients)] = barycentric[:, 1:] @ current.transpose(0, 2, 1)
    return weights


def build_electrocardiograph(
    corners: Integers,
    barycentric: Floats,
    volumes: Floats,
    intracellular: Floats,
    gradients: Floats,
    action_potential: ActionPotential,
    additional: Sequence[str] = (),
) -> Electrocardiograph:
    """Precompute the ECG integral of a heart of tetrahedra (m, 4).

    `gradients` (9 + a, m, 3) are the mean ∇Z of each electrode in each tetrahedron (kΩ/mm), by
    `unbounded_gradients`, or `nodal_gradients` of lead fields known at the vertices; `additional`
    names the electrodes besides the nine; the others are those of `channel_weights`.
    """

    def weights(rows: Sequence[int]) -> NDArray[np.float32]:
        of_leads = np.tensordot(matrix[rows], gradients, axes=1)
        channels = channel_weights(barycentric, volumes, intracellular, of_leads)
        return channels.astype(np.float32)

    matrix = lead_matrix(additional)
    more = range(len(LEADS), len(matrix))
    groups = [weights(more[k : k + CHANNELS]) for k in range(0, len(more), CHANNELS)]
    return Electrocardiograph(
        corners.astype(np.int32), weights(INDEPENDENT_ROWS), action_potential, groups, len(more)
    )


def electrocardiographs_of(
    corners: Integers,
    barycentric: Floats,
    volumes: Floats,
    intracellular: Floats,
    lead_fields: Floats,
    action_potential: ActionPotential,
    additional: Sequence[str] = (),
) -> list[Electrocardiograph]:
    """ECG integrals in several torsos: `lead_fields` (t, 9 + a, n) (kΩ), as `nodal_gradients` has.

    They share weights that are multiplied by the lead fields for each ECG; other arguments are
    those of `build_electrocardiograph`.
    """
    matrix = lead_matrix(additional)
    rows = [*INDEPENDENT_ROWS, *range(len(LEADS), len(matrix))]
    fields = np.einsum("ce,ten->tnc", matrix[rows], lead_fields).astype(np.float32)
    at_corners = barycentric.transpose(1, 0, 2)  # gradients of fields that are 1 at a corner
    weights = channel_weights(barycentric, volumes, intracellular, at_corners)
    shared = Electrocardiograph(
        corners.astype(np.int32), weights[:, :, : len(at_corners)].astype(np.float32),
        action_potential, additional_count=len(matrix) - len(LEADS),
    )  # fmt: skip
    return [replace(shared, fields=of_torso) for of_torso in fields]


def unbounded_gradients(
    vertices: Floats, corners: Integers, electrodes: Floats, conductivity: float
) -> Floats:
    """Mean over each element of ∇Z = −r/(4πσ|r|³), r from the electrode, by quadrature.

    (e, m, 3) (kΩ/mm), for electrodes (e, 3) (mm) and a conductivity σ (mS/cm). Far closer than the
    gradient of the interpolated Z, which in a flat element can be wrong by half.
    """
    # (q, 3, m), so that sums run along whole rows
    points = np.ascontiguousarray(np.moveaxis(HAMMER_STROUD_POINTS @ vertices[corners], 0, 2))
    gradients = np.empty((len(electrodes), len(corners), 3))
    for electrode, gradient in zip(electrodes, gradients, strict=True):
        towards = electrode[:, None] - points
        towards /= np.sqrt((towards * towards).sum(axis=1, keepdims=True)) ** 3
        gradient[:] = towards.mean(axis=0).T
    return gradients * 10 / (4 * np.pi * conductivity)  # 10 mm in 1 cm


def nodal_gradients(lead_fields: Floats, corners: Integers, gradients: Floats) -> Floats:
    """∇Z (e, m, 3) (kΩ/mm) of lead fields (e, n) (kΩ) at the vertices, linear in each element.

    `corners` (m, 4) are the vertices of each tetrahedron, `gradients` (m, 4, 3) those of its
    barycentric coordinates (1/mm).
    """
    return np.asarray(np.einsum("emk,mki->emi", lead_fields[:, corners], gradients))
