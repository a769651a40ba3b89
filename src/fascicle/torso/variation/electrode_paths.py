"""Where chest electrodes come to lie when they are moved along the skin."""

from __future__ import annotations

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.torso.electrode_sites import V1
from fascicle.torso.lead_fields import Contacts, contacts_on

SPACING = 6.0  # mm, of the places along each way; skins have edges of some 11 mm
SUBSTEPS = 3  # between two places; each is put back onto the skin
# Beyond the 25 mm of one electrode over a chest of 0.85; upwards also the 40 mm of all together
LEFT: Floats = SPACING * np.arange(-5.0, 6.0)
UP: Floats = SPACING * np.arange(-13.0, 14.0)


def electrode_places(
    vertices: Floats, skin: Integers, electrodes: Floats, axes: Floats
) -> Contacts:
    """Contacts of the limb electrodes, then of V1 to V6 at every place of a grid along the skin.

    From where an electrode is, it goes up or down along the skin first, then horizontally.

    Parameters
    ----------
    vertices : (n, 3) array
        The mesh (mm).
    skin : (t, 3) array
        Triangles of the skin.
    electrodes : (9, 3) array
        Positions (mm).
    axes : (3, 3) array
        Directions to the left, back and up.

    Returns
    -------
    Contacts
        3 + 6 · len(LEFT) · len(UP) of them: by electrode, then to the left, then up.
    """
    walk = _Walk(vertices, skin)
    limbs, chest = np.split(np.ascontiguousarray(electrodes, dtype=float), [V1])
    rows = walk.line(chest, axes[2], UP)  # (up, 6, 3)
    grid = walk.line(rows.reshape(-1, 3), axes[0], LEFT).reshape(len(LEFT), len(UP), len(chest), 3)
    places = np.concatenate([limbs, grid.transpose(2, 0, 1, 3).reshape(-1, 3)])
    return walk.contacts(places)


class _Walk:
    """Steps along a skin."""

    def __init__(self, vertices: Floats, skin: Integers) -> None:
        self.vertices, self.skin = vertices, skin
        self.normals = np.zeros_like(vertices)  # weighted by areas
        for corner in skin.T:
            np.add.at(self.normals, corner, triangle_normals(vertices, skin))

    def contacts(self, points: Floats) -> Contacts:
        """The nearest points of the skin."""
        return contacts_on(self.vertices, self.skin, points)

    def line(self, start: Floats, direction: Floats, places: Floats) -> Floats:
        """Points (places, n, 3) at such distances (mm) along the skin from the start (n, 3)."""
        reached = np.empty((len(places), *start.shape))
        origin = int(np.argmin(np.abs(places)))
        reached[origin] = self._put(start)[0]
        for sign in (1, -1):
            point = reached[origin]
            k = origin + sign
            while 0 <= k < len(places):
                length = abs(places[k] - places[k - sign]) / SUBSTEPS
                for _ in range(SUBSTEPS):
                    point = self._step(point, sign * direction, length)
                reached[k] = point
                k += sign
        return reached

    def _step(self, points: Floats, direction: Floats, length: float) -> Floats:
        on_skin, normal = self._put(points)
        along = direction - (normal @ direction)[:, None] * normal
        return self._put(on_skin + length * unit(along))[0]

    def _put(self, points: Floats) -> tuple[Floats, Floats]:
        """Nearest points of the skin, and its normals there."""
        found = self.contacts(points)
        weights = found.weights[:, :, None]
        there = (weights * self.vertices[found.triangles]).sum(axis=1)
        return there, unit((weights * self.normals[found.triangles]).sum(axis=1))
