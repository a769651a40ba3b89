"""Travel times inside trees, entered at the root, at leaves, at any node, or several of these."""

import numpy as np
import pytest
from builders import activate, box_tissue, heart_vertices, line_tree
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from fascicle.purkinje.tree import PurkinjeTree

MYOCARDIUM = box_tissue((40.0, 16.0, 4.0), (20, 8, 2), jitter=0.1)
VERTICES = heart_vertices(MYOCARDIUM)
TOP = VERTICES[np.abs(VERTICES[:, 2] - 4.0) < 1e-9]
CUT_OFF = {"anterograde_delay": np.inf, "retrograde_delay": np.inf}


def dijkstra_times(tree, cv, entered, speed=1.0):
    """SciPy's shortest paths from one extra node that fires the nodes in `entered`."""
    n = len(tree.nodes)
    speed = np.broadcast_to(speed, n)
    child = np.flatnonzero((tree.parents >= 0) & (speed > 0))
    entered = {node: t for node, t in entered.items() if np.isfinite(t)}
    shift = 1.0 - min(entered.values())  # weights must be positive
    rows = np.concatenate([child, np.full(len(entered), n)])
    columns = np.concatenate([tree.parents[child], list(entered)]).astype(int)
    segments = tree.lengths[child] / (cv * speed[child])
    weights = np.concatenate([segments, np.array(list(entered.values())) + shift])
    graph = coo_array((weights, (rows, columns)), shape=(n + 1, n + 1))
    return dijkstra(graph.tocsr(), directed=False, indices=n)[:n] - shift


def random_tree(seed, leaves=12):
    """Random tree whose leaves are vertices of the tissue's top surface, 4 nodes an edge."""
    rng = np.random.default_rng(seed)
    chosen = TOP[rng.choice(len(TOP), leaves, replace=False)]
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
    times = activate(MYOCARDIUM, [tree], [7.0], 2.5).trees[0]
    assert times[-1] == pytest.approx(7.0 + 14.4, abs=1e-12)
    np.testing.assert_allclose(np.diff(times), 1 / 2.5, rtol=1e-12)


@pytest.mark.parametrize("entry", ["root", "leaf", "both"])
def test_branched_trees_agree_with_scipy(entry):
    """Root fires at 0 or never; the tissue at a leaf is stimulated; trees fire no tissue.

    What the junctions read is the same with a tree that lets nothing in.
    """
    tree, cv = random_tree(0), 2.0
    stimuli = {} if entry == "root" else {"stimuli": tree.nodes[tree.junctions[3]], "times": [-5.0]}
    root_time = np.inf if entry == "leaf" else 3.0
    activation = activate(MYOCARDIUM, [tree], [root_time], cv, anterograde_delay=np.inf, **stimuli)
    entered = {tree.root: root_time}
    if stimuli:
        alone = [
            activate(MYOCARDIUM, [single_leaf(tree, j)], [np.inf], cv, **stimuli).trees[0][1]
            for j in tree.junctions
        ]
        assert alone[3] == pytest.approx(-5.0, abs=1e-9)
        entered |= dict(zip(tree.junctions.tolist(), alone, strict=True))
    expected = dijkstra_times(tree, cv, entered)
    np.testing.assert_allclose(activation.trees[0], expected, atol=1e-9, rtol=0)
    assert activation.retrograde[0].any() == (entry != "root")


def single_leaf(tree, junction):
    """A tree of one segment that ends where the junction is."""
    return line_tree([tree.nodes[junction] + [0, 0, 3.0], tree.nodes[junction]])


@given(
    st.integers(0, 10_000), st.floats(1.0, 4.0), st.floats(-10.0, 10.0),
    st.lists(st.floats(-10.0, 10.0), max_size=4),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_an_uncoupled_tree_is_a_shortest_path_problem(seed, cv, root_time, moments):
    """A factor on each segment, 0 for a fifth of them; root and any nodes fire."""
    rng, tree = np.random.default_rng(seed), random_tree(seed)
    speed = rng.choice([0.0, 0.3, 0.7, 1.0, 1.0], len(tree.nodes))
    fired = rng.choice(len(tree.nodes), len(moments), replace=False).tolist()
    node_times = [(0, node, moment) for node, moment in zip(fired, moments, strict=True)]
    activation = activate(
        MYOCARDIUM, [tree], [root_time], cv, node_times=node_times, speed=speed, **CUT_OFF
    )
    entered = dict(zip(fired, moments, strict=True))
    entered[tree.root] = min(root_time, entered.get(tree.root, np.inf))
    expected = dijkstra_times(tree, cv, entered, speed)
    np.testing.assert_allclose(activation.trees[0], expected, atol=1e-9, rtol=0)
    assert np.isinf(expected).any() or (speed > 0).all() or len(moments) > 1
    assert not activation.retrograde[0].any()
    assert np.isinf(activation.myocardium).all()


def test_a_block_is_bypassed_through_the_myocardium():
    """The bundle is cut; its far part is entered at the leaf, as after an infranodal block."""
    x = np.linspace(0, 40, 11)
    tree = line_tree(np.column_stack([x, np.full(11, 8.0), np.full(11, 4.0)]), root=5)
    speed = np.where(np.arange(11) == 8, 0.0, 1.0)  # the segment from x = 28 to 32 mm
    activation = activate(MYOCARDIUM, [tree], [0.0], 2.0, speed=speed)
    along = np.sqrt(0.375)
    np.testing.assert_allclose(activation.trees[0][:8], np.abs(x[:8] - 20) / 2.0)
    entered = 10.0 + 40.0 / along
    np.testing.assert_allclose(activation.trees[0][8:], entered + (40 - x[8:]) / 2.0)
    assert activation.retrograde[0].tolist() == [False, True]


def test_a_blocked_segment_of_no_length_is_passed_neither_way():
    tree = line_tree([[0, 8, 9], [10, 8, 9], [10, 8, 9], [20, 8, 9]])
    speed = np.array([1.0, 1.0, 0.0, 1.0])
    times = activate(MYOCARDIUM, [tree], [0.0], 2.0, speed=speed, **CUT_OFF).trees[0]
    np.testing.assert_allclose(times, [0, 5, np.inf, np.inf])


def test_trees_do_not_leak_into_one_another():
    """Two uncoupled trees in one solve are what each is alone; an offset slip mixes them."""
    trees = [random_tree(5), random_tree(6, leaves=7), random_tree(7, leaves=3)]
    roots = [0.0, 11.0, -4.0]
    rng = np.random.default_rng(0)
    speeds = [rng.choice([0.0, 0.5, 1.0], len(tree.nodes)) for tree in trees]
    node_times = [(1, 4, 2.0), (2, 5, -7.0)]
    together = activate(
        MYOCARDIUM,
        trees,
        roots,
        3.0,
        speed=np.concatenate(speeds),
        node_times=node_times,
        **CUT_OFF,
    )
    for k, (tree, root_time, times) in enumerate(zip(trees, roots, together.trees, strict=True)):
        own = [(0, node, moment) for number, node, moment in node_times if number == k]
        alone = activate(
            MYOCARDIUM, [tree], [root_time], 3.0, speed=speeds[k], node_times=own, **CUT_OFF
        )
        np.testing.assert_array_equal(times, alone.trees[0])
        assert len(times) == len(tree.nodes)
