"""Junctions on the tissue's surface: from the endocardium's triangle as by a search of all."""

from dataclasses import replace

import igl
import numpy as np
import pytest

from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.eikonal.myocardium import Candidates, attach
from fascicle.kernels.nearest_triangle import nearest_of


def nearest(points, vertices, surface, candidates, rows):
    found = np.full((len(points), 3), np.nan), np.full(len(points), -1), np.full(len(points), -1.0)
    return nearest_of(points, rows, candidates, vertices, surface, *found), *found


def all_of(surface, *, radius):
    """One row, around the origin, whose candidates are all triangles."""
    every = np.arange(len(surface))
    return Candidates(
        np.array([0, len(every)]), every, np.full(len(every), -np.inf), np.zeros((1, 3)),
        np.array([radius**2]),
    )  # fmt: skip


def test_nearest_points_are_those_of_libigl():
    """From all sides of separate triangles: beside corners, beside edges, above and on them."""
    rng = np.random.default_rng(0)
    for size in (1, 1, 1, 1, 1, 30):
        vertices = rng.normal(size=(3 * size, 3))
        surface = np.arange(3 * size).reshape(-1, 3)
        on_them = np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], size), vertices[surface])
        points = np.concatenate([rng.uniform(-3, 3, (2000, 3)), vertices, on_them])
        square, _, expected = igl.point_mesh_squared_distance(points, vertices, surface)
        rows = np.zeros(len(points), np.int64)
        done, found, triangles, squares = nearest(
            points, vertices, surface, all_of(surface, radius=100.0), rows
        )
        assert done
        np.testing.assert_allclose(squares, square, rtol=1e-9, atol=1e-18)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        own = np.array([
            igl.point_mesh_squared_distance(point[None], vertices, surface[[triangle]])[0]
            for point, triangle in zip(points[:50], triangles[:50], strict=True)
        ]).ravel()  # fmt: skip
        np.testing.assert_allclose(own, square[:50], rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("row", [-1, 1, 0])
def test_points_outside_their_ball_are_left_alone(row):
    surface = np.array([[0, 1, 2]])
    done, *rest = nearest(
        np.array([[1.1, 0.0, 0.0]]), np.eye(3), surface, all_of(surface, radius=1.0),
        np.array([row]),
    )  # fmt: skip
    assert not done
    assert np.isnan(rest[0]).all()


def test_candidates_hold_the_nearest_of_every_point_of_a_ball(default_model):
    """Also of points that are off the surface, as those of another endocardium's are."""
    prepared, rng = default_model.prepared, np.random.default_rng(0)
    myocardium = prepared.myocardium
    for side in prepared.charts:
        candidates = myocardium.candidates[side]
        rows = rng.integers(len(candidates.square), size=4000)
        direction = rng.normal(size=(len(rows), 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        far = np.sqrt(candidates.square[rows]) * rng.uniform(0, 0.999999, len(rows))
        points = candidates.centre[rows] + far[:, None] * direction
        done, found, _, squares = nearest(
            points, myocardium.mesh.vertices, myocardium.surface, candidates, rows
        )
        assert done
        expected = myocardium.on_surface(points)
        assert expected.distances.max() > 0.3
        np.testing.assert_allclose(np.sqrt(squares), expected.distances, atol=1e-9)
        away = np.linalg.norm(found - points, axis=1)
        np.testing.assert_allclose(away, expected.distances, atol=1e-9)


def test_grown_trees_are_attached_as_others(default_model):
    """And so are those that say they were grown where they are not, or have another name."""
    trees = default_model.grow(EXAMPLE_PARAMETERS)
    myocardium = default_model.prepared.myocardium
    expected = attach(myocardium, [replace(tree, triangles=None) for tree in trees])
    elsewhere = [replace(tree, triangles=np.roll(tree.triangles, 100)) for tree in trees]
    unequal = [replace(tree, triangles=tree.triangles[:-1]) for tree in trees]
    named = [replace(tree, side=f"my {tree.side}") for tree in trees]
    for given in (trees, elsewhere, unequal, named):
        found = attach(myocardium, given)
        np.testing.assert_array_equal(found.located.triangles, expected.located.triangles)
        np.testing.assert_array_equal(found.located.elements, expected.located.elements)
        np.testing.assert_allclose(found.located.positions, expected.located.positions, atol=1e-9)
        np.testing.assert_allclose(found.sites.to_corner, expected.sites.to_corner, atol=1e-9)


def test_junctions_of_grown_trees_are_not_searched_for(default_model, monkeypatch):
    trees = default_model.grow(EXAMPLE_PARAMETERS)
    trees = [*trees, replace(trees[1], side="mine")]
    myocardium = default_model.prepared.myocardium
    monkeypatch.setattr(type(myocardium), "on_surface", None)
    assert len(attach(myocardium, trees).located.positions) == sum(
        len(tree.junctions) for tree in trees
    )
