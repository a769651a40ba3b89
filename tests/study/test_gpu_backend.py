"""A card evaluates as threads do; what it does not simulate is refused, or done on threads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fascicle
from fascicle.cli import main
from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.forward.device import batch
from fascicle.forward.device import card as card_module
from fascicle.forward.device.backend import GpuBackend
from fascicle.forward.scenario import His, Scenario
from fascicle.forward.simulation import Signals
from fascicle.study.prior_simulations import PriorSimulations
from fascicle.study.study import SAME_LOSS


@pytest.fixture
def backend(emulated):
    return GpuBackend.on(emulated, 4)


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


def test_evaluations(backend, problem, points, expected):
    """In batches, in order, and of what does not fit the reason."""
    assert_alike(list(replace(problem, backend=backend)(points)), expected)


def test_what_the_bank_has_is_not_simulated(backend, problem, points, expected, tmp_path):
    bank = PriorSimulations(tmp_path)
    known = {points[k].tobytes(): Signals.of(problem._simulate(points[k])) for k in (1, 4)}
    bank.get = lambda point: known.get(point.tobytes())
    found = list(replace(problem, backend=backend, bank=bank)(points))
    assert_alike(found, expected, simulated_here=(1, 4))


def test_what_is_too_large_is_simulated_here(backend, problem, points, expected, monkeypatch):
    monkeypatch.setattr(batch, "MOST_SITES", 100)
    found = list(replace(problem, backend=backend)(points))
    assert_alike(found, expected, simulated_here=range(5))


def test_further_recordings_are_simulated_here(backend, problem, points):
    """Paced ones beside an intrinsic one."""
    problem = replace(problem, others=(replace(problem, scenario=Scenario(his=His(right=0.0))),))
    alone = list(problem(points[:2]))
    found = replace(problem, backend=backend)(points[:2])
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_allclose(one.loss, other.loss, rtol=0.1 * SAME_LOSS)
        assert one.loss != other.loss


def test_networks_are_simulated_here(backend, problem):
    """With all that a card does not give."""
    (network,) = replace(problem, backend=backend).networks([EXAMPLE_PARAMETERS])
    assert network.simulation.coupled.retrograde


def test_the_command_says_in_one_line_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(card_module, "find_spec", lambda name: None)
    arguments = ["fascicle", "fit", "default", "target.nc", "--out", f"{tmp_path}/study"]
    for more, message in (
        (["cuda"], "device 'cuda' needs CuPy; install it"),
        (["gpu"], "unknown device 'gpu'; give cuda"),
    ):
        monkeypatch.setattr("sys.argv", [*arguments, "--device", *more])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


@pytest.mark.slow
def test_a_fit_on_a_card_is_opened_without_one(backend, problem, tmp_path):
    """What threads find again is close enough to what the card found."""
    settings = {"effective": 20, "evaluations": 400, "bank": 200}
    fitted = fascicle.fit(
        "default", problem.target, tmp_path / "study", backend=backend, **settings
    )
    opened = fascicle.load_study(tmp_path / "study")
    for name, values in fitted.population.values.items():
        np.testing.assert_array_equal(values, opened.population.values[name])
