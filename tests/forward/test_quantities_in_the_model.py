"""What each quantity does in the forward model, and what is computed again for it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

import igl
import numpy as np
import pytest
from anatomies import NETWORK

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.parameters import HUMAN_SPACE
from fascicle.core.quantities import QUANTITIES, Changes, fascicle_names, stand_ins
from fascicle.forward.electrocardiogram import build_electrocardiograph, unbounded_gradients
from fascicle.heart.conduction import Conduction, Region, share_below
from fascicle.mesh.measures import barycentric_gradients

CV = NETWORK["cv"]
HUMAN = HUMAN_SPACE.from_unit(np.full(len(HUMAN_SPACE), 0.5))


@pytest.fixture(scope="module")
def plain(small_model):
    return small_model.simulate(NETWORK)


def from_junctions(simulation):
    """How long the front took from the junction that fired each vertex (ms)."""
    pairs = zip(simulation.trees, simulation.coupled.trees, strict=True)
    fired = np.concatenate([times[tree.junctions] for tree, times in pairs])
    return simulation.activation - fired[simulation.coupled.origin]


def test_alpha_without_preparing_anew_is_alpha_prepared(small_model, plain):
    """Scaling the clock, against a heart that was prepared for the other speed."""
    other = fascicle.ForwardModel(small_model.heart, Conduction(alpha=0.08))
    fast = NETWORK | {"alpha": 0.08, "retrograde_delay": np.inf}
    scaled, prepared = small_model.simulate(fast), other.simulate(fast)
    # rays are traced to triangles that are within 50 ms, which is farther in the faster heart
    travel = np.maximum(from_junctions(scaled), from_junctions(prepared))
    near = travel < 12
    assert near.mean() > 0.2
    np.testing.assert_allclose(scaled.activation[near], prepared.activation[near], atol=1e-5)
    assert (scaled.activation >= prepared.activation - 1e-5).all()
    assert scaled.total_activation_time < plain.total_activation_time - 5


def test_all_speeds_together_are_the_clock(small_model, plain):
    """With every speed doubled and every delay halved, every time is halved."""
    delays = {"anterograde_delay": 3.0, "retrograde_delay": 5.0, "root_time": -20.0}
    slow = small_model.simulate(NETWORK | delays)
    halved = {name: value / 2 for name, value in delays.items()}
    fast = small_model.simulate(NETWORK | halved | {"cv": 2 * CV, "alpha": 0.1})
    np.testing.assert_allclose(2 * fast.activation, slow.activation, rtol=1e-12)
    for one, other in zip(fast.coupled.trees, slow.coupled.trees, strict=True):
        np.testing.assert_allclose(2 * one, other, rtol=1e-12)


def test_fibre_speed_stands_for_alpha(small_model):
    by_speed = small_model.simulate(NETWORK | {"fibre_speed": 0.9})
    alpha = 0.05 * 0.9 / Conduction().speeds[0]
    by_alpha = small_model.simulate(NETWORK | {"alpha": alpha})
    np.testing.assert_allclose(by_speed.activation, by_alpha.activation, rtol=1e-12)


def first_arrival(simulation, side):
    """When a tree's own front reaches the first of its junctions (ms)."""
    tree, times = simulation.trees[side], simulation.coupled.trees[side]
    return times[tree.junctions].min()


@pytest.mark.parametrize("delay", [-40.0, 0.0, 7.5])
def test_the_interventricular_delay_is_between_first_junctions(small_model, delay):
    """Where nothing comes back from the tissue; whatever the ways from the roots are."""
    alone = {"retrograde_delay": np.inf, "interventricular_delay": delay}
    for values in (HUMAN | alone, HUMAN | alone | {"lv_initial_length": 18.0, "cv": 1.7}):
        found = small_model.simulate(values)
        left, right = (first_arrival(found, side) for side in (0, 1))
        assert right - left == pytest.approx(delay, abs=1e-9)
        roots = [times[t.root] for t, times in zip(found.trees, found.coupled.trees, strict=True)]
        assert min(roots) == 0
        of_root = small_model.with_root_time(values)
        assert of_root["root_time"] == pytest.approx(roots[1] - roots[0], abs=1e-9)
        again = small_model.simulate(of_root)
        np.testing.assert_allclose(again.activation, found.activation, rtol=1e-12)


def test_a_delay_of_trees_that_are_given(small_model):
    trees = small_model.grow(NETWORK)
    found = small_model.activate(trees, cv=CV, interventricular_delay=12.0, retrograde_delay=np.inf)
    assert first_arrival(found, 1) - first_arrival(found, 0) == pytest.approx(12.0, abs=1e-9)
    with pytest.raises(InputError, match="missing parameter root_time; add it"):
        small_model.activate(trees, cv=CV)
    with pytest.raises(InputError, match="missing parameter cv; add it"):
        small_model.activate(trees, 3.0)


def test_a_bundle_that_does_not_fit_has_no_root_time(small_model):
    long = small_model.with_root_time(HUMAN | {"lv_initial_length": 300.0})
    assert isinstance(long, fascicle.Infeasible)


def test_sources_along_fibres_are_those_of_intracellular_anisotropy(small_model, plain):
    """Without them, the ECG of a heart that is isotropic inside, with the same electrodes."""
    found = small_model.simulate(NETWORK | {"axial_source": 0.0})
    np.testing.assert_array_equal(found.activation, plain.activation)
    heart, own = small_model.heart, small_model.conduction
    fields = unbounded_gradients(heart.vertices, heart.tetrahedra, heart.electrodes, own.torso)
    gradients = barycentric_gradients(heart.vertices, heart.tetrahedra)
    isotropic = replace(own, intracellular_l=own.intracellular_t)
    ecg = build_electrocardiograph(
        heart.tetrahedra, gradients, heart.volumes, isotropic.intracellular(heart.fibres),
        fields, small_model.action_potential,
    )  # fmt: skip
    expected = ecg.leads(plain.activation)
    assert np.abs(found.leads - expected).max() < 1e-6 * np.abs(expected).max()
    assert np.abs(found.leads - plain.leads).max() > 0.1 * np.abs(plain.leads).max()
    half = small_model.simulate(NETWORK | {"axial_source": 0.5})
    middle = (found.leads + plain.leads) / 2  # the ECG is linear in its sources
    assert np.abs(half.leads - middle).max() < 1e-6 * np.abs(plain.leads).max()


def test_sources_of_the_right_free_wall(small_model, plain):
    """Without them, the ECG of the rest; with half of them, the mean."""
    ecg, wall = small_model.electrocardiograph, small_model.surfaces.rv_wall
    rest = ecg.scaled(np.where(wall, 0.0, 1.0)).leads(plain.activation)
    none = small_model.with_sources(ecg, {"rv_source": 0.0})
    assert (none.weights[wall] == 0).all()
    np.testing.assert_array_equal(none.weights[~wall], ecg.weights[~wall])
    largest = np.abs(plain.leads).max()
    assert np.abs(none.leads(plain.activation) - rest).max() < 1e-6 * largest
    half = small_model.simulate(NETWORK | {"rv_source": 0.5})
    np.testing.assert_array_equal(half.activation, plain.activation)
    assert np.abs(half.leads - (rest + plain.leads) / 2).max() < 1e-6 * largest
    assert np.abs(rest - plain.leads).max() > 0.05 * largest
    both = small_model.simulate(NETWORK | {"rv_source": 0.5, "axial_source": 0.2})
    axial = small_model.simulate(NETWORK | {"axial_source": 0.2}).leads
    without = small_model.with_sources(ecg, {"rv_source": 0.0, "axial_source": 0.2})
    middle = (without.leads(plain.activation) + axial) / 2
    assert np.abs(both.leads - middle).max() < 1e-6 * largest


def test_sources_of_a_heart_with_scar_are_of_what_conducts(small_heart):
    centre = tuple(small_heart.rv.vertices[100].tolist())
    model = fascicle.ForwardModel(
        replace(small_heart, folder=None),
        Conduction(regions=(Region(0.0, centre=centre, radius=15.0),)),
    )
    scarred = model.conduction.scale(small_heart) == 0
    assert 0 < scarred.sum() < len(scarred)
    ecg = model.electrocardiograph
    found = model.with_sources(ecg, {"rv_source": 0.25})
    ratio = np.abs(found.weights).max(axis=(1, 2)) / np.abs(ecg.weights).max(axis=(1, 2))
    expected = np.where(model.surfaces.rv_wall[~scarred], 0.25, 1.0)
    np.testing.assert_allclose(ratio, expected, rtol=1e-6)


def test_usual_sources_change_nothing(small_model, plain):
    ecg = small_model.electrocardiograph
    assert small_model.with_sources(ecg, {"rv_source": 1.0}) is ecg
    assert small_model.with_sources(ecg, {"cv": 2.0}) is ecg


def test_gain_scales_the_ecg_alone(small_model, plain):
    loud = small_model.simulate(NETWORK | {"gain": 2.5})
    np.testing.assert_allclose(loud.leads, 2.5 * plain.leads)
    np.testing.assert_array_equal(loud.activation, plain.activation)


def test_junction_delay_is_that_of_a_scenario_unless_it_has_its_own(small_model):
    plain = small_model.simulate(NETWORK)
    late = small_model.simulate(NETWORK | {"anterograde_delay": 4.0})
    np.testing.assert_allclose(late.activation, plain.activation + 4.0, atol=4.0)
    assert late.activation.min() == pytest.approx(plain.activation.min() + 4.0, abs=1e-9)
    scenario = fascicle.Scenario([fascicle.JunctionDelays(anterograde=0.0)])
    again = small_model.simulate(NETWORK | {"anterograde_delay": 4.0}, scenario)
    np.testing.assert_array_equal(again.activation, plain.activation)


def test_times_regrow_no_tree_and_prepare_no_tissue(small_model, monkeypatch):
    monkeypatch.setattr("fascicle.forward.model.build_myocardium", None)
    small_model.simulate(NETWORK)
    before = small_model._grow.cache_info().misses
    for known in QUANTITIES.values():
        if known.changes is Changes.TIMES:
            low, high = known.prior_range
            others = {n: v for n, v in NETWORK.items() if n not in stand_ins(known.name)}
            small_model.simulate(others | {known.name: (low + high) / 2})
    assert small_model._grow.cache_info().misses == before


def test_threads_build_each_tissue_once_and_two_at_a_time(small_model, monkeypatch):
    both, built = Barrier(2), []

    def build(heart, conduction, like):
        built.append(conduction)
        both.wait(timeout=20)  # s
        return small_model.myocardium

    model = fascicle.ForwardModel(small_model.heart, prepared=small_model.prepared)
    monkeypatch.setattr("fascicle.forward.model.build_myocardium", build)
    wanted = [replace(model.conduction, anisotropy_ratio=r) for r in (2.0, 3.0, 3.5, 4.0)]
    with ThreadPoolExecutor(4) as pool:
        for pair in (wanted[:2], wanted[2:], wanted[:2]):
            one, other, *again = pool.map(model._tissue, pair * 2)
            assert again[0] is one
            assert again[1] is other
    assert len(built) == len(wanted)


def test_rules_of_growth_are_quantities(small_model):
    few = small_model.simulate(NETWORK | {"generations": 3, "branch_length": 12.0})
    rules = fascicle.GrowthRules(generations=3, branch_length=12.0)
    same = fascicle.ForwardModel(
        small_model.heart, rules=rules, prepared=small_model.prepared
    ).simulate(NETWORK)
    for one, other in zip(few.trees, same.trees, strict=True):
        np.testing.assert_array_equal(one.nodes, other.nodes)


@pytest.mark.parametrize("count", [1, 4])
def test_one_to_four_fascicles(small_model, count):
    values = {n: v for n, v in NETWORK.items() if not n.startswith("lv_fascicle")}
    names = fascicle_names("lv", count)
    values |= dict.fromkeys(names[:count], 15.0)
    values |= dict(zip(names[count:], np.linspace(-0.6, 1.2, count), strict=True))
    left, _ = small_model.grow(values)
    assert sum(part.startswith("fascicle") for part in left.parts) == count


class TestTissue:
    def test_anisotropy(self, small_model, plain):
        """Slower across the fibre: nothing is earlier, and the time of the last rises."""
        more = small_model.simulate(NETWORK | {"anisotropy_ratio": 3.5})
        assert (more.activation >= plain.activation - 0.2).all()
        assert more.total_activation_time > plain.total_activation_time + 5
        assert Conduction(anisotropy_ratio=3.5).speeds[1] == pytest.approx(
            Conduction().speeds[0] / 3.5
        )

    def test_anisotropy_of_the_conductivities_changes_nothing(self, small_model, plain):
        same = small_model.simulate(NETWORK | {"anisotropy_ratio": 2.5})
        np.testing.assert_allclose(same.activation, plain.activation, atol=1e-4)

    def test_endocardial_layer(self, small_model, plain):
        layer = {"endocardial_layer": 2.0, "endocardial_speed": 2.0}
        fast = small_model.simulate(NETWORK | layer)
        assert (fast.activation <= plain.activation + 0.2).all()
        assert fast.activation.mean() < plain.activation.mean() - 1
        heart = small_model.heart
        scale = Conduction(**layer).diffusion_scale(heart)
        assert 1.0 <= scale.min() < scale.max() <= 4.0
        area = sum(igl.doublearea(e.vertices, e.triangles).sum() / 2 for e in heart.endocardia)
        volume = ((scale - 1) / 3 * heart.volumes).sum()
        assert volume == pytest.approx(2.0 * area, rel=0.15)

    def test_a_region_by_its_label_is_the_region(self, small_model):
        heart = small_model.heart
        centroids = heart.vertices[heart.tetrahedra].mean(axis=1)
        labels = (centroids[:, 0] > np.median(centroids[:, 0])).astype(np.int64)
        heart = replace(heart, regions=labels, folder=None)
        by_region = fascicle.ForwardModel(heart, Conduction(regions=(Region(0.25, 1),)))
        by_value = fascicle.ForwardModel(heart, prepared=small_model.prepared)
        parameters = NETWORK | {"region_1_conductivity": 0.25}
        one, other = by_region.simulate(NETWORK), by_value.simulate(parameters)
        np.testing.assert_allclose(one.activation, other.activation, atol=1e-9)
        np.testing.assert_allclose(one.leads, other.leads, atol=1e-9)
        own = Conduction.of(replace(heart, values={"region_1_conductivity": 0.25}))
        assert own == by_region.conduction

    def test_a_region_that_is_not_there(self, small_model):
        with pytest.raises(InputError, match="no labels"):
            small_model.simulate(NETWORK | {"region_1_conductivity": 0.5})


def test_share_of_a_tetrahedron_below_a_level():
    """The spline's distribution function against many random points."""
    rng = np.random.default_rng(0)
    values = np.vstack([rng.random((6, 4)), [0.3, 0.3, 0.3, 0.9], [0.5] * 4, [0.0, 0, 0.6, 0.6]])
    points = rng.dirichlet(np.ones(4), 200_000)
    for level in (0.2, 0.45, 0.7):
        drawn = (points @ values.T < level).mean(axis=0)
        np.testing.assert_allclose(share_below(values, level), drawn, atol=0.005)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cv": -2.8}, "cv"), ({"alpha": 0.0}, "alpha"),
        ({"root_time": [0.0, float("nan")]}, "root_time"), ({"rooot": 1.0}, "rooot"),
    ],
)  # fmt: skip
def test_activate_refuses_what_is_impossible(small_model, plain, wrong, message):
    given = {"root_time": 0.0, "cv": 3.0} | wrong
    with pytest.raises(InputError, match=message):
        small_model.activate(plain.trees, **given)
