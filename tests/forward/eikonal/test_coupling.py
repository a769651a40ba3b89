"""Junctions and the myocardium beneath: what is read, what is fired, what is refused."""

import numpy as np
import pytest
from builders import activate, box_tissue, heart_vertices, line_tree, straight_times, vertex_at

ALONG, ACROSS = np.sqrt(0.375), np.sqrt(0.06)  # mm/ms at the default conductivities
CV = 3.0  # mm/ms
LENGTH, WIDTH, DEPTH = 48.0, 12.0, 4.0  # mm; fibres along x
# The slab's fibres are parallel to its sides, so straight lines are geodesics
MYOCARDIUM = box_tissue((LENGTH, WIDTH, DEPTH), (48, 12, 4))
VERTICES = heart_vertices(MYOCARDIUM)
SIDE = VERTICES[VERTICES[:, 0] < 1e-9]
EXACT = 1e-9  # ms


def test_a_planar_front_is_exact_and_so_is_a_junction_in_it():
    """All vertices of one side are stimulated: τ = x / v."""
    nodes = np.array([[17.37, 5.13, DEPTH], [20.0, 6.0, 9.0], [30.9, 2.71, DEPTH]])
    activation = activate(
        MYOCARDIUM,
        [line_tree(nodes, root=1)],
        [np.inf],
        1e-3,
        stimuli=SIDE,
        times=np.zeros(len(SIDE)),
    )
    np.testing.assert_allclose(activation.myocardium, VERTICES[:, 0] / ALONG, atol=EXACT)
    np.testing.assert_allclose(activation.trees[0][[0, 2]], nodes[[0, 2], 0] / ALONG, rtol=1e-12)


def test_a_junction_off_the_surface_fires_the_nearest_tissue_and_says_how_far():
    tree = line_tree([[10.0, 6.0, DEPTH + 5], [10.0, 6.0, DEPTH + 1.5]])
    activation = activate(MYOCARDIUM, [tree], [0.0], CV)
    assert activation.junction_distances[0] == pytest.approx([1.5])
    vertex = vertex_at(VERTICES, [10.0, 6.0, DEPTH])
    assert activation.myocardium[vertex] == pytest.approx(3.5 / CV)


def test_a_stimulus_outside_fires_the_nearest_tissue():
    activation = activate(MYOCARDIUM, [], [], CV, stimuli=[10.3, 6.2, DEPTH + 1.5], times=[2.0])
    exact = straight_times(MYOCARDIUM, [10.3, 6.2, DEPTH], [2.0])
    np.testing.assert_allclose(activation.myocardium, exact, atol=EXACT)


def test_nothing_fires():
    """All roots silent and no stimulus: no front anywhere, and no origin."""
    tree = line_tree([[10.0, 6.0, DEPTH + 5], [10.0, 6.0, DEPTH]])
    activation = activate(MYOCARDIUM, [tree], [np.inf], CV)
    assert np.isinf(activation.myocardium).all()
    assert np.isinf(activation.trees[0]).all()
    assert (activation.origin == -1).all()
    assert not activation.retrograde[0].any()


def test_a_stimulus_that_comes_too_late_is_not_captured_and_changes_nothing():
    first, second = [4.0, 6.0, 2.0], [20.0, 5.0, 1.0]
    there = straight_times(MYOCARDIUM, [first], [0.0], at=second)[0]
    alone = activate(MYOCARDIUM, [], [], CV, stimuli=[first], times=[0.0])
    for lead, captured in ((-0.01, True), (0.01, False)):
        both = activate(MYOCARDIUM, [], [], CV, stimuli=[first, second], times=[0.0, there + lead])
        assert both.captured.tolist() == [True, captured]
    np.testing.assert_allclose(both.myocardium, alone.myocardium, atol=EXACT)


def test_origins_are_the_sources_that_came_first():
    """Away from where fronts meet within an element."""
    points, times = [[4.0, 6.0, 2.0], [40.0, 5.0, 1.0]], [0.0, 7.0]
    activation = activate(MYOCARDIUM, [], [], CV, stimuli=points, times=times)
    each = [straight_times(MYOCARDIUM, [p], [t]) for p, t in zip(points, times, strict=True)]
    clear = np.abs(each[0] - each[1]) > 4.0
    assert 0.5 < clear.mean() < 1.0
    expected = np.argmin(each, axis=0)
    np.testing.assert_array_equal(activation.origin[clear], expected[clear])


def test_a_root_time_for_every_tree():
    """A missing root time must not silence a tree without a word."""
    tree = line_tree([[10.0, 6.0, DEPTH + 5], [10.0, 6.0, DEPTH]])
    with pytest.raises(ValueError, match="1 root times for 2 trees"):
        activate(MYOCARDIUM, [tree, tree], [0.0], CV)
