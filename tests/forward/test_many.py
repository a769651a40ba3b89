"""`simulate_many`: any executor, same results in order, small tasks; and what is remembered."""

import gc
import multiprocessing
import pickle
import weakref
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK
from builders import case

import fascicle.forward.model
from fascicle.core.errors import InputError
from fascicle.core.parameters import Infeasible
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import SlowConduction, Stimulus
from fascicle.heart.conduction import Conduction, Region

SMALL_TASK = 20_000  # bytes
SEVERAL = [
    NETWORK,
    NETWORK | {"root_time": -30.0},
    NETWORK | {"rv_initial_length": 300.0},  # does not fit
    NETWORK | {"lv_fascicle_angle_1": 0.2, "cv": 2.2},
]


class FarAway(Executor):
    """Does everything through pickles, as a cluster does, and weighs them."""

    def __init__(self):
        self.sizes = []

    def submit(self, fn, /, *args, **kwargs):
        task = pickle.dumps((fn, args, kwargs))
        self.sizes.append(len(task))
        there, there_args, there_kwargs = pickle.loads(task)
        future = Future()
        try:
            result = there(*there_args, **there_kwargs)
            future.set_result(pickle.loads(pickle.dumps(result)))
        except Exception as error:  # noqa: BLE001 - what an executor does
            future.set_exception(error)
        return future


@pytest.fixture(scope="module")
def scenario(small_heart):
    place = tuple(small_heart.vertices[168].tolist())
    return case((Stimulus(-5.0, place),), (SlowConduction("lv", 0.0, "bundle"),), inactive=("rv",))


@pytest.fixture(scope="module")
def expected(small_model, scenario):
    """They differ, or else their order would not show."""
    simulations = [small_model.simulate(p, scenario) for p in SEVERAL]
    assert isinstance(simulations[2], Infeasible)
    assert not np.array_equal(simulations[0].activation, simulations[3].activation)
    assert simulations[0].ecg.time.to_numpy()[0] == -5.0
    return simulations


def assert_same(found, expected):
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        if isinstance(other, Infeasible):
            assert one == other
            continue
        np.testing.assert_array_equal(one.activation, other.activation)
        np.testing.assert_array_equal(one.ecg.to_numpy(), other.ecg.to_numpy())
        assert one.ecg.time.equals(other.ecg.time)
        np.testing.assert_array_equal(one.coupled.origin, other.coupled.origin)
        for tree, same in zip(one.trees, other.trees, strict=True):
            np.testing.assert_array_equal(tree.nodes, same.nodes)


def test_threads(small_model, scenario, expected):
    with ThreadPoolExecutor(3) as executor:
        assert_same(small_model.simulate_many(SEVERAL, executor, scenario), expected)


def test_processes(small_model, scenario, expected):
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as executor:
        assert_same(small_model.simulate_many(iter(SEVERAL), executor, scenario), expected)


def test_an_executor_as_a_cluster_has_it(small_model, scenario, expected):
    executor = FarAway()
    assert_same(small_model.simulate_many(SEVERAL, executor, scenario), expected)
    assert len(executor.sizes) == len(SEVERAL)
    assert max(executor.sizes) < SMALL_TASK


def test_settings_of_the_model_go_along(small_heart):
    """Conduction with regions, and growth rules, not only the heart."""
    place = tuple(small_heart.vertices[168].tolist())
    model = ForwardModel(
        small_heart,
        Conduction(alpha=0.07, regions=(Region(0.0, centre=place, radius=12.0),)),
        fascicle.forward.model.GrowthRules(generations=12),
    )
    alone = [model.simulate(p) for p in SEVERAL[:2]]
    assert alone[0].unreached.any()
    assert_same(model.simulate_many(SEVERAL[:2], FarAway()), alone)


def test_two_models_take_turns_in_one_worker(small_model, small_heart):
    """A worker keeps the last model it read, and must not take it for another."""
    fast = ForwardModel(small_heart, Conduction(alpha=0.1))
    for model in (small_model, fast, small_model):
        assert_same(model.simulate_many(SEVERAL[:1], FarAway()), [model.simulate(SEVERAL[0])])


def test_shared_file_is_gone_afterwards(small_model, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    small_model.simulate_many(SEVERAL[:1], FarAway())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("executor", [FarAway, ThreadPoolExecutor])
def test_a_wrong_parameter_is_refused_as_by_simulate(small_model, executor):
    with pytest.raises(InputError, match="unknown parameter 'rooot_time'"):
        small_model.simulate_many([NETWORK | {"rooot_time": 1.0}], executor())


class TestRememberedTrees:
    @pytest.fixture
    def grown(self, monkeypatch):
        """Sides of the trees that are grown from now on."""
        sides, grow = [], fascicle.forward.model.grow_from_parameters

        def spy(side, *args):
            sides.append(side)
            return grow(side, *args)

        monkeypatch.setattr(fascicle.forward.model, "grow_from_parameters", spy)
        return sides

    @pytest.fixture
    def model(self, small_model):
        """With nothing remembered yet."""
        return ForwardModel(small_model.heart, prepared=small_model.prepared)

    def test_speed_and_times_grow_nothing(self, model, grown, small_model):
        model.simulate(NETWORK)
        assert grown == ["lv", "rv"]
        changed = NETWORK | {"cv": 2.3, "root_time": -17.0}
        again = model.simulate(changed)
        model.simulate(changed, case(inactive=("lv",)))
        trees = model.grow(NETWORK)
        assert grown == ["lv", "rv"]
        fresh = ForwardModel(model.heart, prepared=model.prepared).simulate(changed)
        assert_same([again], [fresh])
        assert trees[0] is again.trees[0]

    @pytest.mark.parametrize("name", [n for n in NETWORK if n[:2] in ("lv", "rv")])
    def test_every_other_parameter_grows_anew(self, model, grown, name):
        model.grow(NETWORK)
        model.grow(NETWORK | {name: NETWORK[name] + 0.01})
        assert grown == ["lv", "rv"] * 2

    def test_what_does_not_fit_is_remembered_too(self, model, grown):
        outcomes = [model.simulate(SEVERAL[2] | {"cv": cv}) for cv in (2.0, 3.0)]
        assert grown == ["lv", "rv"]
        assert outcomes[0] == outcomes[1]
        assert isinstance(outcomes[0], Infeasible)

    def test_a_few_are_remembered(self, model, grown):
        angles = 0.1 * np.arange(ForwardModel.networks_kept + 1)
        for angle in angles:
            model.grow(NETWORK | {"lv_fascicle_angle_1": angle})
        grown.clear()
        model.grow(NETWORK | {"lv_fascicle_angle_1": angles[1]})
        assert grown == []
        model.grow(NETWORK | {"lv_fascicle_angle_1": angles[0]})
        assert grown == ["lv", "rv"]

    def test_trees_with_a_scenario_do_not_stay(self, model):
        """An extra tree or stimulus of one call must not be there in the next."""
        before = model.simulate(NETWORK)
        mine = replace(before.trees[0], side="mine")
        place = tuple(model.heart.vertices[168].tolist())
        model.simulate(NETWORK, case((Stimulus(0.0, place),), trees=((mine, 0.0),)))
        after = model.simulate(NETWORK)
        assert_same([after], [before])
        assert len(after.trees) == 2
        assert len(after.coupled.stimuli) == 0


def test_a_model_is_freed_with_its_last_reference(default_heart):
    """Not only when the garbage collector runs: of an atlas, models take gigabytes."""
    model = ForwardModel(default_heart)
    reference = weakref.ref(model)
    gc.disable()
    del model
    freed = reference() is None
    gc.enable()
    assert freed
