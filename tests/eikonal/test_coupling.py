"""A straight bundle on a slab: orthodromic, antidromic, delays, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from builders import box_tissue, line_tree, vertex_at

from fascicle.eikonal.activation import solve

ALONG, ACROSS = np.sqrt(0.375), np.sqrt(0.06)  # mm/ms at the default conductivities
CV = 3.0  # mm/ms
LENGTH, WIDTH, DEPTH = 48.0, 12.0, 4.0  # mm; fibres along x
# The slab's fibres are parallel to its sides, so straight ways are geodesics
TISSUE = box_tissue((LENGTH, WIDTH, DEPTH), (48, 12, 4))
BALL = 6.0  # mm
LATE = 2.2  # ms; point-source error of 1 mm cells, measured 1.96 at the far bottom edge


def bundle(root):
    """Bundle along the slab's top from x = 0 to 48 mm, a node every 2 mm, entered at `root`."""
    x = np.arange(0, LENGTH + 1, 2.0)
    return line_tree(
        np.column_stack([x, np.full_like(x, WIDTH / 2), np.full_like(x, DEPTH)]), root=root
    )


def through_tissue(point):
    """Exact time (ms) from `point` to every vertex."""
    offset = (TISSUE.vertices - point) / [ALONG, ACROSS, ACROSS]
    return np.linalg.norm(offset, axis=1)


LEFT_END, RIGHT_END = np.array([0, WIDTH / 2, DEPTH]), np.array([LENGTH, WIDTH / 2, DEPTH])


def assert_close_and_never_early(times, exact):
    error = times - exact
    assert error.min() > -1e-9
    assert error.max() < LATE
    assert error.mean() < 0.8  # measured 0.65


def test_orthodromic_from_the_middle():
    tree = bundle(root=12)
    activation = solve(TISSUE, [tree], [1.0], CV, ball_radius=BALL)
    at_ends = 1.0 + 24.0 / CV
    np.testing.assert_allclose(activation.trees[0][[0, -1]], at_ends, rtol=1e-12)
    exact = at_ends + np.minimum(through_tissue(LEFT_END), through_tissue(RIGHT_END))
    assert_close_and_never_early(activation.myocardium, exact)
    assert not activation.antidromic[0].any()


@pytest.mark.parametrize("root_time", [np.inf, 200.0])
def test_antidromic_entry_before_the_root_has_fired(root_time):
    """Bundle-branch block: a front at one end runs back through the bundle and out at the other."""
    tree = bundle(root=12)
    stimulus = {vertex_at(TISSUE.vertices, LEFT_END): 5.0}
    activation = solve(
        TISSUE, [tree], [root_time], CV, ball_radius=BALL, vertex_times=stimulus
    )  # fmt: skip
    times = activation.trees[0]
    assert times[tree.root] == pytest.approx(5.0 + 24.0 / CV)
    assert times[-1] == pytest.approx(5.0 + 48.0 / CV)
    out = 5.0 + 48.0 / CV + through_tissue(RIGHT_END)
    exact = np.minimum(5.0 + through_tissue(LEFT_END), out)
    assert_close_and_never_early(activation.myocardium, exact)
    assert activation.antidromic[0].tolist() == [True, False]


def test_front_from_inside_the_slab_enters_the_nearest_junction():
    """The junction lies between vertices, so it must read the myocardium by interpolation."""
    nodes = np.array([[7.3, 5.1, DEPTH], [20.0, 6.0, 9.0], [44.9, 6.7, DEPTH]])
    tree = line_tree(nodes, root=1)
    start = np.array([4.0, 6.0, 0.0])
    activation = solve(
        TISSUE, [tree], [np.inf], CV, ball_radius=BALL,
        vertex_times={vertex_at(TISSUE.vertices, start): 0.0},
    )  # fmt: skip
    exact = np.linalg.norm((nodes[0] - start) / [ALONG, ACROSS, ACROSS])
    read = activation.trees[0][0]
    assert 0 <= read - exact < LATE
    assert activation.trees[0][2] == pytest.approx(read + tree.lengths.sum() / CV)
    assert activation.antidromic[0].tolist() == [True, False]


def test_junction_reads_a_planar_front_exactly():
    """All vertices of one side are stimulated: τ = x / v is linear and reading it must be exact."""
    sides = {int(v): 0.0 for v in np.flatnonzero(TISSUE.vertices[:, 0] < 1e-9)}
    nodes = np.array([[17.37, 5.13, DEPTH], [20.0, 6.0, 9.0], [30.9, 2.71, DEPTH]])
    activation = solve(
        TISSUE, [line_tree(nodes, root=1)], [np.inf], 1e-3, ball_radius=BALL, vertex_times=sides
    )
    np.testing.assert_allclose(activation.trees[0][[0, 2]], nodes[[0, 2], 0] / ALONG, rtol=1e-12)
    np.testing.assert_allclose(activation.myocardium, TISSUE.vertices[:, 0] / ALONG, atol=1e-9)


def test_delays_act_in_their_own_direction_only():
    tree = bundle(root=12)
    stimulus = {vertex_at(TISSUE.vertices, LEFT_END): 0.0}
    delays = {"orthodromic_delay": 2.0, "antidromic_delay": 3.0}
    activation = solve(
        TISSUE, [tree], [np.inf], CV, ball_radius=BALL, vertex_times=stimulus, **delays
    )  # fmt: skip
    assert activation.trees[0][0] == pytest.approx(3.0)
    assert activation.trees[0][-1] == pytest.approx(3.0 + 48.0 / CV)
    right = vertex_at(TISSUE.vertices, RIGHT_END)
    assert activation.myocardium[right] == pytest.approx(3.0 + 48.0 / CV + 2.0)


def test_a_junction_off_the_surface_fires_the_nearest_tissue_and_says_how_far():
    tree = line_tree([[10.0, 6.0, DEPTH + 5], [10.0, 6.0, DEPTH + 1.5]])
    activation = solve(TISSUE, [tree], [0.0], CV, ball_radius=BALL)
    assert activation.junction_distances[0] == pytest.approx([1.5])
    vertex = vertex_at(TISSUE.vertices, [10.0, 6.0, DEPTH])
    assert activation.myocardium[vertex] == pytest.approx(3.5 / CV)


def test_no_tree_at_all():
    """ "Any number of trees" includes none: paced myocardium after a complete block."""
    sides = {int(v): 0.0 for v in np.flatnonzero(TISSUE.vertices[:, 0] < 1e-9)}
    activation = solve(TISSUE, [], [], CV, ball_radius=BALL, vertex_times=sides)
    np.testing.assert_allclose(activation.myocardium, TISSUE.vertices[:, 0] / ALONG, atol=1e-9)
    assert activation.trees == ()


def test_a_root_time_for_every_tree():
    """A missing root time must not silence a tree without a word."""
    with pytest.raises(ValueError, match=r"zip|root"):
        solve(TISSUE, [bundle(12), bundle(3)], [0.0], CV, ball_radius=BALL)
