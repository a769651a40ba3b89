"""Travel times inside trees, entered at the root, at leaves, or both."""

from __future__ import annotations

import numpy as np
import pytest
from builders import box_tissue, line_tree, solve_without_trees, vertex_at
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from fascicle.eikonal.activation import solve
from fascicle.tree.purkinje import PurkinjeTree

TISSUE = box_tissue((40.0, 16.0, 4.0), (20, 8, 2), jitter=0.1)
NEVER = 1e4  # ms; a junction delay that cuts trees off from the myocardium


def dijkstra_times(tree, cv, root_time, junction_times):
    """SciPy's shortest paths from one extra node that fires root and junctions."""
    n = len(tree.nodes)
    child = np.flatnonzero(tree.parents >= 0)
    entered = {tree.root: root_time} | {
        int(j): min(t, root_time if j == tree.root else np.inf)
        for j, t in zip(tree.junctions, junction_times, strict=True)
    }
    entered = {node: t for node, t in entered.items() if np.isfinite(t)}
    shift = 1.0 - min(entered.values())  # weights must be positive
    rows = np.concatenate([child, np.full(len(entered), n)])
    columns = np.concatenate([tree.parents[child], list(entered)]).astype(int)
    weights = np.concatenate([tree.lengths[child] / cv, np.array(list(entered.values())) + shift])
    graph = coo_array((weights, (rows, columns)), shape=(n + 1, n + 1))
    return dijkstra(graph.tocsr(), directed=False, indices=n)[:n] - shift


def random_tree(seed, leaves=12, on=TISSUE):
    """Random tree whose leaves are vertices of the tissue's top surface, 4 nodes an edge."""
    rng = np.random.default_rng(seed)
    top = np.flatnonzero(np.abs(on.vertices[:, 2] - on.vertices[:, 2].max()) < 1e-9)
    chosen = on.vertices[rng.choice(top, leaves, replace=False)]
    nodes, parents = [np.array([20.0, 8.0, 9.0])], [-1]
    inner = [0]
    for goal in chosen:
        start = int(rng.choice(inner))
        for share in (0.3, 0.6, 1.0):
            parents.append(start)
            nodes.append(nodes[start] + share * (goal - nodes[start]))
            start = len(nodes) - 1
            if share < 1:
                inner.append(start)
    nodes, parents = np.array(nodes), np.array(parents)
    lengths = np.linalg.norm(nodes - nodes[parents], axis=1)
    lengths[0] = 0.0
    return PurkinjeTree("lv", nodes, parents, lengths)


def test_cv_is_the_speed_and_not_its_square():
    """36 mm at 2.5 mm/ms take 14.4 ms; a conductivity in place of a speed would give 22.8 ms."""
    tree = line_tree(np.column_stack([np.linspace(0, 36, 37), np.full(37, 8.0), np.full(37, 4.0)]))
    times = solve(TISSUE, [tree], [7.0], 2.5, ball_radius=4.0).trees[0]
    assert times[-1] == pytest.approx(7.0 + 14.4, abs=1e-12)
    np.testing.assert_allclose(np.diff(times), 1 / 2.5, rtol=1e-12)


@pytest.mark.parametrize("entry", ["root", "leaf", "both"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_branched_trees_agree_with_scipy(entry, seed):
    """Root fires at 0 or never; a leaf's vertex is stimulated; orthodromic firing is cut off."""
    tree, cv = random_tree(seed), 2.0
    vertex = vertex_at(TISSUE.vertices, tree.nodes[tree.junctions[3]])
    stimuli = {} if entry == "root" else {vertex: -5.0}
    root_time = np.inf if entry == "leaf" else 3.0
    activation = solve(
        TISSUE, [tree], [root_time], cv, ball_radius=4.0,
        vertex_times=stimuli, orthodromic_delay=NEVER,
    )  # fmt: skip
    read = np.full(len(tree.junctions), np.inf)
    if stimuli:
        alone = solve_without_trees(TISSUE, stimuli)
        read = alone[[vertex_at(TISSUE.vertices, p) for p in tree.nodes[tree.junctions]]]
    expected = dijkstra_times(tree, cv, root_time, read)
    np.testing.assert_allclose(activation.trees[0], expected, atol=1e-9, rtol=0)


@given(st.integers(0, 10_000), st.floats(1.0, 4.0), st.floats(-10.0, 10.0))
@settings(max_examples=15, deadline=None)
def test_uncoupled_tree_is_a_shortest_path_problem(seed, cv, root_time):
    tree = random_tree(seed)
    activation = solve(
        TISSUE, [tree], [root_time], cv, ball_radius=4.0,
        orthodromic_delay=NEVER, antidromic_delay=NEVER,
    )  # fmt: skip
    expected = dijkstra_times(tree, cv, root_time, np.full(len(tree.junctions), np.inf))
    np.testing.assert_allclose(activation.trees[0], expected, atol=1e-9, rtol=0)
    assert not activation.antidromic[0].any()


def test_trees_do_not_leak_into_one_another():
    """Two uncoupled trees in one solve are what each is alone; an offset slip mixes them."""
    trees = [random_tree(5), random_tree(6, leaves=7), random_tree(7, leaves=3)]
    options = {"ball_radius": 4.0, "orthodromic_delay": NEVER, "antidromic_delay": NEVER}
    roots = [0.0, 11.0, -4.0]
    together = solve(TISSUE, trees, roots, 3.0, **options)
    for tree, root_time, times in zip(trees, roots, together.trees, strict=True):
        alone = solve(TISSUE, [tree], [root_time], 3.0, **options)
        np.testing.assert_array_equal(times, alone.trees[0])
        assert len(times) == len(tree.nodes)
