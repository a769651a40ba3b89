"""Properties of the coupled problem whatever the trees."""

from __future__ import annotations

import numpy as np
from builders import box_tissue
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.eikonal.activation import solve
from fascicle.tree.purkinje import PurkinjeTree

TISSUE = box_tissue((30.0, 20.0, 6.0), (10, 7, 2), jitter=0.2, fibre=(2.0, 1.0, 0.4))
BALL = 6.0  # mm


def star(seed, leaves=6):
    """Star of random leaves on the tissue's top, between vertices."""
    rng = np.random.default_rng(seed)
    tips = np.column_stack(
        [rng.uniform(0, 30, leaves), rng.uniform(0, 20, leaves), np.full(leaves, 6.0)]
    )
    nodes = np.vstack([[15.0, 10.0, 8.0], tips])
    parents = np.concatenate([[-1], np.zeros(leaves, int)])
    return PurkinjeTree("lv", nodes, parents, np.linalg.norm(nodes - nodes[0], axis=1))


def both(seed):
    return [star(seed), star(seed + 1)]


seeds = st.integers(0, 10_000)
root_times = st.tuples(st.floats(0, 40), st.floats(0, 40))


@given(seeds, root_times, st.integers(0, len(TISSUE.vertices) - 1), st.floats(0.0, 40.0))
@settings(max_examples=30, deadline=None)
def test_adding_a_source_never_increases_any_time(seed, roots, vertex, stimulus):
    trees = both(seed)
    before = solve(TISSUE, trees, roots, 2.0, ball_radius=BALL)
    after = solve(TISSUE, trees, roots, 2.0, ball_radius=BALL, vertex_times={vertex: stimulus})
    for a, b in zip(
        (after.myocardium, *after.trees), (before.myocardium, *before.trees), strict=True
    ):
        assert (a <= b + 1e-9).all()


@given(seeds, root_times, st.floats(-50.0, 50.0))
@settings(max_examples=15, deadline=None)
def test_shifting_all_sources_shifts_all_times(seed, roots, shift):
    trees = both(seed)
    before = solve(TISSUE, trees, roots, 2.0, ball_radius=BALL)
    after = solve(TISSUE, trees, [t + shift for t in roots], 2.0, ball_radius=BALL)
    np.testing.assert_allclose(after.myocardium, before.myocardium + shift, atol=1e-9)


@given(seeds, root_times)
@settings(max_examples=15, deadline=None)
def test_order_of_trees_does_not_matter(seed, roots):
    trees = both(seed)
    one = solve(TISSUE, trees, roots, 2.0, ball_radius=BALL)
    other = solve(TISSUE, trees[::-1], roots[::-1], 2.0, ball_radius=BALL)
    np.testing.assert_allclose(one.myocardium, other.myocardium, atol=1e-9)
    np.testing.assert_allclose(one.trees[0], other.trees[1], atol=1e-9)


@given(seeds, root_times)
@settings(max_examples=15, deadline=None)
def test_segments_and_junctions_are_never_outrun(seed, roots):
    """Both ways, the ends of a segment differ by its travel time at most; junctions fire balls."""
    trees = both(seed)
    activation = solve(TISSUE, trees, roots, 2.0, ball_radius=BALL)
    for tree, times, root_time in zip(trees, activation.trees, roots, strict=True):
        assert (np.abs(times[1:] - times[0]) <= tree.lengths[1:] / 2.0 + 1e-9).all()
        assert times[0] <= root_time + 1e-9
        start, vertex, delay = TISSUE.balls(TISSUE.locate(tree.nodes[tree.junctions]), BALL)
        fired = np.repeat(times[tree.junctions], np.diff(start)) + delay
        assert (activation.myocardium[vertex] <= fired + 1e-9).all()
