"""Directions of left fascicles in the heart, and the way to the first junction."""

import math
from dataclasses import replace

import numpy as np
import pytest
from builders import half_ellipsoid

from fascicle.core.leads import ELECTRODES
from fascicle.core.parameters import EXAMPLE_PARAMETERS, HUMAN_SPACE
from fascicle.heart.endocardium import long_axis
from fascicle.heart.folder import load_heart
from fascicle.heart.sites import Sites
from fascicle.mesh.measures import unit
from fascicle.purkinje.chart import build_chart
from fascicle.purkinje.growth import find_seed, grow_from_parameters, with_angles
from fascicle.purkinje.tree import PurkinjeTree
from tests.purkinje.grown_trees import BARE, on_triangles, stretches

BUNDLE = 12.0  # mm


def grown(surface, directions, axes, length):
    """A tree of two bare fascicles in these directions."""
    _, chart, seed = surface
    parameters = {"lv_initial_length": BUNDLE}
    for k, direction in enumerate(directions, 1):
        parameters |= {f"lv_fascicle_length_{k}": length, f"lv_fascicle_direction_{k}": direction}
    given = with_angles(chart, seed, parameters, *axes)
    assert given.keys() == {name.replace("direction", "angle") for name in parameters}
    return grow_from_parameters("lv", chart, seed, given, BARE)


@pytest.fixture(scope="module", params=["synthetic", "default_heart"])
def left(request):
    """Endocardium, chart and seed; vectors to the apex and to the front."""
    if request.param == "synthetic":
        endocardium = half_ellipsoid(jitter=0.2)
        front = np.array([0.3, -1.0, 0.2])
    else:
        endocardium = request.getfixturevalue("default_heart").lv
        front = request.getfixturevalue("default_model").sites.anterior
    chart = build_chart(endocardium)
    base, apex = long_axis(endocardium.vertices, endocardium.triangles)
    return (endocardium, chart, find_seed(endocardium, chart)), (apex - base, front)


@pytest.mark.parametrize("direction", [0.0, math.pi / 2, -math.pi / 2, 0.7, -1.6])
def test_a_direction_is_an_angle_to_the_apex_in_the_wall(left, direction):
    """In the plane of the triangle in which the bundle ends, from apical to anterior."""
    surface, (apical, anterior) = left
    tree = grown(surface, (direction, direction + math.pi), (apical, anterior), 0.02)
    _, first, second = stretches(tree)
    endocardium = surface[0]
    (triangle,), *_ = on_triangles(endocardium, tree.nodes[first[:1]])
    a, b, c = endocardium.vertices[endocardium.triangles[triangle]]
    normal = unit(np.cross(b - a, c - a))
    to_apex = unit(apical - (apical @ normal) * normal)
    forwards = unit(anterior - (anterior @ normal) * normal - (anterior @ to_apex) * to_apex)
    expected = math.cos(direction) * to_apex + math.sin(direction) * forwards
    found, opposite = (unit(tree.nodes[s[-1]] - tree.nodes[s[0]]) for s in (first, second))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(opposite, -expected, atol=1e-6)


def test_fascicles_go_where_their_directions_say():
    """Over 20 mm, from the bundle towards the apex and the anterior or posterior wall."""
    heart = load_heart("camps-dti004")
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    down, sites = unit(apex - base), Sites(heart)
    at = {wall: np.array(sites.position(f"mid {wall} epicardium"))
          for wall in ("anterior", "inferior")}  # fmt: skip
    assert unit(at["anterior"] - at["inferior"]) @ sites.anterior > 0.9
    chest = heart.electrodes[ELECTRODES.index("V2")] - heart.vertices.mean(axis=0)
    assert (chest - (chest @ down) * down) @ sites.anterior > 0
    chart = build_chart(heart.lv)
    surface, ends = (heart.lv, chart, find_seed(heart.lv, chart)), {}
    for direction in (0.0, 1.2, -1.2):
        tree = grown(surface, (direction, 2.9), (apex - base, sites.anterior), 20.0)
        _, first, _ = stretches(tree)
        ends[direction] = tree.nodes[first[-1]] - tree.nodes[first[0]]
    assert ends[0.0] @ down > 19
    assert max(ends[1.2] @ down, ends[-1.2] @ down) < 5
    across = unit(sites.anterior - (sites.anterior @ down) * down)
    assert ends[1.2] @ across > ends[0.0] @ across + 15
    assert ends[-1.2] @ across < ends[0.0] @ across - 12


def test_angles_are_left_as_they_are(left):
    (_, chart, seed), axes = left
    parameters = EXAMPLE_PARAMETERS | {"rv_fascicle_angle_3": 0.4}
    assert with_angles(chart, seed, parameters, *axes) == parameters


def test_a_network_of_directions_is_that_of_their_angles(default_model):
    values = HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5))
    given = default_model.with_root_time(values)
    assert {n for n in given if "angle" in n} > {f"lv_fascicle_angle_{k}" for k in (1, 2, 3)}
    assert not [name for name in given if "direction" in name or "interventricular" in name]
    for one, other in zip(default_model.grow(values), default_model.grow(given), strict=True):
        np.testing.assert_array_equal(one.nodes, other.nodes)


def plain_way(tree):
    """The shortest way (mm) from the root to a junction, by a sum over each junction's path."""
    ways = []
    for node in map(int, tree.junctions):
        way = 0.0
        while node >= 0:
            way += tree.lengths[node]
            node = int(tree.parents[node])
        ways.append(way)
    return min(ways)


def test_the_way_to_the_first_junction(default_model):
    for trees in (
        default_model.grow(EXAMPLE_PARAMETERS),
        default_model.grow(HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5))),
    ):
        for tree in trees:
            assert tree.to_first_junction == pytest.approx(plain_way(tree), rel=1e-12)
            order = np.random.default_rng(0).permutation(len(tree.nodes))  # as files may have them
            place = np.argsort(order)
            parents = np.where(tree.parents < 0, -1, place[tree.parents])[order]
            mixed = replace(
                tree, nodes=tree.nodes[order], parents=parents, lengths=tree.lengths[order],
                labels=None, triangles=None,
            )  # fmt: skip
            assert mixed.to_first_junction == pytest.approx(tree.to_first_junction, rel=1e-12)


def test_a_lone_root_has_no_junction():
    tree = PurkinjeTree("lv", np.zeros((1, 3)), np.array([-1]), np.zeros(1))
    assert tree.to_first_junction == np.inf


def test_the_end_of_the_first_fascicle_that_ends_counts():
    """A bundle of 10 mm, and fascicles of 7 and 4 mm with nothing behind them."""
    nodes = np.array([[0, 0, 0], [10, 0, 0], [10, 7, 0], [10, -2, 0], [10, -4, 0]], dtype=float)
    parents, lengths = np.array([-1, 0, 1, 1, 3]), np.array([0.0, 10.0, 7.0, 2.0, 2.0])
    assert PurkinjeTree("rv", nodes, parents, lengths).to_first_junction == 14.0
