"""Edges, volumes and directions of small meshes, against values worked out by hand."""

import numpy as np
import pytest

from fascicle.mesh.measures import (
    HAMMER_STROUD_POINTS,
    barycentric_gradients,
    closed_by_fan,
    closed_volume,
    intersections,
    mean_edge_length,
    quality,
    self_intersections,
    signed_volumes,
    triangle_areas,
)
from fascicle.mesh.topology import TETRAHEDRON_FACES, directed_edges, unique_edges

CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # of a cube
REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]) / np.sqrt(8)
AWAY = CORNER + np.array([7.0, -3, 2])
FACES = TETRAHEDRON_FACES


def test_every_edge_of_a_tetrahedron_has_two_triangles():
    edges, count = unique_edges(FACES)
    assert edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert count.tolist() == [2] * 6
    # neighbours run along a common edge in opposite directions
    directed = {tuple(edge) for edge in directed_edges(FACES).tolist()}
    assert len(directed) == 12
    assert {(b, a) for a, b in directed} == directed


def test_volumes_of_the_corner_of_a_cube():
    assert signed_volumes(AWAY, np.array([[0, 1, 2, 3], [1, 0, 2, 3]])) == pytest.approx(
        [1 / 6, -1 / 6]
    )
    assert closed_volume(AWAY, FACES) == pytest.approx(1 / 6)
    assert closed_volume(AWAY, FACES[:, ::-1]) == pytest.approx(-1 / 6)
    assert closed_by_fan(AWAY, FACES[1:])[0] == pytest.approx(1 / 6)  # a flat opening adds nothing
    assert triangle_areas(AWAY, FACES) == pytest.approx([np.sqrt(3) / 2, 0.5, 0.5, 0.5])
    assert mean_edge_length(AWAY, FACES) == pytest.approx((1 + np.sqrt(2)) / 2)


def test_barycentric_coordinates_are_one_at_their_corner():
    rng = np.random.default_rng(0)
    vertices, corners = rng.normal(size=(4, 3)), np.array([[0, 1, 2, 3]])
    rises = barycentric_gradients(vertices, corners)[0] @ (vertices - vertices[0]).T
    assert rises == pytest.approx(np.eye(4) - np.eye(4)[:, :1])


def test_the_quadrature_is_exact_for_squares():
    x = (HAMMER_STROUD_POINTS @ CORNER)[:, 0]
    assert x.mean() == pytest.approx(1 / 4)
    assert (x**2).mean() == pytest.approx(1 / 10)  # 6 ∫ x² over the corner of the cube


def test_intersections_between_two_surfaces_only():
    low = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
    across = np.array([[1.0, 1, -1], [1, 1, 1], [3, 3, 1]])
    vertices = np.concatenate([low, across, across + np.array([0.1, 0.2, 0])])
    triangles = np.arange(9).reshape(3, 3)
    assert self_intersections(vertices, triangles).tolist() == [[0, 1], [0, 2]]
    found = intersections((vertices, triangles[:1]), (vertices, triangles[1:]))
    assert found.tolist() == [[0, 0], [0, 1]]


def test_shapes_of_a_regular_tetrahedron_and_of_the_corner_of_a_cube():
    found = quality(5 * REGULAR, np.array([[0, 1, 2, 3]]))
    assert found.angles.min() == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found.radius_ratios.min() == pytest.approx(1)
    assert found.edges.mean() == pytest.approx(5)
    assert found.volumes.sum() == pytest.approx(5**3 / (6 * np.sqrt(2)))
    found = quality(CORNER, np.array([[0, 1, 2, 3]]))
    assert found.angles.min() == pytest.approx(np.degrees(np.arccos(1 / np.sqrt(3))))
    assert found.radius_ratios.min() == pytest.approx(3 * (3 - np.sqrt(3)) / 6 / (np.sqrt(3) / 2))
    assert (found.edges.min(), found.edges.max()) == pytest.approx((1, np.sqrt(2)))
