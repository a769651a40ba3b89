"""Laplace's equation against exact solutions."""

from __future__ import annotations

import numpy as np
import pytest
from builders import box

from fascicle.heart.laplace import QuadraticSpace, quadratic_space, solve_laplace


def cube(cells: int) -> QuadraticSpace:
    """The unit cube, its cells cut into six tetrahedra around one diagonal each."""
    block = box(1.0, cells)
    return quadratic_space(block.vertices, block.tetrahedra)


def nodes_of(space: QuadraticSpace) -> np.ndarray:
    return np.concatenate([space.vertices, space.vertices[space.edges].mean(axis=1)])


def solve_with_boundary(space: QuadraticSpace, exact) -> np.ndarray:
    nodes = nodes_of(space)
    outer = np.flatnonzero(np.any((nodes == 0) | (nodes == 1), axis=1))
    return solve_laplace(space, outer, exact(nodes[outer])[None])[0]


def test_a_quadratic_harmonic_function_is_found_exactly():
    space = cube(4)
    solution = solve_with_boundary(space, lambda x: x[:, 0] ** 2 - x[:, 1] ** 2 + x[:, 2])
    values, gradients = space.at_centroids(solution)
    middle = space.vertices[space.tetrahedra].mean(axis=1)
    expected = np.stack([2 * middle[:, 0], -2 * middle[:, 1], np.ones(len(middle))], axis=1)
    np.testing.assert_allclose(
        values, middle[:, 0] ** 2 - middle[:, 1] ** 2 + middle[:, 2], atol=1e-5
    )
    np.testing.assert_allclose(gradients, expected, atol=1e-4)


def test_gradients_converge_with_the_second_power_of_the_edge():
    def exact(x):
        return np.exp(2 * x[:, 0]) * np.sin(2 * x[:, 1])

    errors = []
    for cells in (4, 8):
        space = cube(cells)
        _, gradients = space.at_centroids(solve_with_boundary(space, exact))
        x, y, _ = space.vertices[space.tetrahedra].mean(axis=1).T
        expected = 2 * np.exp(2 * x) * np.stack([np.sin(2 * y), np.cos(2 * y), 0 * x])
        errors.append(np.sqrt(np.mean((gradients - expected.T) ** 2)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


def test_no_flux_passes_a_side_where_nothing_is_given():
    space = cube(3)
    nodes = nodes_of(space)
    ends = np.flatnonzero((nodes[:, 2] == 0) | (nodes[:, 2] == 1))
    solution = solve_laplace(space, ends, nodes[ends, 2][None])[0]
    np.testing.assert_allclose(solution, nodes[:, 2], atol=1e-5)


def test_the_stiffness_agrees_with_scikit_fem():
    import skfem
    from skfem.models.poisson import laplace

    space = cube(2)
    mesh = skfem.MeshTet(space.vertices.T.copy(), space.tetrahedra.T.copy())
    basis = skfem.Basis(mesh, skfem.ElementTetP2(), intorder=2)
    other = laplace.assemble(basis)
    nodes = nodes_of(space)
    match = np.lexsort(np.round(nodes, 6).T)[np.argsort(np.lexsort(np.round(basis.doflocs, 6)))]
    mine = space.stiffness[match][:, match]
    np.testing.assert_allclose(mine.toarray(), other.toarray(), atol=1e-12)
