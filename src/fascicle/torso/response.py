"""Lead fields of a heart as a function of the torso: a reduced basis in a hull.

The torso moves only outside the convex hull of heart and blood. Within, lead fields are linear
combinations of modes Φ, which are computed from lead fields in some torsos; their energy K depends
linearly on the conductivity factors of the tissues. The tissue outside the hull adds the energy A
of the modes' potentials around it, and the current of an electrode drives f into the hull
(`fascicle.torso.training`). So the coefficients of an electrode's lead field are
(K + A)⁻¹f, the Galerkin solution, which is best in the energy of heart and torso.

A and f are smooth functions of eight numbers: pose, size, and the conductivity of the lungs. They
are interpolated between torsos by radial basis functions with a linear trend. The steep part of f,
that of an electrode near the hull in infinite plain tissue, is computed analytically, so only the
remainder is interpolated. Plain tissue is neither lung nor blood.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy.linalg
from scipy.interpolate import RBFInterpolator
from scipy.spatial.distance import cdist

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import ELECTRODES
from fascicle.core.parameters import Infeasible
from fascicle.core.quantities import torso_values
from fascicle.core.threads import one_thread
from fascicle.torso.conductor import Morph, SkinMotion, TorsoState
from fascicle.torso.electrode_sites import Electrode

# Places (mm) of chest electrodes along the skin, whose triangles have edges of some 11 mm: beyond
# the 25 mm of one electrode over a chest of 0.85, and upwards also the 40 mm of all together
SPACING = 6.0
LEFT: Floats = SPACING * np.arange(-5.0, 6.0)
UPWARD: Floats = SPACING * np.arange(-13.0, 14.0)
FIXED = Electrode.V1 + 6 * len(LEFT) * len(UPWARD)  # first place of the additional electrodes


def exterior_inputs(state: TorsoState) -> Floats:
    """Inputs (8,) of the response outside the hull: pose, size and lungs, scaled to about ±1."""
    plain, lung, _ = state.ratios
    geometry = (state.geometry - [0, 0, 0, 0, 0, 0, 1]) / state.reach
    return np.append(geometry, np.log(lung / plain) / (2 * state.log_factor))


def near_field(electrodes: Floats, hull: Floats, projection: Floats, energy: Floats) -> Floats:
    """Currents (e, k) that electrodes (e, 3) in infinite plain tissue drive into the hull's modes.

    Electrodes (mm) are in the heart's coordinates, `hull` (s, 3) are points of its surface (mm).
    The projection (s, k) turns 1/distance (1/mm) to the points into coefficients of the modes:
    the potential of a unit current into an insulated plane, 1/(2πσr), projected in the energy of a
    hull of plain tissue. The energy (k, k) is that of the modes in that hull and outside (1/kΩ).
    """
    return np.asarray((1.0 / cdist(electrodes, hull)) @ projection @ energy)


@dataclass(frozen=True)
class TorsoResponse:
    """Lead fields of a heart as a function of the torso.

    There are p = 3 + 6·left·up + a places: RA, LA and LL, then V1 to V6 at every place of a grid
    along the skin, then the additional electrodes. The critical `Morph` is at the tetrahedra that
    are compressed most when the heart nears the skin. For hull and projection see `near_field`.
    """

    modes: Floats  # Φ at the heart's vertices (kΩ½), (k, n)
    inner: Floats  # their energies in the hull's myocardium, then in each `TorsoTissue`, (4, k, k)
    solved: Floats  # `exterior_inputs` of the torsos solved, (b, 8)
    outer: Floats  # upper triangles of A over the factor on plain tissue's σ, (b, k(k+1)/2)
    places: Floats  # (p, 3), mm
    patterns: Floats  # orthonormal functions of the places, (p, q)
    remainders: Floats  # coefficients of the patterns in f beyond `near_field`, (b, q, k)
    hull: Floats  # (s, 3), mm
    projection: Floats  # (s, k)
    filled: Floats  # energy of the modes in a hull of plain tissue, (k, k)
    critical_centres: Floats
    critical_share: Floats
    critical_slope: Floats
    centroid: Floats  # centroid of the heart (3,), mm
    axes: Floats  # axes of the torso (3, 3)

    @one_thread
    def __call__(self, state: TorsoState) -> Floats | Infeasible:
        """Coefficients (9 + a, k) of the modes for every electrode.

        They must be divided by the factor on the myocardium's conductivity; the nine sum to zero.
        """
        motion = SkinMotion.of(self.centroid, self.axes, state)
        critical = Morph(self.critical_centres, self.critical_share, self.critical_slope)
        if critical.determinants(motion).min() < critical.least_compression:
            return Infeasible("the heart would touch the skin", "move it less")
        weights = self._weights(exterior_inputs(state)[None])[0].astype(self.outer.dtype)
        outer = np.empty(self.filled.shape)
        upper = np.triu_indices(len(outer))
        outer[upper] = outer.T[upper] = weights @ self.outer
        moved, electrodes = self._placed(state, motion)
        driven = near_field(electrodes, self.hull, self.projection, outer + self.filled)
        remainders = np.tensordot(weights, self.remainders, axes=1)
        driven = driven + at_electrodes(self.patterns, moved) @ remainders
        driven -= driven[: len(ELECTRODES)].mean(axis=0)
        energy = np.tensordot(np.append(1.0, state.ratios), self.inner, axes=1)
        energy += state.ratios[0] * outer
        try:
            factor = scipy.linalg.cho_factor(energy)
        except scipy.linalg.LinAlgError:  # between torsos solved, A need not be positive
            return Infeasible("the heart nearly touches the skin", "move it less")
        return np.asarray(scipy.linalg.cho_solve(factor, driven.T).T)

    def _placed(self, state: TorsoState, motion: SkinMotion) -> tuple[Floats, Floats]:
        """Shifts (6, 2) of V1 to V6 on the unmoved skin, and moved positions of electrodes (mm)."""
        # on a larger trunk the same distance is a smaller part of the skin
        moved = state.chest / state.geometry[6]
        return moved, motion(at_electrodes(self.places, moved))

    def electrodes(self, state: TorsoState) -> Floats:
        """Positions (9 + a, 3) of the electrodes in the heart's coordinates (mm)."""
        return self._placed(state, SkinMotion.of(self.centroid, self.axes, state))[1]

    def coefficients(self, values: Mapping[str, float]) -> Floats | Infeasible:
        """Coefficients for quantities of the torso; the last few torsos are remembered."""
        return self._remembered(tuple(sorted(torso_values(values).items())))

    @cached_property
    def _remembered(self) -> Callable[[tuple[tuple[str, float], ...]], Floats | Infeasible]:
        return lru_cache(8)(lambda values: self(TorsoState.of(dict(values))))

    @cached_property
    def _weights(self) -> RBFInterpolator:
        """Interpolation weights (1, b) of the torsos solved, as a function of `exterior_inputs`."""
        return RBFInterpolator(self.solved, np.eye(len(self.solved)), kernel="cubic", degree=1)

    def arrays(self) -> dict[str, Any]:
        """Arrays by name, for files."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    __getstate__ = arrays  # remembered values are not sent to other processes


def at_electrodes(values: Floats, moved: Floats) -> Floats:
    """Interpolate values at all places to electrodes (9 + a, c), with V1 to V6 moved (6, 2)."""
    (i, a), (j, b) = _between(moved[:, 0], LEFT), _between(moved[:, 1], UPWARD)
    corner = Electrode.V1 + (np.arange(len(moved)) * len(LEFT) + i) * len(UPWARD) + j
    a, b = a[:, None], b[:, None]
    chest = (1 - a) * ((1 - b) * values[corner] + b * values[corner + 1])
    corner += len(UPWARD)
    chest += a * ((1 - b) * values[corner] + b * values[corner + 1])
    return np.concatenate([values[: Electrode.V1], chest, values[FIXED:]])


def _between(values: Floats, places: Floats) -> tuple[Integers, Floats]:
    """Intervals of evenly spaced places that hold values, and the values' share along them."""
    position = np.clip((values - places[0]) / SPACING, 0, len(places) - 1)
    index = np.minimum(position.astype(np.int64), len(places) - 2)
    return index, position - index
