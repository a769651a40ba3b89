"""Conductivities of the myocardium, and the front speeds that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# α² G is (cm/ms)²; speeds here are in mm/ms
MM2_PER_CM2 = 100.0


@dataclass(frozen=True)
class Conduction:
    """Bidomain conductivities along (l) and across (t) the fibre, and the speed constant α.

    Attributes
    ----------
    intracellular_l, intracellular_t, extracellular_l, extracellular_t : float
        Conductivities (mS/cm).
    alpha : float
        α (cm·ms⁻¹·(mS/cm)^-½): D = α² Gᵢ(Gᵢ+Gₑ)⁻¹Gₑ; 0.05 to 0.1 in the paper's patients.
    torso : float
        Conductivity of the unbounded volume conductor (mS/cm); about that of the torso as a whole.
    """

    intracellular_l: float = 3.0
    intracellular_t: float = 0.3
    extracellular_l: float = 3.0
    extracellular_t: float = 1.2
    alpha: float = 0.05
    torso: float = 2.0

    @property
    def speeds(self) -> tuple[float, float]:
        """Front speed along and across the fibre (mm/ms)."""
        along, across = np.sqrt(self._squared_speeds())
        return float(along), float(across)

    def _squared_speeds(self) -> tuple[float, float]:
        """D along and across the fibre (mm²/ms²): scalars suffice, G's share their axes."""
        pairs = (
            (self.intracellular_l, self.extracellular_l),
            (self.intracellular_t, self.extracellular_t),
        )
        along, across = (
            MM2_PER_CM2 * self.alpha**2 * intra * extra / (intra + extra) for intra, extra in pairs
        )
        return along, across

    def intracellular(self, fibres: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gᵢ (mS/cm) for unit fibres of shape (m, 3); shape (m, 3, 3)."""
        return transversely_isotropic(fibres, self.intracellular_l, self.intracellular_t)

    def metric(self, fibres: NDArray[np.float64]) -> NDArray[np.float64]:
        """D⁻¹ (ms²/mm²) for unit fibres of shape (m, 3); shape (m, 3, 3)."""
        along, across = self._squared_speeds()
        return transversely_isotropic(fibres, 1 / along, 1 / across)


def transversely_isotropic(
    fibres: NDArray[np.float64], along: float, across: float
) -> NDArray[np.float64]:
    """Tensor `across`·I + (`along` − `across`)·f⊗f, shape (m, 3, 3)."""
    dyads = fibres[:, :, None] * fibres[:, None, :]
    return np.asarray(across * np.eye(3) + (along - across) * dyads)
