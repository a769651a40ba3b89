"""The lead fields of a heart as a function of the body: a reduced basis, evaluated.

Lead fields in the heart are combinations Z_e = Σ_k C_ek Φ_k of modes. With Φ orthonormal in the
energy of the heart and u_k the potential that the mode's currents K_heart Φ_k set up, reciprocity
gives C_ek = u_k(electrode). The potentials are found in the span of a basis V by the Galerkin
condition VᵀA(body)V; the error of C is then the product of what the basis leaves of the
electrode's own potential and of u_k's (Prud'homme, Rovas, Veroy, Machiels, Maday, Patera and
Turinici, J. Fluids Eng. 124, 2002, 70-80). VᵀAV depends on tissues linearly; for the pose and size,
the tensors of the moved conductor are combinations of those of a few bodies, found from their
values in a few tetrahedra (Barrault, Maday, Nguyen and Patera, C. R. Acad. Sci. Paris 339, 2004,
667-672; here least squares over more of them than there are unknowns).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpftrf as pftrf
from scipy.linalg.lapack import dpftrs as pftrs

from fascicle.core.arrays import Floats
from fascicle.core.leads import ELECTRODES
from fascicle.core.quantities import body_values
from fascicle.torso.electrode_sites import V1
from fascicle.torso.variation.body_axes import Motion
from fascicle.torso.variation.conductor import LEAST_COMPRESSION, BodyState, InvalidBody
from fascicle.torso.variation.electrode_paths import LEFT, SPACING, UP
from fascicle.torso.variation.morph import Morph

REMEMBERED = 8  # bodies whose coefficients are kept, the neutral one among them


@dataclass(frozen=True)
class BodyResponse:
    """Lead fields of a heart as a function of the body.

    Attributes
    ----------
    modes : (k, n) array
        Φ at the heart's vertices (kΩ½).
    loads : (b, k) array
        Currents of the modes on the basis.
    fixed : (2, p) array
        VᵀAV of myocardium and blood, in rectangular full packed format.
    moving : (2·q, p) array
        Those of body and lung for each of the q tensor modes.
    limbs : (3, b) array
        The basis at RA, LA and LL.
    chest : (6, left, up, b) array
        The basis at the places of V1 to V6 along the skin.
    sampled : (q, s, 6) array
        Weights that make the coefficients of the tensor modes of the tensors in s tetrahedra.
    sampled_centres, sampled_share, sampled_slope : (s, 3), (s,) and (s, 3) arrays
        `Morph` of these.
    critical_centres, critical_share, critical_slope : arrays
        `Morph` of the tetrahedra that are compressed most when the heart nears the skin.
    centroid, axes : (3,) and (3, 3) arrays
        Of the heart (mm) and the body.
    """

    modes: Floats
    loads: Floats
    fixed: Floats
    moving: Floats
    limbs: Floats
    chest: Floats
    sampled: Floats
    sampled_centres: Floats
    sampled_share: Floats
    sampled_slope: Floats
    critical_centres: Floats
    critical_share: Floats
    critical_slope: Floats
    centroid: Floats
    axes: Floats

    def __call__(self, state: BodyState) -> Floats | InvalidBody:
        """Coefficients C of the modes for every electrode.

        Parameters
        ----------
        state : BodyState
            The body.

        Returns
        -------
        (9, k) array or InvalidBody
            Over the factor on the myocardium's conductivity; the nine sum to zero.
        """
        motion = Motion.of(self.centroid, self.axes, state.geometry)
        critical = Morph(self.critical_centres, self.critical_share, self.critical_slope)
        if critical.compression(motion) < LEAST_COMPRESSION:
            return InvalidBody("the heart would touch the skin")
        at_skin = self.at_electrodes(state)
        factor, failed = pftrf(len(self.loads), self.reduced(state, motion))
        if failed:
            return InvalidBody("the heart nearly touches the skin")
        solved, _ = pftrs(len(self.loads), factor, at_skin.T)
        return np.asarray(solved.T @ self.loads)

    def coefficients(self, values: Mapping[str, float]) -> Floats | InvalidBody:
        """The same from quantities of the body; those of the last few bodies are remembered."""
        return self._remembered(tuple(sorted(body_values(values).items())))

    @cached_property
    def _remembered(self) -> Callable[[tuple[tuple[str, float], ...]], Floats | InvalidBody]:
        return lru_cache(REMEMBERED)(lambda values: self(BodyState.of(dict(values))))

    def reduced(self, state: BodyState, motion: Motion) -> Floats:
        """VᵀAV in LAPACK's rectangular full packed format (p,)."""
        sampled = Morph(self.sampled_centres, self.sampled_share, self.sampled_slope)
        tensors = sampled.tensors(motion)
        coefficients = self.sampled.reshape(len(self.sampled), -1) @ tensors.ravel()
        body, lung, blood = state.ratios
        packed = np.array([1.0, blood], dtype=self.fixed.dtype) @ self.fixed
        weights = np.concatenate([body * coefficients, lung * coefficients])
        return np.asarray(packed + weights.astype(self.moving.dtype) @ self.moving, dtype=float)

    def at_electrodes(self, state: BodyState) -> Floats:
        """The basis at the electrodes, less its mean over them (9, b)."""
        # on a larger trunk the same distance is a smaller part of the skin
        moved = state.chest / state.geometry[6]
        rows = np.empty((len(ELECTRODES), len(self.loads)))
        rows[:V1] = self.limbs
        for k, (left, up) in enumerate(moved):
            (i, a), (j, b) = _between(left, LEFT), _between(up, UP)
            near = self.chest[k]
            rows[V1 + k] = (1 - a) * ((1 - b) * near[i, j] + b * near[i, j + 1]) + a * (
                (1 - b) * near[i + 1, j] + b * near[i + 1, j + 1]
            )
        return np.asarray(rows - rows.mean(axis=0))

    def arrays(self) -> dict[str, Any]:
        """Every array, by its name, for files."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def _between(value: float, places: Floats) -> tuple[int, float]:
    """The interval of evenly spaced places that holds a value, and how far along it."""
    position = np.clip((value - places[0]) / SPACING, 0, len(places) - 1)
    index = min(int(position), len(places) - 2)
    return index, float(position - index)
