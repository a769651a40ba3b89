"""Growth: lengths, junctions, clearance, turning sense, repeatability, typed failure."""

import math
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from builders import half_ellipsoid
from grown_trees import ANGLES, BARE, LENGTHS, grow, on_triangles, path_to_root, stretches
from scipy.spatial import cKDTree

from fascicle.core.parameters import Infeasible
from fascicle.mesh.topology import boundary_loops
from fascicle.purkinje.chart import Chart, build_chart
from fascicle.purkinje.growth import GrowthRules, Seed, find_seed, grow_from_parameters
from fascicle.purkinje.tree import PurkinjeTree

REASON = re.compile(
    r"(LV|RV) (bundle|fascicle \d) leaves the endocardium after ([\d.]+) of ([\d.]+) mm, "
    r"at \((-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\) mm on the base"
)
PRINTED = 0.05 + 1e-9  # mm; the reason has one decimal


def test_nodes_lie_on_the_endocardium(surface):
    endocardium, _, _ = surface
    tree = grow(surface)
    _, weights, off = on_triangles(endocardium, tree.nodes)
    assert off.max() < 1e-9  # mm
    assert weights.min() > -1e-9
    np.testing.assert_allclose(tree.nodes[tree.root], endocardium.vertices[endocardium.root])


def test_no_segment_chord_is_longer_than_the_segment(surface):
    tree = grow(surface)
    chords = np.linalg.norm(tree.nodes[1:] - tree.nodes[tree.parents[1:]], axis=1)
    assert (chords <= tree.lengths[1:] * (1 + 1e-9)).all()
    assert np.median(chords / tree.lengths[1:]) > 0.98


def test_trees_change_continuously_with_lengths(surface):
    """0.001 mm more must not jump, also across a whole number of segments; a staircase would."""
    bundle, _ = LENGTHS[surface[0].side]
    nudge = 1e-3  # mm
    for near in (bundle, math.floor(bundle) - nudge / 2):
        one = grow(surface, bundle=near, rules=BARE)
        other = grow(surface, bundle=near + nudge, rules=BARE)
        ends = [
            np.array([tree.nodes[path[-1]] for path in stretches(tree)]) for tree in (one, other)
        ]
        moved = np.linalg.norm(ends[1] - ends[0], axis=1)
        assert 0 < moved.max() < 10 * nudge


@pytest.mark.parametrize("angles", ANGLES)
def test_junctions_are_the_leaves_each_once(surface, angles):
    tree = grow(surface, angles=angles)
    children = np.bincount(tree.parents[tree.parents >= 0], minlength=len(tree.nodes))
    assert tree.junctions.tolist() == np.flatnonzero(children == 0).tolist()
    assert len(np.unique(tree.nodes[tree.junctions].round(6), axis=0)) == len(tree.junctions)
    assert len(tree.junctions) > 20
    assert (tree.parents < np.arange(len(tree.nodes))).all()


def branches(tree):
    """Chain of each node: runs between forks, numbered by their first node."""
    children = np.bincount(tree.parents[tree.parents >= 0], minlength=len(tree.nodes))
    chain = np.arange(len(tree.nodes))
    for node in range(1, len(tree.nodes)):
        if children[tree.parents[node]] == 1:
            chain[node] = chain[tree.parents[node]]
    return chain


def test_foreign_nodes_keep_their_distance(surface):
    """Foreign nodes are 0.9 segment apart, but for kin near their fork.

    Growth measures in the metric of one triangle, and the straight distance may be less where the
    surface bends: measured at most 0.13 % of the nodes have a foreign one within 0.8 mm.
    """
    tree = grow(surface)
    chain = branches(tree)
    fork = tree.parents[chain]  # node each chain starts from
    pairs = cKDTree(tree.nodes).query_pairs(0.8, output_type="ndarray")
    i, j = pairs.T
    kin = (
        (chain[i] == chain[j])
        | (fork[i] == fork[j])
        | (fork[i] == j)
        | (fork[j] == i)
        | (fork[i] == tree.parents[j])
        | (fork[j] == tree.parents[i])
    )
    foreign = pairs[~kin]
    assert len(foreign) <= 0.002 * len(tree.nodes), (len(foreign), len(tree.nodes))


def test_positive_fascicle_angle_turns_counter_clockwise_seen_from_the_blood(surface):
    endocardium, chart, _ = surface
    for angle in (0.8, -0.8):
        tree = grow(surface, angles=(angle, 0.0), rules=BARE)
        bundle, turned, straight = stretches(tree)
        if len(turned) < len(straight):  # leaves come in node order: fascicle 1 first
            pytest.fail("fascicles are not in order")
        fork = bundle[-1]
        heading = tree.nodes[straight[2]] - tree.nodes[fork]
        other = tree.nodes[turned[2]] - tree.nodes[fork]
        centres = endocardium.vertices[chart.triangles].mean(axis=1)
        nearest = np.linalg.norm(centres - tree.nodes[fork], axis=1).argmin()
        a, b, c = endocardium.vertices[chart.triangles[nearest]]
        into_cavity = np.cross(b - a, c - a)
        assert np.sign(np.cross(heading, other) @ into_cavity) == np.sign(angle)


def fork_on_a_plane(repulsion):
    """The two sisters, (n, 2) in mm, that leave the origin of a plane about the x-axis."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    scale = 100.0  # mm
    chart = Chart(
        points=corners,
        vertices=np.column_stack([scale * corners, np.zeros(4)]),
        triangles=np.array([[0, 1, 2], [0, 2, 3]]),
        neighbours=np.array([[-1, 1, -1], [-1, -1, 0]]),
        metric=np.tile([scale**2, 0.0, scale**2], (2, 1)),
    )
    seed = Seed(np.array([-0.2, 0.0]), 1, np.array([1.0, 0.0]))
    rules = GrowthRules(generations=1).with_values({"repulsion": repulsion})
    lengths = {"lv_initial_length": 15.0, "lv_fascicle_length_1": 5.0, "lv_fascicle_angle_1": 0.0}
    tree = grow_from_parameters("lv", chart, seed, lengths, rules)
    return [tree.nodes[tree.labels == label, :2] for label in (2, 3)]


def test_sisters_repel_one_another():
    """The first segments leave at ±0.15 rad; each later one turns away from the sister by w."""
    left, right = fork_on_a_plane(repulsion=0.1)
    assert len(left) == len(right) == GrowthRules().segments
    np.testing.assert_allclose(left[0], [math.cos(0.15), math.sin(0.15)], atol=1e-12)
    heading = left[0] + [0.0, 0.1]  # straight away from the sister's first node
    second = left[0] + heading / np.linalg.norm(heading)
    np.testing.assert_allclose(left[1], second, atol=1e-12)
    straight, _ = fork_on_a_plane(repulsion=0.0)
    assert left[-1, 1] > 2 * straight[-1, 1]
    # one must not see the segment that the other laid a moment ago
    np.testing.assert_allclose(left, right * [1, -1], atol=1e-11)


def test_any_number_of_fascicles():
    endocardium = half_ellipsoid()
    chart = build_chart(endocardium)
    parameters = {"lv_initial_length": 30.0, "cv": 3.0}
    for k in range(1, 12):  # ten and more: sorted as numbers, not as text
        parameters |= {f"lv_fascicle_length_{k}": 2.0 + k, f"lv_fascicle_angle_{k}": 0.1 * k}
    tree = grow_from_parameters("lv", chart, find_seed(endocardium, chart), parameters, BARE)
    lengths = [tree.lengths[path_to_root(tree, leaf)].sum() - 30.0 for leaf in tree.junctions]
    np.testing.assert_allclose(lengths, np.arange(1, 12) + 2.0)


def content(tree):
    return tree.nodes.tobytes() + tree.parents.tobytes() + tree.lengths.tobytes()


def test_threads_that_grow_at_once_grow_what_one_grows_alone(surface):
    """Bitwise: no state is shared between growths."""
    alone = [content(grow(surface, angles=angles)) for angles in ANGLES]
    assert len(set(alone)) == len(ANGLES)
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            together = pool.map(lambda angles: content(grow(surface, angles=angles)), ANGLES)
            assert list(together) == alone


def test_another_process_finds_growth_compiled():
    """After this one has compiled it, or found it."""
    endocardium = half_ellipsoid()
    chart = build_chart(endocardium)
    grow((endocardium, chart, find_seed(endocardium, chart)))
    commands = (
        "from fascicle.forward.preparation import compile_kernels\n"
        "from fascicle.purkinje.growth import REPULSION, _grow\n"
        "compile_kernels(print)\n"
        "stats = _grow(REPULSION.function).stats\n"
        "print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))\n"
    )
    other = subprocess.run([sys.executable, "-c", commands], stdout=-1, text=True, check=True)
    assert other.stdout.split()[-2:] == ["1", "0"]


def test_rounding_of_the_coordinates_does_not_change_the_tree(surface):
    """As another platform's arithmetic may differ: 1e-13 in the surface, at most 1e-6 mm in it."""
    endocardium, _, _ = surface
    tree = grow(surface)
    rng = np.random.default_rng(0)
    same = 0
    for _ in range(5):
        noise = 1 + 1e-13 * rng.uniform(-1, 1, endocardium.vertices.shape)
        other = replace(endocardium, vertices=endocardium.vertices * noise)
        chart = build_chart(other)
        moved = grow((other, chart, find_seed(other, chart)))
        if moved.parents.tolist() == tree.parents.tolist():
            same += 1
            distance = np.linalg.norm(moved.nodes - tree.nodes, axis=1).max()
            assert 0 < distance < 1e-6
    assert same >= 4  # a tie may break the other way, but rarely


def distance_to_base(endocardium, point):
    """Distance (mm) to the polygon that bounds the endocardium."""
    loop = endocardium.vertices[boundary_loops(endocardium.triangles)[0]]
    along = np.roll(loop, -1, axis=0) - loop
    share = np.einsum("ij,ij->i", point - loop, along) / np.einsum("ij,ij->i", along, along)
    nearest = loop + np.clip(share, 0, 1)[:, None] * along
    return np.linalg.norm(nearest - point, axis=1).min()


@pytest.mark.parametrize(
    ("bundle", "fascicles", "stretch"),
    [
        (400.0, (10.0, 10.0), "bundle"),
        (40.0, (400.0, 10.0), "fascicle 1"),
        (40.0, (10.0, 400.0), "fascicle 2"),
    ],
)
@pytest.mark.parametrize("angles", ANGLES[:2])
def test_reason_says_how_far_it_came_and_where_on_the_base(
    surface, bundle, fascicles, stretch, angles
):
    """A tree with just that much of the stretch fits, and ends at that place; more does not fit."""
    endocardium, _, _ = surface
    outcome = grow(surface, bundle, fascicles, angles)
    assert isinstance(outcome, Infeasible)
    side, which, laid, wanted, *where = REASON.fullmatch(outcome.reason).groups()
    assert (side.lower(), which, float(wanted)) == (endocardium.side, stretch, 400.0)
    point = np.array([float(x) for x in where])
    assert distance_to_base(endocardium, point) < np.sqrt(3) * PRINTED

    def with_stretch(length):
        if stretch == "bundle":
            return grow(surface, length, (0.0,), (0.0,), BARE)
        return grow(surface, bundle, (length,), (angles[int(stretch[-1]) - 1],), BARE)

    fits = with_stretch(float(laid) - PRINTED)
    assert isinstance(fits, PurkinjeTree)
    assert isinstance(with_stretch(float(laid) + PRINTED), Infeasible)
    end = fits.nodes[fits.junctions[0]]
    assert np.linalg.norm(end - point) < 2 * PRINTED + np.sqrt(3) * PRINTED


def test_a_fascicle_that_cannot_even_begin_reports_its_own_place(surface):
    """Not the end of the fascicle grown before it: the fork lies just short of the base."""
    endocardium, _, _ = surface
    outcome = grow(surface, 400.0, (0.0,), (0.0,), BARE)
    laid = float(REASON.fullmatch(outcome.reason)[3])
    back, onwards = np.pi, 0.0  # rad
    outcome = grow(surface, laid - 0.4, (20.0, 20.0), (back, onwards), BARE)
    _, which, short, *_, x, y, z = REASON.fullmatch(outcome.reason).groups()
    assert which == "fascicle 2"
    assert float(short) < 0.6
    assert distance_to_base(endocardium, np.array([x, y, z], float)) < np.sqrt(3) * PRINTED
