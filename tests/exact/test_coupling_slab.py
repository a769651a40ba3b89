"""A straight bundle above a slab, junctions at both ends: every time has a closed form.

The fibres are parallel to the slab's sides, so the straight line from each site is the geodesic:
times are exact as far as rays reach, which is everywhere from a stimulus and 20 mm from a
junction. Wanted: 0.5 ms at edges of 1 mm. Measured: 1e-13 ms within reach and up to 0.45 late
beyond, but where two fronts collide: early by up to `COLLISION`.
"""

import numpy as np
import pytest
from builders import (
    activate,
    box_tissue,
    conduction_for,
    heart_vertices,
    line_tree,
    straight_times,
    vertex_at,
)

ALONG, ACROSS, CV = 0.6, 0.25, 3.0  # mm/ms
LENGTH, WIDTH, DEPTH = 48.0, 12.0, 4.0  # mm; fibres along x
MYOCARDIUM = box_tissue(
    (LENGTH, WIDTH, DEPTH), (48, 12, 4), conduction=conduction_for(ALONG, ACROSS)
)
VERTICES = heart_vertices(MYOCARDIUM)
ENDS = np.array([[0, WIDTH / 2, DEPTH], [LENGTH, WIDTH / 2, DEPTH]])
STIMULUS = np.array([3.3, 5.2, 1.1])
EXACT = 1e-9  # ms
RAYS = MYOCARDIUM.travel_times  # from a junction
LATE = 0.5  # ms, beyond
COLLISION = 0.5  # ms; see `test_point_source`. Measured 0.40, a quarter of a cell
TO_LEFT, TO_RIGHT = straight_times(MYOCARDIUM, STIMULUS, [0.0], at=ENDS)


def bundle(root):
    """Bundle along the slab's top from x = 0 to 48 mm, a node every 2 mm, entered at `root`."""
    x = np.arange(0, LENGTH + 1, 2.0)
    nodes = np.column_stack([x, np.full_like(x, WIDTH / 2), np.full_like(x, DEPTH)])
    return line_tree(nodes, root=root)


def assert_fronts(times, points, moments):
    """The first of several fronts everywhere: exact but beyond reach, and where two meet."""
    each = np.array(
        [straight_times(MYOCARDIUM, [p], [t]) for p, t in zip(points, moments, strict=True)]
    )
    error = times - each.min(axis=0)
    travel = each - np.asarray(moments)[:, None]
    distances = np.linalg.norm(VERTICES - np.asarray(points)[:, None], axis=2)
    stimulus = np.array([[p is STIMULUS] for p in points])
    reached = stimulus | ((distances < RAYS.reach) & (travel < RAYS.longest))
    near = np.take_along_axis(reached, each.argmin(axis=0)[None], axis=0)[0]
    assert error[near].max() < EXACT
    assert error.max() < LATE
    assert error.min() > -COLLISION
    assert np.abs(error[near]).mean() < 0.01
    first, second = np.sort(each, axis=0)[:2]
    alone = near & (second - first > 2 / ACROSS)  # a cell's diagonal away from where they meet
    assert alone.mean() > 0.5
    assert np.abs(error[alone]).max() < EXACT


@pytest.mark.parametrize("root", [12, 5])
def test_anterograde(root):
    """From the middle the fronts meet half way; from elsewhere, off it."""
    activation = activate(MYOCARDIUM, [bundle(root)], [1.0], CV)
    at_ends = 1.0 + np.array([2.0 * root, LENGTH - 2.0 * root]) / CV
    np.testing.assert_allclose(activation.trees[0][[0, -1]], at_ends, rtol=1e-12)
    assert_fronts(activation.myocardium, ENDS, at_ends)
    assert not activation.retrograde[0].any()
    assert activation.entered_by[0].tolist() == [-1, -1]


@pytest.mark.parametrize("root_time", [np.inf, 200.0, TO_LEFT + 8.0])
def test_retrograde_before_the_root_fires(root_time):
    """Bundle-branch block: in at one end, back through the bundle and out at the other.

    In the last case the root fires when the front, which needs 8 ms to it, is on its way: both
    run, and meet in the tree.
    """
    tree = bundle(12)
    activation = activate(MYOCARDIUM, [tree], [root_time], CV, stimuli=STIMULUS, times=[5.0])
    x = tree.nodes[:, 0]
    in_tree = np.minimum(5.0 + TO_LEFT + x / CV, root_time + np.abs(x - x[12]) / CV)
    np.testing.assert_allclose(activation.trees[0], in_tree, atol=EXACT)
    assert_fronts(activation.myocardium, [STIMULUS, ENDS[1]], [5.0, in_tree[-1]])
    assert activation.retrograde[0].tolist() == [True, False]
    assert activation.entered_by[0].tolist() == [2, -1]


@pytest.mark.parametrize(("anterograde", "retrograde"), [(2.0, 3.0), (0.0, 7.0), (4.0, 0.0)])
def test_delays_act_in_their_own_direction_only(anterograde, retrograde):
    tree = bundle(12)
    activation = activate(
        MYOCARDIUM, [tree], [np.inf], CV, stimuli=STIMULUS, times=[0.0],
        anterograde_delay=anterograde, retrograde_delay=retrograde,
    )  # fmt: skip
    entered = TO_LEFT + retrograde
    np.testing.assert_allclose(activation.trees[0], entered + tree.nodes[:, 0] / CV, atol=EXACT)
    out = entered + LENGTH / CV + anterograde
    assert_fronts(activation.myocardium, [STIMULUS, ENDS[1]], [0.0, out])
    assert activation.myocardium[vertex_at(VERTICES, ENDS[1])] == pytest.approx(min(out, TO_RIGHT))


def test_every_junction_has_its_own_delays():
    tree = bundle(12)
    activation = activate(MYOCARDIUM, [tree], [0.0], CV, anterograde_delay=[1.0, 6.0])
    assert_fronts(activation.myocardium, ENDS, [9.0, 14.0])
    np.testing.assert_allclose(activation.trees[0][[0, -1]], 8.0)


def test_infinite_delays_block_one_way():
    """Blocked outwards the right end stays silent; blocked inwards the tree does."""
    tree = bundle(12)
    options = {"stimuli": STIMULUS, "times": [0.0]}
    no_way_out = activate(MYOCARDIUM, [tree], [np.inf], CV, anterograde_delay=np.inf, **options)
    alone = straight_times(MYOCARDIUM, STIMULUS, [0.0])
    np.testing.assert_allclose(no_way_out.myocardium, alone, atol=EXACT)
    np.testing.assert_allclose(no_way_out.trees[0], TO_LEFT + tree.nodes[:, 0] / CV, atol=EXACT)
    no_way_in = activate(MYOCARDIUM, [tree], [np.inf], CV, retrograde_delay=np.inf, **options)
    np.testing.assert_allclose(no_way_in.myocardium, alone, atol=EXACT)
    assert np.isinf(no_way_in.trees[0]).all()
    assert not no_way_in.retrograde[0].any()


@pytest.mark.parametrize("cells", [12, 24])
def test_coarser_slabs_are_as_exact(cells):
    """Cells of 4 and 2 mm: what the tree reads does not depend on the mesh."""
    size, conduction = (LENGTH, WIDTH, DEPTH), conduction_for(ALONG, ACROSS)
    myocardium = box_tissue(size, (cells, cells // 4, cells // 12), conduction=conduction)
    tree = bundle(12)
    activation = activate(myocardium, [tree], [np.inf], CV, stimuli=STIMULUS, times=[0.0])
    np.testing.assert_allclose(activation.trees[0], TO_LEFT + tree.nodes[:, 0] / CV, atol=EXACT)
    exact = straight_times(myocardium, [STIMULUS, ENDS[1]], [0.0, TO_LEFT + LENGTH / CV])
    assert (activation.myocardium - exact).max() < EXACT
