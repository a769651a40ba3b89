"""Ventricular coordinates as point arrays of a mesh, Cobiveco's or universal ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.ranges import short_repr
from fascicle.mesh.checks import refuse
from fascicle.mesh.formats.mesh_file import TETRAHEDRON, MeshFile

NAMES = ("tv", "tm", "rt", "ab")  # as Cobiveco writes them
UNIVERSAL = ("v", "rho", "phi", "z")
WALL = 0.1  # thickness of a wall in `places`; the way from apex to base is 1


@dataclass(frozen=True)
class VentricularCoordinates:
    """Ventricular coordinates of each vertex (n,), as `fascicle.heart.coordinates` defines them.

    The ventricle is 0 in the left, 1 in the right one; the others are from 0 to 1.
    """

    ventricle: Floats
    transmural: Floats
    rotational: Floats
    apicobasal: Floats

    __repr__ = short_repr

    @property
    def arrays(self) -> dict[str, Floats]:
        """Coordinates by `NAMES`."""
        values = (self.ventricle, self.transmural, self.rotational, self.apicobasal)
        return dict(zip(NAMES, values, strict=True))

    @property
    def places(self) -> Floats:
        """Positions (n, 3) in a disk for each ventricle, apex in the middle, as thick as `WALL`."""
        turn = 2 * np.pi * self.rotational
        around = self.apicobasal * np.array([np.cos(turn), np.sin(turn)])
        return np.column_stack([*around, WALL * self.transmural])


def read_coordinates(mesh: MeshFile) -> VentricularCoordinates | None:
    """Ventricular coordinates of the vertices of a mesh's tetrahedra, if it has the point arrays.

    The arrays are ``tv``, ``tm``, ``rt`` (or ``rtSin`` and ``rtCos``) and ``ab`` of Cobiveco, or
    ``v``, ``rho``, ``phi`` and ``z`` of `from_universal`, in upper or lower case; all four. An
    error if one is not a number a point, or out of range.
    """
    arrays = {name.lower(): values for name, values in mesh.point_data.items()}
    used = used_points(mesh)
    if {"rtsin", "rtcos"} <= set(arrays) and "rt" not in arrays:
        arrays["rt"] = np.arctan2(arrays["rtsin"], arrays["rtcos"]) / (2 * np.pi) % 1
    if set(NAMES) <= set(arrays):
        return VentricularCoordinates(*(_checked(mesh, arrays, used, name, 0, 1) for name in NAMES))
    if not set(UNIVERSAL) <= set(arrays):
        return None
    limits = {"v": (-1, 1), "phi": (-np.pi, np.pi)}
    v, *rho_phi_z = (
        _checked(mesh, arrays, used, name, *limits.get(name, (0, 1))) for name in UNIVERSAL
    )
    if np.ptp(v) == 0:
        raise InputError(
            f"{mesh.path}: the point array 'v' of ventricular coordinates is {v[0]:g} everywhere; "
            "give -1 in the left and 1 in the right ventricle, or remove it"
        )
    return from_universal(v, *rho_phi_z)


def used_points(mesh: MeshFile) -> Integers:
    """Points of a file (n,) that are vertices of its tetrahedra."""
    return np.unique(mesh.cells[TETRAHEDRON])


def _checked(
    mesh: MeshFile, arrays: Mapping[str, Floats], used: Integers, name: str, low: float, high: float
) -> Floats:
    """Values of an array at the used points, clipped to its range; an error if far outside."""
    values, among = np.asarray(arrays[name], dtype=float), "to"
    if values.shape != (len(mesh.points),):
        raise InputError(
            f"{mesh.path}: the point array '{name}' has shape {values.shape}; ventricular "
            "coordinates are one number a point; correct or remove it"
        )
    values = values[used]
    slack = 1e-3 * (high - low)  # interpolation rounds
    bad = ~((values >= low - slack) & (values <= high + slack))
    if name in ("tv", "v"):
        bad, among = ~np.isin(values, (low, high)), "or"
    refuse(
        f"{mesh.path}: the point array '{name}' of ventricular coordinates",
        bad,
        f"values are not {low:.4g} {among} {high:.4g}, as {values[np.argmax(bad)]:.4g}",
        "correct them, or remove the array to have them computed",
        mesh.points[used],
        numbers=used,
    )
    return values.clip(low, high)


def from_universal(v: Floats, rho: Floats, phi: Floats, z: Floats) -> VentricularCoordinates:
    """Convert universal ventricular coordinates (n,) to those of Cobiveco.

    Universal coordinates are those of Bayer et al. 2018, Med Image Anal 45:83-93: v −1 in the left,
    1 in the right ventricle; ρ 0 on the endocardium, 1 on the epicardium; φ from −π to π in the
    left ventricle, to which the septum belongs, and in the right one from its posterior attachment
    to the anterior one; z 0 at the apex, 1 at the base. Their apex, the left ventricle's, is kept.
    """
    right = v > 0
    behind, before = phi[right].min(), phi[right].max()
    way = (phi - behind) / (before - behind)
    septal = ~right & (way >= 0) & (way <= 1)
    # in the left free wall from the anterior attachment on to the posterior one
    back = (phi - before) % (2 * np.pi) / (2 * np.pi - before + behind)
    return VentricularCoordinates(
        (right | (septal & (rho > 0.5))).astype(float),
        np.where(septal, np.abs(1 - 2 * rho), 1 - rho),
        np.where(septal, 1 - way / 3, 2 / 3 * np.where(right, way, 1 - back)),
        z,
    )
