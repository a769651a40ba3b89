"""One coupled sweep is the limit of the paper's alternation between trees and myocardium.

The paper solves the trees, then the myocardium, then the trees again with what their junctions
read, until nothing changes. Here this is written down twice: on a slab, where rays from
the sites are traced here, and on a patient's heart with the sweep itself as the solver of the
myocardium. Measured, the largest difference anywhere: 3e-13 ms on
the slab, 2e-11 on the heart.
"""

import numpy as np
import pytest
from builders import (
    activate,
    box_tissue,
    brute_force,
    heart_vertices,
    line_tree,
    ray_times,
    solve_without_trees,
    star_tree,
)
from clinical import SHORT_BUNDLES
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from fascicle.forward.eikonal.myocardium import attach

HALVINGS = 50
ROUNDS = 30
SETTLED = 1e-9  # ms
SAME = 1e-9  # ms
FACES = ([1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2])
SLAB = (30.0, 20.0, 6.0)  # mm


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


def read(myocardium, site, time):
    """Arrival at points of the surface through the tissue-side faces, by brute force.

    No front comes through the boundary face that a point lies in.
    """
    mesh, metric = myocardium.mesh, myocardium.mesh.metric
    arrivals = np.full(len(site.elements), np.inf)
    for k, element in enumerate(site.elements):
        corners = mesh.corners[element]
        offset = mesh.vertices[corners] - site.positions[k]
        gram = np.ascontiguousarray(offset @ metric[element] @ offset.T)
        t = time[myocardium.order[corners]]
        weights = np.linalg.solve(np.vstack([offset.T, np.ones(4)]), [0.0, 0.0, 0.0, 1.0])
        for opposite, face in enumerate(FACES):
            if weights[opposite] < 1e-9:
                continue
            arrival = brute_force(gram[np.ix_(face, face)], t[face], HALVINGS)
            arrivals[k] = min(arrivals[k], arrival)
    return arrivals


class Alternation:
    """Trees and myocardium in turn; a subclass says how the myocardium is solved."""

    def __init__(self, myocardium, trees, points):
        self.myocardium, self.trees = myocardium, trees
        self.located = attach(myocardium, trees, np.reshape(points, (-1, 3))).located
        self.starts = np.cumsum([0, *(len(tree.junctions) for tree in trees)])

    def run(self, root_times, cv, moments):
        """Myocardium, times in the trees, and in how many rounds something changed."""
        entered = [np.full(len(tree.nodes), np.inf) for tree in self.trees]
        for e, tree, root_time in zip(entered, self.trees, root_times, strict=True):
            e[tree.root] = root_time
        previous, stimuli = np.inf, np.array(moments, float)
        for rounds in range(ROUNDS):
            times = [tree_times(t, cv, e) for t, e in zip(self.trees, entered, strict=True)]
            leaves = [t[tree.junctions] for t, tree in zip(times, self.trees, strict=True)]
            fired = np.concatenate([*leaves, stimuli])
            myocardium, arrived = self.solve_myocardium(fired)
            if np.array_equal(np.isinf(myocardium), np.isinf(previous)) and (
                np.abs(myocardium - previous).max() < SETTLED
            ):
                return myocardium, times, rounds
            previous, stimuli = myocardium, np.minimum(stimuli, arrived[self.starts[-1] :])
            for e, tree, first in zip(entered, self.trees, self.starts[:-1], strict=True):
                here = arrived[first : first + len(tree.junctions)]
                e[tree.junctions] = np.minimum(e[tree.junctions], here)
        raise AssertionError(f"the alternation did not settle in {ROUNDS} rounds")


class Straight(Alternation):
    """Sites offer vertices and other sites the ray travel time; then updates on the mesh.

    Stimuli do everywhere, junctions as far as `fascicle.forward.eikonal.myocardium` says: to
    the corners of their elements and what is in reach, and to sites in elements all of whose
    corners they come to.
    """

    def __init__(self, myocardium, trees, points):
        super().__init__(myocardium, trees, points)
        vertices, site = heart_vertices(myocardium), self.located
        corners = myocardium.order[myocardium.mesh.corners[site.elements]]
        self.rays = np.empty((len(site.elements), len(vertices) + len(site.elements)))
        for k, (position, element) in enumerate(zip(site.positions, site.elements, strict=True)):
            everywhere = ray_times(myocardium, position, element, [*vertices, *site.positions])
            near = everywhere[: len(vertices)].copy()
            if k < self.starts[-1]:
                longest = myocardium.travel_times.longest
                near[:] = ray_times(myocardium, position, element, vertices, longest=longest)
                near[
                    np.linalg.norm(vertices - position, axis=1) > myocardium.travel_times.reach
                ] = np.inf
                near[corners[k]] = everywhere[corners[k]]
            known = np.isfinite(near[corners]).all(axis=1)
            beside = np.where(known, everywhere[len(vertices) :], np.inf)
            self.rays[k] = np.concatenate([near, beside])

    def solve_myocardium(self, fired):
        offers = (fired[:, None] + self.rays).min(axis=0)
        vertices = len(self.myocardium.mesh.vertices)
        first = offers[:vertices]
        sources = {int(v): float(first[v]) for v in np.flatnonzero(np.isfinite(first))}
        time = solve_without_trees(self.myocardium, sources)
        return time, np.minimum(offers[vertices:], read(self.myocardium, self.located, time))


class Swept(Alternation):
    """The sweep solves the myocardium, in which each junction is a tree of its own.

    A segment of 1 ms that leads to where the junction is fires it, and shows what arrives there.
    """

    def __init__(self, myocardium, trees, points):
        super().__init__(myocardium, trees, points)
        self.points = points
        self.single = [
            line_tree(np.add(leaf, [[0, 0, 1.0], [0, 0, 0]]))
            for tree in trees
            for leaf in tree.nodes[tree.junctions]
        ]

    def solve_myocardium(self, fired):
        leaves, stimuli = np.split(fired, [len(self.single)])
        activation = activate(
            self.myocardium, self.single, leaves - 1.0, 1.0, stimuli=self.points, times=stimuli
        )
        arrived = np.array([times[1] for times in activation.trees])
        return activation.myocardium, np.concatenate([arrived, stimuli])


def assert_same(myocardium, trees, solver, root_times, cv, stimuli, moments):
    """One sweep, and trees and myocardium in turn until nothing changes."""
    swept = activate(myocardium, trees, root_times, cv, stimuli=stimuli, times=moments)
    limit, times, rounds = solver(myocardium, trees, stimuli).run(root_times, cv, moments)
    assert rounds > 1, "a case in which nothing is entered backwards proves nothing"
    assert any(flags.any() for flags in swept.retrograde)
    np.testing.assert_allclose(swept.myocardium, limit, atol=SAME, rtol=0)
    for one, other in zip(swept.trees, times, strict=True):
        np.testing.assert_allclose(one, other, atol=SAME, rtol=0)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("fibre", [(1.0, 0.0, 0.0), (2.0, 1.0, 0.4)], ids=["along", "oblique"])
def test_on_a_slab_one_sweep_is_the_limit_of_trees_and_slab_in_turn(seed, fibre):
    """A stimulus in the tissue, before the one root fires; the other is silent."""
    myocardium = box_tissue(SLAB, (10, 7, 2), jitter=0.2, fibre=fibre)
    trees, stimulus = [star_tree(seed, 6), star_tree(seed + 100, 5)], [[2.0, 3.0, 2.0]]
    assert_same(myocardium, trees, Straight, (np.inf, 30.0), 2.0, stimulus, [1.0])


CASES = [
    ((np.inf, 0.0), [], []),  # left bundle branch block
    ((np.inf, np.inf), [100, 2000], [0.0, 25.0]),  # paced at two vertices, both roots silent
]


@pytest.mark.parametrize(("root_times", "vertices", "moments"), CASES)
def test_on_a_heart_one_sweep_is_the_limit_of_sweeps_in_turn(
    crtdemo_model, root_times, vertices, moments
):
    """Junctions that the front enters backwards are what a one-pass scheme gets wrong."""
    myocardium, trees = crtdemo_model.myocardium, crtdemo_model.grow(SHORT_BUNDLES)
    points = crtdemo_model.heart.vertices[vertices]
    assert_same(myocardium, trees, Swept, root_times, 3.0, points, moments)
