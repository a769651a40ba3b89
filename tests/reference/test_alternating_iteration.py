"""One coupled sweep is the limit of the paper's alternation between trees and myocardium."""

from __future__ import annotations

import numpy as np
import pytest
from builders import brute_force, solve_without_trees
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from fascicle.eikonal.activation import BALL_EDGES, solve
from fascicle.parameters import EXAMPLE_PARAMETERS

HALVINGS = 50
ROUNDS = 20


def tree_times(tree, cv, entered):
    """Shortest paths in a tree from nodes that are entered at given times."""
    n = len(tree.nodes)
    child = np.flatnonzero(tree.parents >= 0)
    given = np.flatnonzero(np.isfinite(entered))
    if not given.size:
        return entered
    rows = np.concatenate([child, np.full(given.size, n)])
    columns = np.concatenate([tree.parents[child], given])
    weights = np.concatenate([tree.lengths[child] / cv, entered[given] + 1000.0])
    graph = coo_array((weights, (rows, columns)), shape=(n + 1, n + 1)).tocsr()
    return dijkstra(graph, directed=False, indices=n)[:n] - 1000.0


def read(tissue, site, time):
    """Arrival at points of the surface through the tissue-side faces, by brute force.

    No front comes through the boundary face that a point lies in. Its interpolated time would be
    earlier by up to 0.5 ms on this heart, and where two fronts meet earlier than either front.
    """
    arrivals = np.full(len(site.elements), np.inf)
    for k, element in enumerate(site.elements):
        offset = tissue.vertices[tissue.corners[element]] - site.positions[k]
        gram = offset @ tissue.metric[element] @ offset.T
        t = time[tissue.corners[element]]
        gradients = tissue.gradients[element]
        weights = 1 - np.einsum("ki,ki->k", gradients, offset)  # barycentric coordinates
        for opposite, face in enumerate(([1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2])):
            if weights[opposite] < 1e-9:
                continue
            way = brute_force(gram[np.ix_(face, face)], t[face], HALVINGS)
            arrivals[k] = min(arrivals[k], way)
    return arrivals


def alternate(tissue, trees, root_times, cv, ball_radius, stimuli):
    """The paper's iteration; returns myocardium, trees and how many rounds changed something."""
    entered = []
    for tree, root_time in zip(trees, root_times, strict=True):
        entered.append(np.full(len(tree.nodes), np.inf))
        entered[-1][tree.root] = root_time
    sites = [tissue.locate(tree.nodes[tree.junctions]) for tree in trees]
    balls = [tissue.balls(site, ball_radius) for site in sites]
    myocardium = np.full(len(tissue.vertices), np.inf)
    for rounds in range(ROUNDS):
        times = [tree_times(tree, cv, e) for tree, e in zip(trees, entered, strict=True)]
        fired = np.full(len(tissue.vertices), np.inf)
        for tree, t, (start, vertex, delay) in zip(trees, times, balls, strict=True):
            np.minimum.at(fired, vertex, np.repeat(t[tree.junctions], np.diff(start)) + delay)
        sources = {int(v): float(fired[v]) for v in np.flatnonzero(np.isfinite(fired))}
        for vertex, stimulus in stimuli.items():
            sources[vertex] = min(stimulus, sources.get(vertex, np.inf))
        previous, myocardium = myocardium, solve_without_trees(tissue, sources)
        if np.abs(previous - myocardium).max() < 1e-9:
            return myocardium, times, rounds
        for tree, e, site in zip(trees, entered, sites, strict=True):
            e[tree.junctions] = np.minimum(e[tree.junctions], read(tissue, site, myocardium))
    raise AssertionError(f"the alternation did not settle in {ROUNDS} rounds")


@pytest.mark.parametrize(
    ("root_times", "stimuli"),
    [
        ((60.0, 0.0), {}),  # left bundle branch block
        ((0.0, 40.0), {}),
        ((np.inf, np.inf), {100: 0.0, 2000: 25.0}),  # paced, both roots silent
    ],
)
def test_sweep_equals_the_limit_of_the_alternation(crtdemo_model, root_times, stimuli):
    """Junctions that the front enters backwards are what a one-pass scheme gets wrong."""
    tissue = crtdemo_model.tissue
    trees = crtdemo_model.grow(EXAMPLE_PARAMETERS)
    radius = BALL_EDGES * crtdemo_model.heart.edge_length
    swept = solve(tissue, trees, root_times, 3.0, ball_radius=radius, vertex_times=stimuli)
    myocardium, times, rounds = alternate(tissue, trees, root_times, 3.0, radius, stimuli)
    assert rounds > 1, "a case in which nothing is entered backwards proves nothing"
    np.testing.assert_allclose(swept.myocardium, myocardium, atol=1e-6, rtol=0)
    for one, other in zip(swept.trees, times, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6, rtol=0)
    assert any(flags.any() for flags in swept.antidromic)
