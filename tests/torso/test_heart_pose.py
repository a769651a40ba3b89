from __future__ import annotations

import numpy as np
import pytest
from block_heart import CUBE, LV, RV, block_heart
from scipy.spatial.transform import Rotation

from fascicle.core.errors import InputError
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label
from fascicle.torso.heart_pose import (
    AZIMUTH,
    ELEVATION,
    body_frame,
    heart_axes,
    opening,
    standard_axes,
)
from fascicle.torso.surfaces import Surface

PLACE = np.array([33.0, -38.0, -5.0])


def cavities(rotation=None) -> tuple[Surface, Surface]:
    """Endocardia of the block heart, turned."""
    mesh = block_heart()
    turned = mesh.vertices if rotation is None else mesh.vertices @ rotation.T
    lv, rv = (mesh.having(label) for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM))
    return Surface(turned, lv), Surface(turned, rv)


def test_opening_is_in_the_middle_of_the_rim() -> None:
    lv, rv = cavities()
    for surface, (low, high) in ((lv, LV), (rv, RV)):
        middle = CUBE * (np.array(low) + high) / 2
        np.testing.assert_allclose(opening(surface), [*middle[:2], high[2] * CUBE], atol=1e-12)


def test_axes_of_a_known_heart(default_heart: Heart) -> None:
    """The packaged heart was put at these angles before it was meshed."""
    sides = (Surface(e.vertices, e.triangles) for e in default_heart.endocardia)
    _, axes = heart_axes(*sides)
    turn = Rotation.from_matrix(axes @ standard_axes().T).magnitude()
    assert np.degrees(turn) < 1.5  # which vertex is the apex depends on the mesh: edges of 3 mm


def test_axes_turn_with_the_heart() -> None:
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    origin, axes = heart_axes(*cavities())
    turned_origin, turned = heart_axes(*cavities(turn))
    np.testing.assert_allclose(turned, turn @ axes, atol=1e-12)
    np.testing.assert_allclose(turned_origin, turn @ origin, atol=1e-10)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_standard_pose_has_the_standard_angles() -> None:
    turn = Rotation.from_rotvec([2.0, 0.4, -0.5]).as_matrix()
    lv, rv = cavities(turn)
    centroid = lv.vertices.mean(axis=0)
    frame = body_frame(lv, rv, centroid, PLACE)
    origin, axes = heart_axes(lv, rv)
    x, y, z = -(frame.to_body(origin + axes[:, 2]) - frame.to_body(origin))  # to the apex
    assert np.arctan2(x, -y) == pytest.approx(AZIMUTH)
    assert np.arcsin(-z) == pytest.approx(ELEVATION)
    np.testing.assert_allclose(frame.to_body(centroid), PLACE, atol=1e-10)
    np.testing.assert_allclose(frame.to_heart(frame.to_body(lv.vertices)), lv.vertices, atol=1e-10)


@pytest.mark.parametrize(
    ("pose", "left", "back"), [("lps", [1, 0, 0], [0, 1, 0]), ("ras", [-1, 0, 0], [0, -1, 0])]
)
def test_poses_of_images_only_move(pose, left, back) -> None:
    """DICOM counts to the left and back, NIfTI to the right and front, both to the head."""
    to_image = np.diag([left[0], back[1], 1])
    lv, rv = cavities(to_image @ standard_axes() @ heart_axes(*cavities())[1].T)
    frame = body_frame(lv, rv, np.zeros(3), PLACE, pose)
    np.testing.assert_allclose(frame.to_heart(PLACE + np.eye(3)[0]), left, atol=1e-12)
    np.testing.assert_allclose(frame.to_heart(PLACE + np.eye(3)[1]), back, atol=1e-12)
    np.testing.assert_allclose(frame.to_heart(PLACE + np.eye(3)[2]), [0, 0, 1], atol=1e-12)
    # the apex then points to the left, the front and the feet
    _, axes = heart_axes(lv, rv)
    np.testing.assert_allclose(frame.rotation.T @ axes, standard_axes(), atol=1e-12)


def test_refuses_axes_that_cannot_be() -> None:
    lv, rv = cavities(standard_axes() @ heart_axes(*cavities())[1].T)
    with pytest.raises(InputError, match="the apex then points to the right and the back"):
        body_frame(lv, rv, np.zeros(3), PLACE, "ras")  # it is LPS
    with pytest.raises(InputError, match="'xyz' is unknown; use one of standard, ras, lps"):
        body_frame(lv, rv, np.zeros(3), PLACE, "xyz")  # type: ignore[arg-type]
