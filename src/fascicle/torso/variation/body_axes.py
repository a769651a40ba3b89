"""The body's axes as the electrodes show them, and what moves the body around a heart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fascicle.core.arrays import Floats
from fascicle.mesh.measures import unit
from fascicle.torso.electrode_sites import LA, LL, RA


def body_axes(electrodes: Floats) -> Floats:
    """Directions of the body in the heart's coordinates, from the limb electrodes.

    RA and LA lie level, LL below them in the plane of the front: LL may lie to one side.

    Parameters
    ----------
    electrodes : (9, 3) array
        Positions (mm), in the order of `fascicle.core.leads.ELECTRODES`.

    Returns
    -------
    (3, 3) array
        Rows: to the patient's left, to the back, up; orthonormal and right-handed.
    """
    left = unit(electrodes[LA] - electrodes[RA])
    upwards = electrodes[[RA, LA]].mean(axis=0) - electrodes[LL]
    back = unit(np.cross(upwards, left))
    return np.stack([left, back, np.cross(left, back)])


@dataclass(frozen=True)
class Motion:
    """How the skin moves around a heart that stays: x → c + Rᵀ(s(x − c) − t).

    Attributes
    ----------
    centroid : (3,) array
        c, of the heart (mm).
    turn : (3, 3) array
        R: rotation of the heart about c, by a rotation vector along the body's axes.
    shift : (3,) array
        t: the heart's displacement in the chest (mm).
    size : float
        s: factor on the trunk about c.
    """

    centroid: Floats
    turn: Floats
    shift: Floats
    size: float

    @classmethod
    def of(cls, centroid: Floats, axes: Floats, geometry: Floats) -> Motion:
        """From displacements (mm) and rotations (rad) along the body's axes, and the size: (7,)."""
        turn = Rotation.from_rotvec(geometry[3:6] @ axes).as_matrix()
        return cls(centroid, turn, geometry[:3] @ axes, float(geometry[6]))

    def of_skin(self, points: Floats) -> Floats:
        """Where points (..., 3) that move with the skin are then (mm)."""
        return np.asarray(
            self.centroid + (self.size * (points - self.centroid) - self.shift) @ self.turn
        )

    def in_body(self, points: Floats) -> Floats:
        """The inverse: where points (..., 3) that move with the heart lie in the unmoved body."""
        moved = (points - self.centroid) @ self.turn.T + self.shift
        return np.asarray(self.centroid + moved / self.size)
