"""The examples of docs/extending.md that concern the forward model."""

import pickle

import numpy as np
import pytest
from anatomies import NETWORK

import fascicle
from fascicle.core.quantities import QUANTITIES
from tests.test_extending import example


@pytest.fixture(autouse=True)
def small(small_heart, tmp_path, monkeypatch):
    """In an empty folder, the small heart in place of the packaged one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fascicle.forward.model.as_heart", lambda name: small_heart)
    monkeypatch.setattr("fascicle.EXAMPLE_PARAMETERS", NETWORK)


def test_an_action_potential_from_a_table():
    peaks = example("Action potential")["peaks"]
    assert 0.5 < peaks[2.0] < peaks[1.0] < 5.0


def test_a_cell_model():
    """Its upstroke is slower than the built-in one's, and so is its front."""
    names = example("Cell model")
    potential = names["potential"]
    assert 0.1 < potential.speed < 0.78
    assert np.ptp(potential.potentials) == pytest.approx(105.0, abs=8.0)
    assert 0.2 < float(abs(names["beat"].ecg).max()) < 5.0


def test_a_growth_rule(small_model, monkeypatch, emulated):
    """Without its own term it is the built-in one; a card leaves it to the processor."""
    from fascicle.forward.device.backend import GpuBackend

    monkeypatch.setitem(QUANTITIES, "apical_attraction", None)  # as it was, afterwards
    del QUANTITIES["apical_attraction"]
    names = example("Growth rule")
    plain = {**fascicle.EXAMPLE_PARAMETERS, "apical_attraction": 0.0}
    for found, expected in zip(
        names["model"].grow(plain), small_model.grow(fascicle.EXAMPLE_PARAMETERS), strict=True
    ):
        np.testing.assert_array_equal(found.nodes, expected.nodes)
    assert names["nodes"][0.0] != names["nodes"][0.2]
    assert "growth rule" in GpuBackend.on(emulated, 1).refusal(names["model"], [])


def test_the_values_of_a_growth_rule_are_checked():
    rules = fascicle.GrowthRules()
    assert rules.with_values({"repulsion": 0.3}).term.values == (0.3,)
    assert pickle.loads(pickle.dumps(rules)) == rules
    with pytest.raises(fascicle.InputError, match="repulsion"):
        rules.with_values({"repulsion": 11.0})
