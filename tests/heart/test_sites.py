"""Named sites lie where their names say, in every heart."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK
from builders import case
from scipy.spatial import cKDTree

from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.core.parameters import EXAMPLE_PARAMETERS, HUMAN_SPACE
from fascicle.forward.primitives import Stimulus
from fascicle.heart.sites import LAYERS, RIGHT, SEGMENTS, Sites


@pytest.fixture(scope="module", params=["default_heart", "crtdemo"])
def sites(request):
    return Sites(request.getfixturevalue(request.param))


def distance(vertices, place):
    return float(cKDTree(vertices).query(place)[0])


def test_of_segments(sites):
    """Within the segment, the inner one nearer to the cavity."""
    heart = sites.heart
    centres = cKDTree(heart.vertices[heart.tetrahedra].mean(axis=1))
    for segment, name in enumerate(SEGMENTS, 1):
        inner, outer = (np.array(sites.position(f"{name} {layer}")) for layer in LAYERS)
        for place in (inner, outer):
            assert sites.places.segment[centres.query(place)[1]] == segment, name
        assert distance(heart.lv.vertices, inner) < distance(heart.lv.vertices, outer)
        assert sites.position(f"segment {segment} {LAYERS[1]}") == tuple(outer)


def test_of_the_right_ventricle(sites):
    heart = sites.heart
    electrodes = dict(zip(ELECTRODES, heart.electrodes, strict=True))
    up = (electrodes["RA"] + electrodes["LA"]) / 2 - electrodes["LL"]
    at = {name: np.array(sites.position(name)) for name in Sites.right}
    centres = cKDTree(heart.vertices[heart.tetrahedra].mean(axis=1))
    for place in at.values():
        assert distance(heart.rv.vertices, place) < 1e-6
    height = {name: float(place @ up) for name, place in at.items()}
    assert height["rv outflow tract"] == max(height.values())
    assert height["rv apex"] == min(height.values())
    left = heart.lv.vertices
    assert distance(left, at["rv septum"]) < 15 < 25 < distance(left, at["rv free wall"])
    wall = sites.places.segment[centres.query(at["rv free wall"], k=8)[1]]
    assert (wall == RIGHT).all()


def test_of_the_left_bundle(default_model, default_heart):
    """On the tree of any network; below the root by so much.

    Even on the shortest bundle that a fit looks at, which is 5 mm long.
    """
    sites = default_model.sites
    shortest = HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5)) | {"lv_initial_length": 5.0}
    long, short = (default_model.grow(each)[0] for each in (EXAMPLE_PARAMETERS, shortest))
    for tree, name, way in (
        (long, "left bundle", 5.0), (long, "left septum", 15.0), (short, "left bundle", 5.0),
    ):  # fmt: skip
        away = np.linalg.norm(tree.nodes - sites.position(name), axis=1)
        away[~tree.parts["bundle"]] = np.inf  # branches come back and lie nearer
        node = int(np.argmin(away))
        assert away[node] < 2.5
        below = 0.0
        while tree.parents[node] >= 0:
            below += tree.lengths[node]
            node = tree.parents[node]
        assert below == pytest.approx(way, abs=2.0)


def test_the_way_of_the_left_bundle_goes_on_to_the_apex(default_heart):
    """Past a direction that is nearer than the site; in a heart that is too small, nowhere."""
    left = default_heart.lv
    away = np.linalg.norm(left.vertices - left.vertices[left.root], axis=1)
    near = int(np.argmin(np.where(away > 5, away, np.inf)))
    close = replace(left, direction=near)
    at = {
        name: np.array(Sites(replace(default_heart, lv=close)).position(name))
        for name in Sites.left
    }
    assert distance(left.vertices, at["left bundle"]) < 1.5
    assert np.linalg.norm(at["left septum"] - at["left bundle"]) == pytest.approx(10, abs=1.5)
    lengths = [np.linalg.norm(place - left.vertices[left.root]) for place in at.values()]
    assert 3 < lengths[0] < 5.01 < 9 < lengths[1] < 15.01
    small = replace(left, vertices=left.vertices / 10)
    with pytest.raises(InputError, match=r"the left apex is \d\.\d mm from the root of the left"):
        Sites(replace(default_heart, lv=small)).position("left septum")


@pytest.mark.parametrize(
    "name", ["", "lv", "segment 0 endocardium", "segment 18 endocardium", "mid anterior", "rv apx"]
)
def test_there_are_no_others(sites, name):
    with pytest.raises(InputError, match=f"there is no site '{name}'; ") as caught:
        sites.position(name)
    assert "\n" not in str(caught.value)
    assert ("did you mean" in str(caught.value)) == (name in ("mid anterior", "rv apx"))


def test_names_of_sites_in_any_case(sites):
    assert sites.position("RV_Apex") == sites.position("rv apex")
    with pytest.raises(InputError, match="did you mean 'rv outflow tract'"):
        sites.position("RVOT")


def test_more_stimuli_than_anybody_has():
    many = (Stimulus(0.0, site="rv apex"),) * 1001
    with pytest.raises(InputError, match="give 1000 at most"):
        case(many)


class TestInScenarios:
    def test_a_radius_fires_all_that_is_near(self, small_model, small_heart):
        stimulus = Stimulus(3.0, site="mid inferior epicardium", radius=8.0)
        paced = small_model.simulate(NETWORK, case((stimulus,), inactive=("lv", "rv")))
        place = small_model.sites.position("mid inferior epicardium")
        away = np.linalg.norm(small_heart.vertices - place, axis=1)
        assert (away <= 8).sum() > 3
        np.testing.assert_allclose(paced.activation[away <= 8], 3.0)
        assert (paced.activation[away > 8] > 3.0).all()

    def test_rays_from_what_is_captured_go_as_far_as_from_junctions(self, small_model):
        """From every captured vertex to every other one there would be hundreds of times as many.

        What that changes: where a ray of more than 20 mm would have been a little faster.
        """
        stimuli = (
            Stimulus(0.0, site="mid inferior epicardium", radius=8.0),
            Stimulus(5.0, site="rv apex", radius=6.0),
        )
        wide = case(stimuli, inactive=("lv", "rv"))
        beat = wide.excitation(small_model.grow(NETWORK), 0.0, {}, small_model.sites)
        assert beat.capture_groups[:2].tolist() == [0, 1]
        assert set(beat.capture_groups[2:]) == {0, 1}
        fired = zip(beat.point_times, beat.points.tolist(), strict=True)
        each = case([Stimulus(*one) for one in fired], inactive=("lv", "rv"))
        far, near = (small_model.simulate(NETWORK, c).activation for c in (each, wide))
        later = near - far
        assert later.min() > -1e-9
        assert 0 < later.max() < 5  # elements are 8 mm long
        assert later.mean() < 0.3

    def test_a_radius_in_a_tree_fires_its_nodes(self, small_model):
        paced = small_model.simulate(
            NETWORK,
            case(
                (Stimulus(2.0, site="left bundle", tree="lv", radius=6.0),), inactive=("lv", "rv")
            ),
        )
        place = small_model.sites.position("left bundle")
        away = np.linalg.norm(paced.trees[0].nodes - place, axis=1)
        times = paced.coupled.trees[0]
        assert (away <= 6).sum() > 3
        assert (times[away <= 6] == 2.0).all()
        assert (times[away > 6] > 2.0).all()

    def test_a_part_of_a_tree_is_fired_where_branches_lie_nearer(self, small_model):
        tree, fired = small_model.grow(NETWORK)[0], {}
        away = np.linalg.norm(tree.nodes - small_model.sites.position("left septum"), axis=1)
        away[tree.parts["bundle"]] = np.inf
        near = tuple(tree.nodes[away.argmin()].tolist())
        for part in (None, "bundle"):
            stimulus = Stimulus(0.0, near, tree="lv", part=part)
            paced = small_model.simulate(NETWORK, case((stimulus,), inactive=("lv", "rv")))
            fired[part] = int(np.argmin(paced.coupled.trees[0]))
        assert paced.trees[0].parts["bundle"][fired["bundle"]]
        assert not paced.trees[0].parts["bundle"][fired[None]]
