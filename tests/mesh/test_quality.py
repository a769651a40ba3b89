"""Shapes of tetrahedra against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.mesh.quality import quality

REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]) / np.sqrt(8)
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_a_regular_tetrahedron_has_the_best_shape():
    found = quality(5 * REGULAR, np.array([[0, 1, 2, 3]]))
    assert found.smallest_angle == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found.worst_radius_ratio == pytest.approx(1)
    assert found.mean_edge == pytest.approx(5)
    assert found.volume == pytest.approx(5**3 / (6 * np.sqrt(2)))


def test_the_corner_of_a_cube():
    found = quality(CORNER, np.array([[0, 1, 2, 3]]))
    assert found.smallest_angle == pytest.approx(np.degrees(np.arccos(1 / np.sqrt(3))))
    assert found.worst_radius_ratio == pytest.approx(3 * (3 - np.sqrt(3)) / 6 / (np.sqrt(3) / 2))
    assert (found.shortest_edge, found.longest_edge) == pytest.approx((1, np.sqrt(2)))


def test_a_flat_tetrahedron_counts_as_sharp():
    vertices = np.concatenate([CORNER, [[0.3, 0.3, -0.02]]])
    found = quality(vertices, np.array([[0, 1, 2, 3], [0, 2, 1, 4]]))
    assert found.sharp == 0.5
    assert found.smallest_angle < 5
    assert "50.00% below 10" in str(found)
    assert found.worst_radius_ratio < 0.1 < found.mean_radius_ratio
