from dataclasses import replace

import numpy as np
import pytest
from block_heart import CUBE, LV, RV, block_heart
from scipy.spatial.transform import Rotation

from fascicle.core.errors import InputError
from fascicle.mesh.measures import solid_centroid
from fascicle.torso.heart_pose import (
    default_position,
    endocardial_surfaces,
    heart_axes,
    opening,
    standard_axes,
    torso_frame,
)
from fascicle.torso.surfaces import Surface
from fascicle.torso.trunk import TrunkSize

POSITION = default_position(TrunkSize())


def turned(rotation=None):
    """The block heart, turned, its axes, and the middle of its LV's opening."""
    mesh = block_heart()
    if rotation is not None:
        mesh = replace(mesh, vertices=mesh.vertices @ np.asarray(rotation).T)
    sides = endocardial_surfaces(mesh)
    return mesh, heart_axes(*sides), opening(sides[0])


def test_opening_is_in_the_middle_of_the_rim():
    for surface, (low, high) in zip(endocardial_surfaces(block_heart()), (LV, RV), strict=True):
        middle = CUBE * (np.array(low) + high) / 2
        np.testing.assert_allclose(opening(surface), [*middle[:2], high[2] * CUBE], atol=1e-12)


def test_axes_of_a_known_heart(default_heart):
    """The packaged heart was put at these angles before it was meshed."""
    axes = heart_axes(*(Surface(e.vertices, e.triangles) for e in default_heart.endocardia))
    turn = Rotation.from_matrix(axes @ standard_axes().T).magnitude()
    assert np.degrees(turn) < 1.5  # which vertex is the apex depends on the mesh: edges of 3 mm


def test_axes_turn_with_the_heart():
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    _, axes, origin = turned()
    _, other, other_origin = turned(turn)
    np.testing.assert_allclose(other, turn @ axes, atol=1e-12)
    np.testing.assert_allclose(other_origin, turn @ origin, atol=1e-10)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_standard_pose_has_the_standard_angles():
    mesh, axes, origin = turned(Rotation.from_rotvec([2.0, 0.4, -0.5]).as_matrix())
    frame = torso_frame(mesh, TrunkSize())
    x, y, z = -(frame.to_torso(origin + axes[:, 2]) - frame.to_torso(origin))  # to the apex
    assert np.arctan2(x, -y) == pytest.approx(np.radians(48))
    assert np.arcsin(-z) == pytest.approx(np.radians(38))
    centroid = solid_centroid(mesh.vertices, mesh.tetrahedra)
    np.testing.assert_allclose(frame.to_torso(centroid), POSITION, atol=1e-10)
    again = frame.to_heart(frame.to_torso(mesh.vertices))
    np.testing.assert_allclose(again, mesh.vertices, atol=1e-10)


@pytest.mark.parametrize(("pose", "to_image"), [("lps", [1, 1, 1]), ("ras", [-1, -1, 1])])
def test_poses_of_images_only_move(pose, to_image):
    """DICOM counts to the left and back, NIfTI to the right and front, both to the head."""
    to_image = np.diag(to_image)
    mesh, axes, _ = turned(to_image @ standard_axes() @ turned()[1].T)
    frame = torso_frame(mesh, TrunkSize(), pose)
    # to the left, back and up in the image
    steps = frame.to_heart(POSITION + np.eye(3)) - frame.to_heart(POSITION)
    np.testing.assert_allclose(steps, to_image, atol=1e-10)
    # the apex then points to the left, the front and the feet
    np.testing.assert_allclose(frame.rotation.T @ axes, standard_axes(), atol=1e-12)


def test_refuses_axes_that_cannot_be():
    mesh, _, _ = turned(standard_axes() @ turned()[1].T)
    with pytest.raises(InputError, match="the apex then points to the right and the back"):
        torso_frame(mesh, TrunkSize(), "ras")  # it is LPS
    with pytest.raises(InputError, match="'xyz' is unknown; use one of standard, ras, lps"):
        torso_frame(mesh, TrunkSize(), "xyz")
