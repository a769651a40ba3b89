"""Predictions that a study keeps: the same as simulated ones, and never those of another study."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pytest

from fascicle.core.declared import SpeedFactor
from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import PRIMITIVES, Primitive, Scenario
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network
from fascicle.prediction.comparison import compare
from fascicle.prediction.scenarios import predict
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Population

ROOT_TIMES = np.array([-50.0, -20.0])


class Study(FittedStudy):
    """As much of a fitted study as predictions see."""

    def networks(self, progress=None, recording=0, chosen=None):
        every = range(len(self.population)) if chosen is None else chosen
        parameters = [self.simulator.prior.fixed | self.population.parameters(k) for k in every]
        gains = [1.0 if self.gains is None else self.gains[k] for k in every]
        simulations = [self.simulator.model.simulate(p) for p in parameters]
        return [
            Network(p, s, s.leads, 1.0, 1.0, drawn_gain=g)
            for p, s, g in zip(parameters, simulations, gains, strict=True)
        ]


@pytest.fixture
def study(default_model, simulated_by, tmp_path):
    fixed = {n: v for n, v in EXAMPLE_PARAMETERS.items() if n != "root_time"}
    simulator = PointSimulator(default_model, Prior(NETWORK_SPACE, fixed))
    recording = simulated_by[1]
    best = {"root_time": -20.0}
    config = SimpleNamespace(model_dump_json=lambda: "{}")
    on_disk = SimpleNamespace(folder=tmp_path, config=config)
    population = Population({"root_time": ROOT_TIMES}, np.ones(2), best, 1.0)
    return Study(on_disk, simulator, (recording,), population)


@pytest.fixture
def activated(monkeypatch):
    """What the forward model activates."""
    called = []
    activate = ForwardModel.activate

    def counted(model, *args, **kwargs):
        called.append(kwargs["scenario"])
        return activate(model, *args, **kwargs)

    monkeypatch.setattr(ForwardModel, "activate", counted)
    return called


PACINGS = ["his-pacing", "rv-apical-pacing"]


def assert_same(one, other):
    assert list(one) == list(other)
    for a, b in zip(one.values(), other.values(), strict=True):
        assert a.scenario == b.scenario
        for k, (x, y) in enumerate(zip(a.beats, b.beats, strict=True)):
            np.testing.assert_array_equal(a.filtered(k), b.filtered(k))
            assert x.onset == y.onset
            for what in ("leads", "activation", "captured"):
                np.testing.assert_array_equal(getattr(x, what), getattr(y, what))
            for tree, twin in zip(x.trees, y.trees, strict=True):
                np.testing.assert_array_equal(tree.nodes, twin.nodes)
            for times, too in zip(x.coupled.trees, y.coupled.trees, strict=True):
                np.testing.assert_array_equal(times, too)
        for name, values in a.indices.items():
            np.testing.assert_array_equal(values, b.indices[name])


def test_nothing_is_simulated_twice(study, activated):
    first = predict(study, PACINGS)
    assert len(activated) == 2 + 2 * 2  # two networks, each in its intrinsic beat and two pacings
    activated.clear()
    again = predict(study, PACINGS)
    assert not activated
    assert_same(first, again)
    comparison = compare(again["his-pacing"], first["intrinsic"], "total_activation_time")
    assert comparison.reductions.shape == (2,)


def test_what_is_missing_is_simulated_and_the_order_is_that_asked_for(study, activated):
    predict(study, "rv-apical-pacing")
    activated.clear()
    found = predict(study, PACINGS)
    assert list(found) == ["intrinsic", *PACINGS]
    assert len(activated) == 2 + 2  # the networks, and both in his-pacing


def test_those_of_another_population_are_not_taken_and_are_removed(study, activated):
    values = {"root_time": ROOT_TIMES - 5}
    other = replace(study, population=replace(study.population, values=values))
    before, after = (predict(s, "his-pacing")["intrinsic"].beats[0] for s in (study, other))
    assert len(activated) == 2 * (2 + 2)
    assert not np.array_equal(before.activation, after.activation)
    left = list((study.folder / "predictions").iterdir())
    assert len(left) == 2  # the intrinsic beat and the pacing


def test_other_gains_are_another_population(study):
    one = predict(replace(study, gains=np.array([1.0, 2.0])), "his-pacing")["his-pacing"]
    two = predict(replace(study, gains=np.array([1.0, 3.0])), "his-pacing")["his-pacing"]
    np.testing.assert_allclose(two.beats[1].leads, 1.5 * one.beats[1].leads)


def test_what_another_version_has_left_is_made_anew(study, activated, monkeypatch):
    predict(study, "his-pacing")
    monkeypatch.setattr("fascicle.core.files.VERSION", "another")
    activated.clear()
    predict(study, "his-pacing")
    assert len(activated) == 2 + 2


def test_primitives_of_the_user_are_simulated_each_time(study, activated):
    """What they do may have changed."""

    class Slower(Primitive, table="slower"):
        factor: Annotated[SpeedFactor, "factor on the speed"] = 0.5

        def apply(self, excitation):
            excitation.slow(0, np.ones(len(excitation.trees[0].nodes), bool), self.factor)

    try:
        scenarios = {"slow": Scenario((Slower(),))}
        before = predict(study, scenarios)["slow"]
        Slower.apply = lambda self, excitation: None
        activated.clear()
        after = predict(study, scenarios)
        assert activated == [None] * 2 + [scenarios["slow"]] * 2  # two networks, then both in it
        assert not np.array_equal(after["slow"].beats[0].activation, before.beats[0].activation)
    finally:
        del PRIMITIVES["slower"]


@pytest.mark.parametrize("share", [0.5, None])
def test_files_that_are_damaged_or_have_other_sizes_are_none(study, activated, share):
    first = predict(study, "his-pacing")
    for file in (study.folder / "predictions").iterdir():
        if share is None:
            with np.load(file) as content:
                arrays = {name: content[name] for name in content.files}
            np.savez(file, **(arrays | {"indices": arrays["indices"][1:]}))
        else:
            content = file.read_bytes()
            file.write_bytes(content[: int(share * len(content))])
    activated.clear()
    assert_same(first, predict(study, "his-pacing"))
    assert len(activated) == 2 + 2
