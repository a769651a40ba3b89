"""Every tetrahedron in eight: nothing lost, nothing inverted, and no gaps between them."""

from __future__ import annotations

import numpy as np
import pytest
from builders import box

from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.refinement import CHILDREN, in_eight
from fascicle.mesh.topology import TETRAHEDRON_FACES, boundary_triangles


@pytest.fixture(scope="module")
def block():
    return box((20.0, 15.0, 10.0), (4, 3, 3), jitter=0.2)


@pytest.fixture(scope="module")
def finer(block):
    return in_eight(block.vertices, block.tetrahedra)


def test_each_child_has_an_eighth_of_the_volume(block, finer):
    volumes = signed_volumes(finer.vertices, finer.tetrahedra)
    np.testing.assert_allclose(volumes, np.repeat(block.volumes / 8, CHILDREN), rtol=1e-11)


def test_children_lie_in_their_parent(block, finer):
    """As the volumes add up, the children then fill it."""
    corners = block.vertices[block.tetrahedra]
    centres = finer.vertices[finer.tetrahedra].mean(axis=1).reshape(-1, CHILDREN, 3)
    offset = (centres - corners[:, :1])[..., None]
    axes = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inner = np.linalg.solve(axes[:, None], offset)[..., 0]
    assert inner.min() > 0
    assert inner.sum(axis=2).max() < 1


def test_conforming(block, finer):
    """Every face belongs to two tetrahedra, or to one and the boundary, which is the old one's."""
    faces = np.sort(finer.tetrahedra[:, TETRAHEDRON_FACES].reshape(-1, 3), axis=1)
    _, count = np.unique(faces, axis=0, return_counts=True)
    old, _ = boundary_triangles(block.tetrahedra)
    assert set(count) == {1, 2}
    assert (count == 1).sum() == 4 * len(old)
    assert np.unique(finer.tetrahedra).tolist() == list(range(len(finer.vertices)))


def test_new_vertices_are_midpoints_of_old_ones(block, finer):
    count = len(block.vertices)
    np.testing.assert_array_equal(finer.vertices[:count], block.vertices)
    middle = block.vertices[finer.edges].mean(axis=1)
    np.testing.assert_array_equal(finer.vertices[count:], middle)
    at_all = finer.at_vertices(np.stack([block.vertices[:, 0], 3 * block.vertices[:, 1]]))
    np.testing.assert_allclose(at_all, [finer.vertices[:, 0], 3 * finer.vertices[:, 1]])


@pytest.mark.parametrize("longest", [0, 1, 2])
def test_octahedron_is_cut_along_its_shortest_diagonal(longest):
    """The regular one's three are alike; stretched along one of them, the others are shorter."""
    tetrahedron = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    tetrahedron[:, longest] *= 3.0
    finer = in_eight(tetrahedron, np.array([[0, 2, 1, 3]]))
    pairs = finer.tetrahedra[:, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]].reshape(-1, 2)
    inner = finer.vertices[pairs].mean(axis=1)
    through_the_middle = pairs[np.abs(inner).max(axis=1) < 1e-12]
    ends = finer.vertices[through_the_middle]
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 2.0)
    assert len(ends) == 4
