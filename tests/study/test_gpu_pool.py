"""A card evaluates as threads do; what it does not simulate is refused, or done on threads."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import fascicle
from fascicle.cli import main
from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.forward import model as model_module
from fascicle.forward.device import batch
from fascicle.forward.device import card as card_module
from fascicle.forward.device.model import DeviceModel
from fascicle.forward.scenario import His, Scenario
from fascicle.forward.simulation import Signals
from fascicle.study import pool as pool_module
from fascicle.study import problem as problem_module
from fascicle.study.fit import _check_card
from fascicle.study.pool import GpuPool, Threads
from fascicle.study.prior_simulations import PriorSimulations
from fascicle.study.study import SAME_LOSS


@pytest.fixture
def card(emulated, default_model, monkeypatch):
    monkeypatch.setattr(pool_module, "card_number", lambda name: 0)
    monkeypatch.setattr(card_module, "Card", lambda name: emulated)
    monkeypatch.setattr(model_module, "DeviceModel", partial(DeviceModel, networks=4))
    monkeypatch.setattr(problem_module, "NETWORKS", 4)
    default_model._device_model.cache_clear()
    yield GpuPool("cuda", workers=2)
    default_model._device_model.cache_clear()


@pytest.fixture(scope="module")
def points():
    longest = NETWORK_SPACE.to_unit(EXAMPLE_PARAMETERS | {"lv_initial_length": 300.0})
    return [*np.random.default_rng(1).uniform(0.2, 0.6, (5, len(NETWORK_SPACE))), longest]


def assert_alike(found, expected, simulated_here=()):
    """As close as a study must find them when it is opened; the same where simulated here."""
    for k, (one, other) in enumerate(zip(found, expected, strict=True)):
        assert one.reason == other.reason
        np.testing.assert_allclose(one.loss, other.loss, rtol=0.1 * SAME_LOSS)
        np.testing.assert_allclose(one.beat_errors, other.beat_errors, rtol=0.1 * SAME_LOSS)
        if other.feasible:
            assert (one.loss == other.loss) == (k in simulated_here)


def test_evaluations(card, problem, points, expected):
    """In batches, in order, and of what does not fit the reason."""
    assert_alike(list(replace(problem, pool=card)(points)), expected)


def test_what_the_bank_has_is_not_simulated(card, problem, points, expected, tmp_path):
    bank = PriorSimulations(tmp_path)
    known = {points[k].tobytes(): Signals.of(problem._simulate(points[k])) for k in (1, 4)}
    bank.get = lambda point: known.get(point.tobytes())
    found = list(replace(problem, pool=card, bank=bank)(points))
    assert_alike(found, expected, simulated_here=(1, 4))


def test_what_is_too_large_is_simulated_here(card, problem, points, expected, monkeypatch):
    monkeypatch.setattr(batch, "MOST_SITES", 100)
    found = list(replace(problem, pool=card)(points))
    assert_alike(found, expected, simulated_here=range(5))


def test_further_recordings_are_simulated_here(card, problem, points):
    """Paced ones beside an intrinsic one."""
    problem = replace(problem, others=(replace(problem, scenario=Scenario(his=His(right=0.0))),))
    alone = list(problem(points[:2]))
    pool_of_all = replace(problem, pool=card, others=(replace(problem.others[0], pool=card),))
    for one, other in zip(pool_of_all(points[:2]), alone, strict=True):
        np.testing.assert_allclose(one.loss, other.loss, rtol=0.1 * SAME_LOSS)
        assert one.loss != other.loss


def test_networks_are_simulated_here(card, problem):
    """With all that a card does not give."""
    (network,) = replace(problem, pool=card).networks([EXAMPLE_PARAMETERS])
    assert network.simulation.coupled.retrograde


def test_what_a_card_does_not_simulate_is_refused_at_once():
    intrinsic, paced = SimpleNamespace(scenario=None), SimpleNamespace(scenario=Scenario(his=His()))
    config = SimpleNamespace(parameter_space=NETWORK_SPACE, fixed={"alpha": 0.07})
    _check_card(config, [intrinsic, paced])
    with pytest.raises(InputError, match="the first recording is of another; put an intrinsic"):
        _check_card(config, [paced, intrinsic])
    config.fixed["lung_conductivity"] = 1.2
    with pytest.raises(InputError, match="'lung_conductivity' changes the lead fields, which a"):
        _check_card(config, [intrinsic])


def test_threads_without_a_number(monkeypatch):
    monkeypatch.setattr(pool_module, "card_number", lambda name: 0)
    assert isinstance(GpuPool(), Threads)
    assert GpuPool().workers >= 1


def test_the_command_says_in_one_line_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(card_module, "find_spec", lambda name: None)
    arguments = ["fascicle", "fit", "default", "target.nc", "--out", f"{tmp_path}/study"]
    for more, message in (
        (["cuda"], "device 'cuda' needs CuPy; install it"),
        (["gpu"], "unknown device 'gpu'; give cuda"),
        (["cuda", "--scheduler", "tcp://a:1"], "two places to simulate in; give one"),
    ):
        monkeypatch.setattr("sys.argv", [*arguments, "--device", *more])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


@pytest.mark.slow
def test_a_fit_on_a_card_is_opened_without_one(card, problem, tmp_path):
    """What threads find again is close enough to what the card found."""
    settings = {"effective": 20, "evaluations": 400, "bank": 200}
    fitted = fascicle.fit("default", problem.target, tmp_path / "study", pool=card, **settings)
    opened = fascicle.load_study(tmp_path / "study")
    for name, values in fitted.population.values.items():
        np.testing.assert_array_equal(values, opened.population.values[name])
