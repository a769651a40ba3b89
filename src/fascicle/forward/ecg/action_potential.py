"""Action-potential templates: the transmembrane potential that the front leaves behind."""

from __future__ import annotations

from typing import Protocol

from fascicle.core.arrays import Floats


class ActionPotential(Protocol):
    """A template U of the time since activation.

    An ionic cable model fits behind this as well as a closed form.
    """

    @property
    def span(self) -> tuple[float, float]:
        """Times (ms since activation) outside which U is constant to within 1e-6 of its rise."""

    def __call__(self, time: Floats) -> Floats:
        """Transmembrane potential (mV) at `time` (ms since activation)."""
