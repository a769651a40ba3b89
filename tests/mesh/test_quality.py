"""Shapes of tetrahedra against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.mesh.quality import quality

REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]) / np.sqrt(8)
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_a_regular_tetrahedron_has_the_best_shape():
    found = quality(5 * REGULAR, np.array([[0, 1, 2, 3]]))
    assert found.angles.min() == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found.radius_ratios.min() == pytest.approx(1)
    assert found.edges.mean() == pytest.approx(5)
    assert found.volumes.sum() == pytest.approx(5**3 / (6 * np.sqrt(2)))


def test_the_corner_of_a_cube():
    found = quality(CORNER, np.array([[0, 1, 2, 3]]))
    assert found.angles.min() == pytest.approx(np.degrees(np.arccos(1 / np.sqrt(3))))
    assert found.radius_ratios.min() == pytest.approx(3 * (3 - np.sqrt(3)) / 6 / (np.sqrt(3) / 2))
    assert (found.edges.min(), found.edges.max()) == pytest.approx((1, np.sqrt(2)))
