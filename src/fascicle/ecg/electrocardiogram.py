"""From activation times to the twelve-lead ECG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from fascicle.ecg.action_potential import ActionPotential
from fascicle.ecg.lead_field import MM_PER_CM
from fascicle.eikonal.tissue import Tissue
from fascicle.kernels.deposit import deposit
from fascicle.leads import lead_matrix

BINS_PER_MS = 4  # resolution of the activation histogram
STEP = 1.0  # sampling of the ECG (ms)


@dataclass(frozen=True)
class Electrocardiograph:
    """Everything about a heart that the ECG needs beyond activation times.

    Attributes
    ----------
    corners : (m, 4) array
        Vertices of each tetrahedron.
    weights : (m, 9, 4) array
        What each nodal time contributes to |e|·(Gᵢ∇τ·∇Z) of each electrode.
    action_potential : ActionPotential
        The template U.
    """

    corners: NDArray[np.int64]
    weights: NDArray[np.float64]
    action_potential: ActionPotential

    def potentials(self, activation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Potential at each electrode, every `STEP` ms from time 0 until all is quiet.

        V(t) = −∫ Gᵢ∇Vm·∇Z dx with Vm = U(t − τ) is Σₑ |e|(Gᵢ∇τ·∇Z)ₑ ⟨U′(t − τ)⟩ₑ; the elements'
        fronts go into a fine histogram over time, which is convolved once with the mean of U′ over
        a bin. A front that travels towards a positive electrode gives a positive deflection.

        Parameters
        ----------
        activation : (n,) array
            Time at each vertex (ms), none before 0.

        Returns
        -------
        (9, n_time) array
            Potentials (mV).
        """
        if activation.min() < 0:
            raise ValueError(f"activation begins at {activation.min()} ms; it must not before 0")
        begin, end = self.action_potential.span
        width = 1.0 / BINS_PER_MS
        duration = int(np.ceil(activation.max() + end))
        bins = (duration + 1) * BINS_PER_MS
        histogram = deposit(activation, self.corners, self.weights, width, bins)
        # sample j of the kernel: mean of U′ over a bin that began (first + j)·width ago
        first = int(np.floor(begin * BINS_PER_MS))
        last = int(np.ceil(end * BINS_PER_MS)) + 1
        since = np.arange(first, last + 1, dtype=np.float64) * width
        u = self.action_potential
        kernel = (u(since) - u(since - width)) / width
        full = scipy.signal.oaconvolve(histogram, kernel[:, None], axes=0)
        # full[i] belongs to time (i + first)·width
        wanted = np.arange(duration + 1) * BINS_PER_MS - first
        return np.ascontiguousarray(full[wanted].T)

    def leads(self, activation: NDArray[np.float64]) -> NDArray[np.float64]:
        """The twelve leads (mV), shape (12, n_time); see `potentials`."""
        return lead_matrix() @ self.potentials(activation)


def build_electrocardiograph(
    tissue: Tissue,
    volumes: NDArray[np.float64],
    intracellular: NDArray[np.float64],
    lead_fields: NDArray[np.float64],
    action_potential: ActionPotential,
) -> Electrocardiograph:
    """Precompute the ECG integral of a heart.

    Parameters
    ----------
    tissue : Tissue
        The mesh.
    volumes : (m,) array
        Volume of each tetrahedron (mm³).
    intracellular : (m, 3, 3) array
        Gᵢ (mS/cm).
    lead_fields : (9, n) array
        Z of each electrode at the vertices, linear in between (kΩ).
    action_potential : ActionPotential
        The template U.
    """
    # mS/cm · mm³ · (ms/mm) · (kΩ/mm) · mV/ms = mV / 10
    gradient = np.einsum("emk,mki->emi", lead_fields[:, tissue.corners], tissue.gradients)
    current = np.einsum("m,mij,emj->mei", volumes / MM_PER_CM, intracellular, gradient)
    weights = np.einsum("mei,mki->mek", current, tissue.gradients)
    return Electrocardiograph(tissue.corners, np.ascontiguousarray(weights), action_potential)
