"""Pose of a heart in the torso: its anatomical axes, and the torso's axes around it.

Torso frame (mm): x to the patient's left, y to the back, z to the head; the origin lies on the axis
of the trunk, at the level of the fourth intercostal space at the sternum. Its axes are those of
DICOM's LPS frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import ENDOCARDIA, LabelledMesh
from fascicle.mesh.measures import solid_centroid, triangle_areas, unit
from fascicle.mesh.topology import boundary_loops
from fascicle.torso.surfaces import Surface
from fascicle.torso.trunk import TrunkSize

Pose = Literal["standard", "ras", "lps"]


@dataclass(frozen=True)
class TorsoFrame:
    """The rigid motion between the heart's coordinates and the torso frame.

    The columns of the rotation (3, 3) are the torso's axes in the heart's coordinates; the origin
    (3,) is that of the torso frame, in the heart's coordinates (mm).
    """

    rotation: Floats
    origin: Floats

    def to_torso(self, points: Floats) -> Floats:
        """Convert points (..., 3) from the heart's to the torso's coordinates."""
        return np.asarray((points - self.origin) @ self.rotation)

    def to_heart(self, points: Floats) -> Floats:
        """Convert points (..., 3) from the torso's to the heart's coordinates."""
        return np.asarray(points @ self.rotation.T + self.origin)


def endocardial_surfaces(mesh: LabelledMesh) -> tuple[Surface, Surface]:
    """Left and right endocardium."""
    lv, rv = (Surface(*mesh.part(label)) for label in ENDOCARDIA)
    return lv, rv


def heart_axes(lv: Surface, rv: Surface) -> Floats:
    """Anatomical axes of a heart, from the shape of its endocardia, open at the base.

    Columns (3, 3): from the LV to the RV; to the anterior-superior side of the septum; from the LV
    apex, the point furthest from the opening, to the middle of the opening. Right-handed, whether
    the heart is mirrored or not; the first is made orthogonal to the last.
    """
    base = opening(lv)
    used = lv.vertices[np.unique(lv.triangles)]
    long_axis = unit(base - used[np.argmax(np.linalg.norm(used - base, axis=1))])
    across = surface_middle(rv) - surface_middle(lv)
    across = unit(across - (across @ long_axis) * long_axis)
    return np.stack([across, np.cross(long_axis, across), long_axis], axis=1)


def opening(surface: Surface) -> Floats:
    """Middle of the openings of a surface (3,), mm: the mean along its boundary loops."""
    loops = boundary_loops(surface.triangles)
    start = np.concatenate([surface.vertices[loop] for loop in loops])
    end = np.concatenate([surface.vertices[np.roll(loop, -1)] for loop in loops])
    length = np.linalg.norm(end - start, axis=1)
    return np.asarray(np.average((start + end) / 2, axis=0, weights=length))


def surface_middle(surface: Surface) -> Floats:
    """Centroid of a surface; (3,), mm."""
    centres = surface.corners.mean(axis=1)
    return np.asarray(np.average(centres, axis=0, weights=triangle_areas(*surface)))


def standard_axes(azimuth: float = 48.0, elevation: float = 38.0, roll: float = 0.0) -> Floats:
    """The axes of `heart_axes` in the torso frame, for a heart in the standard pose; (3, 3).

    The long axis points to the left, to the front and down, at about 45 degrees to the three planes
    of the torso (common anatomical knowledge; these figures are those of the packaged heart). The
    LV and the RV lie side by side: the axis from one to the other is horizontal.

    Parameters
    ----------
    azimuth, elevation : float
        Angles of the long axis: from straight ahead to the patient's left, and below the horizontal
        plane (degrees).
    roll : float
        Rotation about the long axis, right-handed from apex to base (degrees).
    """
    ce, se = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
    ca, sa = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    apex_to_base = np.array([-ce * sa, ce * ca, se])
    across = np.array([-ca, -sa, 0.0])
    turn = np.radians(roll)
    lv_to_rv = np.cos(turn) * across + np.sin(turn) * np.cross(apex_to_base, across)
    return np.stack([lv_to_rv, np.cross(apex_to_base, lv_to_rv), apex_to_base], axis=1)


def default_position(size: TrunkSize) -> Floats:
    """Default position of the myocardium's centroid in the torso frame (mm); (3,).

    The valves' surface projections put the middle of the LV base half an intercostal space above
    the fourth, and the apex into the fifth, at the midclavicular line; skin to heart: Rahko 2008,
    J Am Soc Echocardiogr 21:761-764 (parasternal 32 mm, apical 31 mm).
    """
    return np.array([33.0, -0.335 * size.half_depth, -5.0])


def torso_frame(mesh: LabelledMesh, size: TrunkSize, pose: Pose = "standard") -> TorsoFrame:
    """Lay the axes of an idealised torso around a heart (mm), which itself stays where it is.

    In the "standard" pose they follow from the heart's axes, which are given the standard angles.
    In "ras" and "lps" they are those of the image that the heart comes from: NIfTI's RAS+ counts to
    the right, front and up, DICOM's LPS+ to the left, back and up; an error if `check_apex` refuses
    them.
    """
    if pose == "standard":
        rotation = heart_axes(*endocardial_surfaces(mesh)) @ standard_axes().T
    elif pose in ("ras", "lps"):
        rotation = np.diag([-1.0, -1.0, 1.0]) if pose == "ras" else np.eye(3)
        check_apex(f"pose '{pose}'", rotation, *endocardial_surfaces(mesh))
    else:
        raise InputError(f"pose: '{pose}' is unknown; use one of standard, ras, lps")
    centroid = solid_centroid(mesh.vertices, mesh.tetrahedra)
    return TorsoFrame(rotation, centroid - rotation @ default_position(size))


def axes_of_electrodes(electrodes: Floats, sites: Floats) -> Floats:
    """Torso axes by the electrodes: those that put the standard sites nearest to them.

    The columns (3, 3) in the heart's coordinates, for electrodes (9, 3) there and sites (9, 3) in
    the torso frame: the rotation of least squares (Kabsch 1976, Acta Cryst A32:922-923).
    """
    around = electrodes - electrodes.mean(axis=0)
    rotation, _ = Rotation.align_vectors(around, sites - sites.mean(axis=0))
    return np.asarray(rotation.as_matrix())


def check_apex(source: str, rotation: Floats, lv: Surface, rv: Surface) -> None:
    """Refuse torso axes in which the apex points to two of right, back and head.

    One of them alone may be right, as hearts differ: a vertical heart points hardly to the left, a
    horizontal one hardly down.
    """
    left, back, up = -rotation.T @ heart_axes(lv, rv)[:, 2]
    directions = {"right": -left, "back": back, "head": up}
    if len(wrong := [name for name, component in directions.items() if component > 0]) > 1:
        raise InputError(
            f"{source}: the apex then points to the {' and the '.join(wrong)}, where none does; "
            "check the axes (RAS or LPS)"
        )
