"""The sweep ends at a solution of the discrete problem: nothing can be lowered any more."""

from __future__ import annotations

import numpy as np
import pytest
from builders import (
    OBLIQUE,
    activate,
    box_tissue,
    conduction_for,
    lowest_offers,
    offers,
    solve_without_trees,
)
from clinical import SHORT_BUNDLES
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.references import solve_from_vertices
from fascicle.forward.eikonal.build import _reach, build_myocardium
from fascicle.forward.eikonal.myocardium import Myocardium
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.kernels.coupled import from_new_corner
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import TETRAHEDRON_EDGES

TOLERANCE = 1e-9  # ms
OTHERS = [[c for c in range(4) if c != s] for s in range(4)]  # than each corner
HALVINGS = 40  # golden sections; the interval shrinks to 4e-9
SPEEDS = {"isotropic": (0.6, 0.6), "usual": (0.6, 0.25), "strong": (1.0, 0.1)}  # mm/ms
seeds = st.integers(0, 2**32 - 1)
thicknesses = st.sampled_from([1.0, 0.2, 0.02])


@pytest.mark.parametrize("speeds", SPEEDS)
def test_vertices_of_a_cube_solve_the_discrete_equation(speeds):
    """From two stimuli, both bounds: no vertex is too late, and none earlier than it can be."""
    conduction = conduction_for(*SPEEDS[speeds])
    myocardium = box_tissue(20.0, 10, jitter=0.25, fibre=OBLIQUE, conduction=conduction)
    stimuli = {0: 0.0, 700: 13.0}
    time = solve_without_trees(myocardium, stimuli)
    offered = offers(myocardium, time)
    assert np.max(time - offered) < TOLERANCE
    reached = np.setdiff1d(np.arange(len(time)), list(stimuli))
    assert np.max(offered[reached] - time[reached]) < TOLERANCE


@pytest.mark.parametrize("speeds", SPEEDS)
def test_no_vertex_can_be_lowered_after_straight_ways(speeds):
    """Stimuli inside elements: rays beat the mesh's own solution, so only one bound holds."""
    conduction = conduction_for(*SPEEDS[speeds])
    myocardium = box_tissue(20.0, 7, jitter=0.25, fibre=OBLIQUE, conduction=conduction)
    rng = np.random.default_rng(2)
    activation = activate(
        myocardium, [], [], 1.0, stimuli=rng.uniform(0, 20, (8, 3)), times=rng.uniform(0, 20, 8)
    )
    lateness = activation.myocardium - offers(myocardium, activation.myocardium)
    assert np.max(lateness) < TOLERANCE
    assert np.mean(lateness < -0.01) > 0.2, "no ray made a difference"


@pytest.mark.parametrize(
    ("model", "root_time"), [("small_model", -20.0), ("crtdemo_model", -200.0)]
)
def test_no_vertex_of_a_heart_can_be_lowered(model, root_time, request):
    """After the coupled sweep, with both trees and with the left one entered backwards."""
    model = request.getfixturevalue(model)
    time = model.simulate(SHORT_BUNDLES | {"root_time": root_time}).activation
    assert np.max(time - offers(model.myocardium, time)) < TOLERANCE


def random_tetrahedra(seed, thickness, count):
    """Corners (count, 4, 3) in a space where the metric is the identity, and squared edges."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-5, 5, (count, 4, 3))
    corners[:, :, 2] *= thickness
    edges = np.stack([corners[:, j] - corners[:, i] for i, j in TETRAHEDRON_EDGES], axis=1)
    return corners, (edges**2).sum(axis=2), rng


@given(seeds, thicknesses)
@settings(max_examples=20, deadline=None)
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


def loose_elements(seed, thickness, speeds, count=100) -> Myocardium:
    """Tetrahedra far apart from one another, most of them obtuse, each with a fibre of its own."""
    corners, _, rng = random_tetrahedra(seed, thickness, 2 * count)
    fibres = rng.normal(size=(2 * count, 3))
    fibres /= np.linalg.norm(fibres, axis=1, keepdims=True)
    turn = np.linalg.qr(rng.normal(size=(2 * count, 3, 3)))[0]
    corners = np.einsum("mki,mij->mkj", corners, turn)
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    good = np.flatnonzero(volume > 1e-3 * thickness)[:count]  # mm³
    vertices = (corners[good] + 50.0 * np.arange(len(good))[:, None, None]).reshape(-1, 3)
    tetrahedra = np.arange(len(vertices)).reshape(-1, 4)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    face = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    heart = Heart(vertices, tetrahedra, fibres[good], face, face, np.zeros((9, 3)))
    return build_myocardium(heart, conduction_for(*SPEEDS[speeds]))


def by_pair(values):
    """Values of the six pairs of an element's corners as symmetric matrices (m, 4, 4)."""
    matrix = np.zeros((len(values), 4, 4))
    for k, (i, j) in enumerate(TETRAHEDRON_EDGES):
        matrix[:, i, j] = matrix[:, j, i] = values[:, k]
    return matrix


def slopes_and_gains(myocardium, time):
    """Of times at the vertices of loose elements: slope², and how much each could be lowered.

    Also where the front comes to each corner through the opposite face, against the gradient.
    """
    mesh = myocardium.mesh
    products, t = by_pair(mesh.solver[:, :6]), time[mesh.corners]
    square = -(products * (t[:, :, None] - t[:, None, :]) ** 2).sum(axis=(1, 2)) / 2
    metric = np.ascontiguousarray(mesh.metric)
    offered = lowest_offers(mesh.vertices, mesh.corners, metric, time, HALVINGS)
    edges = mesh.vertices[mesh.corners[:, 1:]] - mesh.vertices[mesh.corners[:, :1]]
    gradient = np.linalg.solve(edges, (t[:, 1:] - t[:, :1])[:, :, None])
    weights = np.linalg.solve(np.swapaxes(edges, 1, 2), -np.linalg.solve(metric, gradient))[:, :, 0]
    weights = np.column_stack([-weights.sum(axis=1), weights])
    through = np.array([(np.delete(weights, x, axis=1) > 0).all(axis=1) for x in range(4)]).T
    return square, (time - offered)[mesh.corners], through


@given(seeds, thicknesses, st.sampled_from(list(SPEEDS)), st.sampled_from([2.0, 10.0, 40.0]))
@settings(max_examples=20, deadline=None)
def test_no_corner_can_be_lowered_where_times_rise_no_steeper_than_a_front(
    seed, thickness, speeds, latest
):
    """And where they rise more steeply, the corner to which they lead from its face can be.

    Slopes are from the products that the sweep uses, offers from positions and fibres alone.
    """
    myocardium = loose_elements(seed, thickness, speeds)
    time = np.random.default_rng(seed).uniform(0, latest, len(myocardium.order))
    square, gain, through = slopes_and_gains(myocardium, time)
    assert (gain[square <= 1.0 + 1e-12] < TOLERANCE).all()
    assert (gain[through & (square > 1.001)[:, None]] > 0).all()


def test_slopes_on_both_sides_of_a_front_s_are_common():
    """The property above says something, and the sweep's criterion spares something."""
    myocardium = loose_elements(0, 1.0, "usual", 1000)
    time = np.random.default_rng(0).uniform(0, 15.0, len(myocardium.order))
    square, gain, through = slopes_and_gains(myocardium, time)
    assert 0.2 < np.mean(square <= 1.0 + 1e-12) < 0.8
    assert np.mean((gain > TOLERANCE).any(axis=1)) > 0.2
    assert np.mean(through.any(axis=1) & (square > 1.001)) > 0.05


@given(seeds, thicknesses, st.sampled_from(list(SPEEDS)), st.sampled_from([2.0, 10.0, 40.0]))
@settings(max_examples=20, deadline=None)
def test_times_in_elements_of_any_shape_solve_the_discrete_equation(
    seed, thickness, speeds, latest
):
    """All four corners are fired at random: each keeps its time or has what its face offers."""
    myocardium = loose_elements(seed, thickness, speeds)
    fired = np.random.default_rng(seed).uniform(0, latest, len(myocardium.order))
    time = solve_from_vertices(myocardium, fired)
    offered = offers(myocardium, time, HALVINGS)
    np.testing.assert_allclose(time, np.minimum(fired, offered), rtol=0, atol=TOLERANCE)


def test_neighbours_in_a_star_are_the_corners_of_its_elements():
    mesh = box_tissue(20.0, 8, jitter=0.2, fibre=OBLIQUE).mesh
    node = np.repeat(np.arange(len(mesh.vertices)), np.diff(mesh.star_start))
    t, s = np.divmod(mesh.star["item"].astype(int), 4)
    np.testing.assert_array_equal(mesh.corners[t, s], node)
    others = np.stack([mesh.star[corner] for corner in "abc"], axis=1)
    neighbours = mesh.link["vertex"][mesh.link_start[node, None] + others]
    np.testing.assert_array_equal(neighbours, mesh.corners[t[:, None], np.array(OTHERS)[s]])
    assert np.diff(mesh.star_start).max() > 2 * 8, "no vertex has many elements around it"


@given(seeds, thicknesses, st.sampled_from(list(SPEEDS)), st.floats(0.0, 20.0))
@settings(max_examples=20, deadline=None)
def test_pruning_bounds_never_exceed_an_update(seed, thickness, speeds, latest):
    """What comes to a corner through a face with s comes no earlier than s and the least delay.

    With all of the face or only one edge at s to be used; and the least delay is that to the
    corner, rounded down.
    """
    mesh = loose_elements(seed, thickness, speeds).mesh
    product, square = by_pair(mesh.solver[:, :6]), by_pair(mesh.solver[:, 6:])
    t, s = np.divmod(mesh.star["item"].astype(int), 4)
    least = np.stack([mesh.star[f"least_{corner}"] for corner in "abc"], axis=1)
    reach = _reach(mesh.solver[:, 6:])[t, s]
    assert (least <= reach).all()
    assert (least >= reach - 1e-6 * np.abs(reach)).all()
    rng, delays = np.random.default_rng(seed), np.empty((len(t), 3, 3))
    for e in range(len(t)):
        p, q = product[t[e]], square[t[e]]
        for turn, x in enumerate(OTHERS[s[e]]):
            j, k = (c for c in OTHERS[s[e]] if c != x)
            rows, columns = [x, x, x, s[e], s[e], j], [s[e], j, k, j, k, k]
            products, squares = tuple(p[rows, columns]), tuple(q[rows[:5], columns[:5]])
            given = products, squares, *rng.uniform(-latest, latest, 2)
            for case, usable in enumerate(((True, True), (True, False), (False, True))):
                delays[e, turn, case] = from_new_corner(*given, *usable)
    assert (delays >= least[:, :, None] - TOLERANCE).all()
    assert (np.isfinite(delays).mean(axis=(0, 1)) > 0.05).all()
