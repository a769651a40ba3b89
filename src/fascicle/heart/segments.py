"""Where in the ventricles: the wall, the depth in it, and the 17 segments of the left ventricle.

The segments are those of the American Heart Association (M. D. Cerqueira et al., Circulation 105,
2002): thirds of the long axis from the mitral opening to the end of the cavity, of which the basal
and the middle one have six sectors of 60° and the apical one four of 90°; what lies beyond the
cavity is the apex. Sectors are counted from the middle of the septum, where the standard counts
from the attachments of the right ventricle: two of 60° are septal, whatever the septum spans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats, Integers
from fascicle.heart.boundary_labels import labelled_mesh
from fascicle.heart.endocardium import long_axis
from fascicle.heart.fibres.laplace import quadratic_space
from fascicle.heart.fibres.rules import Wall, wall_and_depth, wall_potentials
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import unit

SEGMENTS = (
    "basal anterior",
    "basal anteroseptal",
    "basal inferoseptal",
    "basal inferior",
    "basal inferolateral",
    "basal anterolateral",
    "mid anterior",
    "mid anteroseptal",
    "mid inferoseptal",
    "mid inferior",
    "mid inferolateral",
    "mid anterolateral",
    "apical anterior",
    "apical septal",
    "apical inferior",
    "apical lateral",
    "apex",
)
RIGHT = 0  # instead of a segment's number: the free wall of the right ventricle
APEX = 17
# Segments by sixths of the way round, from the middle of the septum over the anterior wall, and by
# quarters, the first of which has the middle of the septum in its middle
SIXTHS = np.array([2, 1, 6, 5, 4, 3])
QUARTERS = np.array([14, 13, 16, 15])


@dataclass(frozen=True)
class Places:
    """Where in the ventricles each tetrahedron is.

    Attributes
    ----------
    segment : (m,) array
        Segment of the left ventricle, 1 to 17, its half of the septum and the right one's alike;
        0 in the free wall of the right ventricle.
    wall : (m,) array
        A `Wall` for each.
    depth : (m,) array
        0 on the endocardium, 1 on the epicardium; in the septum, 0 on the left, 1 on the right.
    height : (m,) array
        Along the left ventricle's long axis: 0 at the mitral opening, 1 at the end of the cavity.
    angle : (m,) array
        About that axis (rad), 0 in the middle of the septum, positive over the anterior wall: seen
        from the apex, clockwise.
    """

    segment: Integers
    wall: Integers
    depth: Floats
    height: Floats
    angle: Floats


def places(heart: Heart) -> Places:
    """Find where in the ventricles each tetrahedron of a heart is (seconds, on a fine mesh more).

    Raises
    ------
    InputError
        If a surface of the heart is missing.
    """
    mesh = labelled_mesh(heart)
    potentials, _ = wall_potentials(quadratic_space(mesh.vertices, mesh.tetrahedra), mesh)
    wall, depth = wall_and_depth(potentials)
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    away = heart.vertices[heart.tetrahedra].mean(axis=1) - base
    down = unit(apex - base)
    height = away @ down / np.linalg.norm(apex - base)
    around = away - np.outer(away @ down, down)
    in_septum = (wall == Wall.SEPTUM) & (height < 1)
    septal = unit(heart.volumes[in_septum] @ unit(around[in_septum]))
    angle = np.arctan2(around @ np.cross(septal, down), around @ septal)
    segment = np.where(wall == Wall.RV, RIGHT, _segment(height, angle))
    return Places(segment, wall, depth, height, angle)


def _segment(height: Floats, angle: Floats) -> Integers:
    turn = angle / (2 * np.pi)
    sixth = SIXTHS[np.floor(6 * turn).astype(int) % 6]
    quarter = QUARTERS[np.floor(4 * turn + 0.5).astype(int) % 4]
    third = np.floor(3 * height)
    return np.select([third < 1, third < 2, third < 3], [sixth, 6 + sixth, quarter], APEX)
