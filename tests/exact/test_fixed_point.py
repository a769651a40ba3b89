"""The sweep ends at a solution of the discrete problem: nothing can be lowered any more."""

from __future__ import annotations

import numpy as np
import pytest
from builders import (
    OBLIQUE,
    activate,
    box_tissue,
    conduction_for,
    offers,
    solve_without_trees,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.eikonal.tissue import EDGES, OTHERS, _reach
from fascicle.kernels.local_solver import from_new_corner
from fascicle.parameters import EXAMPLE_PARAMETERS

TOLERANCE = 1e-9  # ms
SPEEDS = {"isotropic": (0.6, 0.6), "usual": (0.6, 0.25), "strong": (1.0, 0.1)}  # mm/ms


@pytest.mark.parametrize("speeds", SPEEDS)
@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_vertices_of_a_cube_solve_the_discrete_equation(jitter, speeds):
    """From two stimuli, both ways: no vertex is too late, and none earlier than it can be."""
    conduction = conduction_for(*SPEEDS[speeds])
    tissue = box_tissue(20.0, 10, jitter=jitter, fibre=OBLIQUE, conduction=conduction)
    stimuli = {0: 0.0, 700: 13.0}
    time = solve_without_trees(tissue, stimuli)
    offered = offers(tissue, time)
    assert np.max(time - offered) < TOLERANCE
    reached = np.setdiff1d(np.arange(len(time)), list(stimuli))
    assert np.max(offered[reached] - time[reached]) < TOLERANCE


@pytest.mark.parametrize("speeds", SPEEDS)
def test_no_vertex_can_be_lowered_after_rays(speeds):
    """Rays are earlier than the mesh's own solution, so one way only."""
    conduction = conduction_for(*SPEEDS[speeds])
    tissue = box_tissue(20.0, 7, jitter=0.25, fibre=OBLIQUE, conduction=conduction)
    rng = np.random.default_rng(2)
    activation = activate(
        tissue, [], [], 1.0, stimuli=rng.uniform(0, 20, (8, 3)), times=rng.uniform(0, 20, 8)
    )
    assert np.max(activation.myocardium - offers(tissue, activation.myocardium)) < TOLERANCE


@pytest.mark.parametrize("model", ["default_model", "crtdemo_model"])
@pytest.mark.parametrize("root_time", [-20.0, -200.0])
def test_no_vertex_of_a_heart_can_be_lowered(model, root_time, request):
    """After the coupled sweep, with both trees and with the left one entered backwards."""
    model = request.getfixturevalue(model)
    time = model.simulate(EXAMPLE_PARAMETERS | {"root_time": root_time}).activation
    assert np.max(time - offers(model.tissue, time)) < TOLERANCE


def test_order_of_stimuli_does_not_matter():
    tissue = box_tissue(20.0, 8, jitter=0.2, fibre=OBLIQUE)
    stimuli = {3: 1.0, 200: 0.0, 500: 4.0}
    forwards = solve_without_trees(tissue, stimuli)
    backwards = solve_without_trees(tissue, dict(reversed(stimuli.items())))
    np.testing.assert_allclose(forwards, backwards, atol=TOLERANCE, rtol=0)


def random_tetrahedra(seed, thickness, count):
    """Corners (count, 4, 3) in a space where the metric is the identity, and squared edges."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-5, 5, (count, 4, 3))
    corners[:, :, 2] *= thickness
    edges = np.stack([corners[:, j] - corners[:, i] for i, j in EDGES], axis=1)
    return corners, (edges**2).sum(axis=2), rng


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 0.2, 0.02]))
@settings(max_examples=30, deadline=None)
def test_reach_is_the_least_projection_on_directions_of_the_cone(seed, thickness):
    """For a front that comes to x along v through the face: x is later than s by v·(x − s).

    Random directions in the cone never fall below `_reach`; the best of them and of those in the
    cone's sides come near it, so the bound is the least there is.
    """
    corners, squares, rng = random_tetrahedra(seed, thickness, 20)
    reach = _reach(squares)
    shares = rng.dirichlet((0.5, 0.5, 0.5), 2000)
    side = np.linspace(0, 1, 2001)[:, None] * [[0.0, 1.0, -1.0]] + [[0.0, 0.0, 1.0]]
    shares = np.concatenate([shares, *(np.roll(side, k, axis=1) for k in range(3))])
    for s in range(4):
        for turn, x in enumerate(OTHERS[s]):
            from_x = corners[:, OTHERS[x]] - corners[:, [x]]
            reverse = np.einsum("dk,mki->mdi", shares, from_x)
            reverse /= np.linalg.norm(reverse, axis=2, keepdims=True)
            delays = np.einsum("mdi,mi->md", reverse, corners[:, s] - corners[:, x])
            least, longest = delays.min(axis=1), np.sqrt(squares.max(axis=1))
            assert (least >= reach[:, s, turn] - 1e-9 * longest).all()
            assert (least <= reach[:, s, turn] + 0.02 * longest).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 0.2, 0.02]), st.floats(0.0, 10.0))
@settings(max_examples=50, deadline=None)
def test_pruning_bounds_never_exceed_a_winning_update(seed, thickness, latest):
    """What the local solver offers is never below s + reach nor below the earliest + height."""
    corners, squares, rng = random_tetrahedra(seed, thickness, 50)
    reach = _reach(squares)
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    for m in np.flatnonzero(volume > 1e-3):
        s, turn = rng.integers(4), rng.integers(3)
        x = OTHERS[s][turn]
        j, k = (c for c in OTHERS[s] if c != x)
        e = corners[m, [s, j, k]] - corners[m, x]
        gram, t = e @ e.T, rng.uniform(0, latest, 3)
        arrival = from_new_corner(
            gram[0, 0], gram[0, 1], gram[0, 2], gram[1, 1], gram[1, 2], gram[2, 2], *t
        )
        height = volume[m] / np.linalg.norm(np.cross(e[1] - e[0], e[2] - e[0]))
        assert arrival >= t.min() + height - 1e-9
        # unless the minimum is on the rim away from s, which was known before s had its time
        rest = from_new_corner(
            gram[1, 1], gram[1, 2], gram[1, 0], gram[2, 2], gram[2, 0], gram[0, 0],
            t[1], t[2], np.inf,
        )  # fmt: skip
        rest = min(rest, t[2] + np.sqrt(gram[2, 2]))
        if arrival < rest - 1e-9:
            assert arrival >= t[0] + reach[m, s, turn] - 1e-9
