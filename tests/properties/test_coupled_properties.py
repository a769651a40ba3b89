"""Properties of the coupled problem whatever the trees."""

import numpy as np
from builders import activate, box_tissue, heart_vertices, ray_times, star_tree
from clinical import SHORT_BUNDLES
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.forward.eikonal.myocardium import attach

SIZE = (30.0, 20.0, 6.0)  # mm
MYOCARDIUM = box_tissue(SIZE, (10, 7, 2), jitter=0.2, fibre=(2.0, 1.0, 0.4))
VERTICES = heart_vertices(MYOCARDIUM)
EDGE, SLOW = 6.1, 0.2449  # the longest edge (mm), the speed across the fibre (mm/ms)


def both(seed):
    return [star_tree(seed), star_tree(seed + 1)]


def assert_none_later(after, before):
    for a, b in zip(
        (after.myocardium, *after.trees), (before.myocardium, *before.trees), strict=True
    ):
        assert (a <= b + 1e-9).all()


seeds = st.integers(0, 10_000)
root_times = st.tuples(st.floats(0, 40), st.floats(0, 40))
points = st.tuples(*(st.floats(0.0, length) for length in SIZE))


@given(seeds, root_times, points, st.floats(0.0, 40.0))
@settings(max_examples=40, deadline=None)
def test_adding_a_source_never_increases_any_time(seed, roots, point, stimulus):
    """Whatever is offered comes later where it starts later: earliest times are monotone."""
    trees = both(seed)
    before = activate(MYOCARDIUM, trees, roots, 2.0)
    after = activate(MYOCARDIUM, trees, roots, 2.0, stimuli=point, times=[stimulus])
    assert_none_later(after, before)


@given(seeds, root_times, st.floats(-50.0, 50.0))
@settings(max_examples=15, deadline=None)
def test_shifting_all_sources_shifts_all_times(seed, roots, shift):
    trees = both(seed)
    before = activate(MYOCARDIUM, trees, roots, 2.0)
    after = activate(MYOCARDIUM, trees, [t + shift for t in roots], 2.0)
    np.testing.assert_allclose(after.myocardium, before.myocardium + shift, atol=1e-9)


@given(seeds, root_times)
@settings(max_examples=15, deadline=None)
def test_order_of_trees_does_not_matter(seed, roots):
    trees = both(seed)
    one = activate(MYOCARDIUM, trees, roots, 2.0)
    other = activate(MYOCARDIUM, trees[::-1], roots[::-1], 2.0)
    np.testing.assert_allclose(one.myocardium, other.myocardium, atol=1e-9)
    np.testing.assert_allclose(one.trees[0], other.trees[1], atol=1e-9)
    flags = np.concatenate(one.retrograde[::-1])
    np.testing.assert_array_equal(flags, np.concatenate(other.retrograde))


@given(seeds, root_times)
@settings(max_examples=15, deadline=None)
def test_segments_and_junctions_are_never_outrun(seed, roots):
    """In both directions, the ends of a segment differ by its travel time at most.

    A site and the corners of its element by the ray travel time, from the site.
    """
    trees = both(seed)
    activation = activate(MYOCARDIUM, trees, roots, 2.0)
    site, corners = attach(MYOCARDIUM, trees).located, MYOCARDIUM.order[MYOCARDIUM.mesh.corners]
    for tree, times, root_time in zip(trees, activation.trees, roots, strict=True):
        assert (np.abs(times[1:] - times[0]) <= tree.lengths[1:] / 2.0 + 1e-9).all()
        assert times[0] <= root_time + 1e-9
    for position, element, moment in zip(
        site.positions, site.elements, fired(trees, activation), strict=True
    ):
        rays = ray_times(MYOCARDIUM, position, element, VERTICES[corners[element]])
        assert (activation.myocardium[corners[element]] <= moment + rays + 1e-9).all()


def fired(trees, activation):
    """When each junction fires (ms)."""
    pairs = zip(trees, activation.trees, strict=True)
    return np.concatenate([times[tree.junctions] for tree, times in pairs])


def test_what_is_near_a_junction_is_not_later_than_by_the_straight_way():
    """Vertices and other junctions, less far than the table reaches by an edge or more."""
    furthest, longest = (
        MYOCARDIUM.travel_times.reach - EDGE,
        MYOCARDIUM.travel_times.longest - EDGE / SLOW,
    )
    checked = 0
    for seed in range(40):
        trees = both(2 * seed)
        activation = activate(MYOCARDIUM, trees, [seed % 7, 3.0], 2.0)
        site, moments = attach(MYOCARDIUM, trees).located, fired(trees, activation)
        goals = np.concatenate([VERTICES, site.positions])
        times = np.concatenate([activation.myocardium, moments])
        for position, element, moment in zip(site.positions, site.elements, moments, strict=True):
            rays = ray_times(MYOCARDIUM, position, element, goals)
            near = (np.linalg.norm(goals - position, axis=1) < furthest) & (rays < longest)
            assert (times[near] <= moment + rays[near] + 1e-9).all()
            checked += near.sum()
    assert checked > 8_000


@given(seeds, root_times)
@settings(max_examples=15, deadline=None)
def test_retrograde_flags_say_who_came_first(seed, roots):
    """A junction is retrograde exactly where it fires before its tree alone would fire it."""
    trees = both(seed)
    activation = activate(MYOCARDIUM, trees, roots, 2.0)
    sites = np.concatenate([np.full(len(t.junctions), k) for k, t in enumerate(trees)])
    for k, (tree, times) in enumerate(zip(trees, activation.trees, strict=True)):
        through_tree = times[0] + tree.lengths[tree.junctions] / 2.0
        retrograde = activation.retrograde[k]
        assert (times[tree.junctions][retrograde] <= through_tree[retrograde] + 1e-9).all()
        np.testing.assert_allclose(times[tree.junctions][~retrograde], through_tree[~retrograde])
        entered_by = activation.entered_by[k]
        assert (retrograde == (entered_by >= 0)).all()
        own = np.flatnonzero(sites == k)
        assert (entered_by[retrograde] != own[retrograde]).all()


def test_monotone_on_a_heart(crtdemo_model):
    """A fourth stimulus beside three makes no vertex and no node of a tree later."""
    vertices, myocardium = crtdemo_model.heart.vertices, crtdemo_model.myocardium
    trees = crtdemo_model.grow(SHORT_BUNDLES)
    captured = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        chosen = vertices[rng.choice(len(vertices), 4, replace=False)] + rng.normal(0, 0.3, (4, 3))
        moments = rng.uniform(0, 60, 4)
        roots = [(np.inf, 0.0), (np.inf, np.inf), (20.0, 0.0)][seed % 3]
        three, four = (
            activate(myocardium, trees, roots, 3.0, stimuli=chosen[:k], times=moments[:k])
            for k in (3, 4)
        )
        assert_none_later(four, three)
        captured.append((four.myocardium < three.myocardium - 1.0).any())
    assert np.mean(captured) > 0.5, "most stimuli should capture something"
