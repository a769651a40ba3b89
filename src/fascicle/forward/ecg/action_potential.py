"""Action-potential templates: the transmembrane potential that the front leaves behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ActionPotential(Protocol):
    """A template U of the time since activation.

    An ionic cable model fits behind this as well as a closed form.
    """

    @property
    def span(self) -> tuple[float, float]:
        """Times (ms since activation) outside which U is constant to within 1e-6 of its rise."""

    def __call__(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transmembrane potential (mV) at `time` (ms since activation)."""


@dataclass(frozen=True)
class Upstroke:
    """A smooth upstroke to a plateau, U(ξ) = rest + (plateau − rest)·(1 + tanh(2ξ/w))/2.

    It has no repolarisation, so only the QRS follows from it.

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
