"""References for the forward model in benchmarks and tests: closed forms, and first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fascicle.forward.eikonal.activation import initial_front
from fascicle.forward.eikonal.myocardium import Myocardium, attach
from fascicle.kernels.coupled import sweep
from fascicle.torso.lead_fields import MM_PER_CM


@dataclass(frozen=True)
class Upstroke:
    """A smooth upstroke to a plateau, U(ξ) = rest + (plateau − rest)·(1 + tanh(2ξ/w))/2.

    An `ActionPotential` without repolarisation, so only the QRS follows from it.

    Attributes
    ----------
    rest, plateau : float
        Potentials (mV) before and after; as in the Ten Tusscher–Panfilov 2006 myocyte.
    width : float
        Amplitude divided by the maximum upstroke velocity, w (ms); 1 ms for about 105 V/s in
        well-coupled tissue.
    """

    rest: float = -85.2
    plateau: float = 20.0
    width: float = 1.0

    @property
    def span(self) -> tuple[float, float]:
        """See `ActionPotential`; the tails decay as exp(−4|ξ|/w)."""
        return -3.5 * self.width, 3.5 * self.width

    def __call__(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `ActionPotential`."""
        rise = self.plateau - self.rest
        return np.asarray(self.rest + rise * (1 + np.tanh(2 * time / self.width)) / 2)


def unbounded(
    points: NDArray[np.float64], electrodes: NDArray[np.float64], conductivity: float
) -> NDArray[np.float64]:
    """Z = 1/(4πσr), the lead field of an unbounded homogeneous conductor.

    Parameters
    ----------
    points : (n, 3) array
        Where (mm).
    electrodes : (e, 3) array
        Positions (mm).
    conductivity : float
        σ (mS/cm).

    Returns
    -------
    (e, n) array
        Potential for unit current (mV/µA, that is kΩ).
    """
    distance = np.linalg.norm(electrodes[:, None, :] - points[None, :, :], axis=2) / MM_PER_CM
    return np.asarray(1 / (4 * np.pi * conductivity * distance))


def solve_from_vertices(myocardium: Myocardium, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve the eikonal equation in the myocardium alone, from times at vertices.

    First order: without a site there are no rays.

    Parameters
    ----------
    myocardium : Myocardium
        The myocardium.
    times : (n,) array
        When each vertex of the heart is fired (ms); inf where it is not.

    Returns
    -------
    (n,) array
        Activation times (ms); inf where no front arrives.
    """
    coupling = attach(myocardium, ())
    front = initial_front(myocardium.mesh, len(coupling.lengths), 0)
    front.nodes["time"][: len(times)] = times[myocardium.order]
    sources = np.flatnonzero(np.isfinite(front.nodes["time"]))
    sweep(front, sources, myocardium.mesh, coupling.forest, coupling.sites)
    solved = np.empty(len(times))
    solved[myocardium.order] = front.nodes["time"][: len(times)]
    return solved
