"""A card evaluates as threads do; what it does not simulate is refused, or done on threads."""

from dataclasses import replace

import numpy as np
import pytest
from anatomies import NETWORK
from builders import case

import fascicle
from fascicle.cli import main
from fascicle.core.parameters import ParameterSpace, free
from fascicle.forward.device.backend import GpuBackend
from fascicle.forward.device.batch import Simulator
from fascicle.forward.primitives import His
from fascicle.networks.prior import AveragedOver
from fascicle.networks.target_comparison import evaluate, networks
from fascicle.study.study import Study


@pytest.fixture
def backend(emulated):
    return GpuBackend.on(emulated, 4)


def assert_alike(found, expected, simulated_here=()):
    """As close as a study must find them when it is opened; the same where simulated here."""
    for k, (one, other) in enumerate(zip(found, expected, strict=True)):
        assert one.reason == other.reason
        np.testing.assert_allclose(one.loss, other.loss, rtol=0.1 * Study.tolerance)
        np.testing.assert_allclose(one.beat_errors, other.beat_errors, rtol=0.1 * Study.tolerance)
        if other.feasible:
            assert (one.loss == other.loss) == (k in simulated_here)


def evaluated(simulator, recordings, points, backend):
    return list(evaluate(replace(simulator, backend=backend), recordings, points))


@pytest.mark.parametrize(("most_sites", "simulated_here"), [(2048, ()), (100, range(7))])
def test_evaluations(
    backend, simulator, recordings, points, expected, monkeypatch, most_sites, simulated_here
):
    """In batches, in order, and of what does not fit the reason; what is too large, here."""
    monkeypatch.setattr(Simulator, "most_sites", most_sites)
    assert_alike(evaluated(simulator, recordings, points, backend), expected, simulated_here)


def test_other_tissues_are_simulated_here(backend, simulator, recordings, points):
    """The card knows the plain tissue alone."""
    averaged = AveragedOver(tissues=({}, {"anisotropy_ratio": 1.5}))
    several = replace(simulator, prior=replace(simulator.prior, averaged=averaged))
    both = [np.append(points[0], share) for share in (0.2, 0.8)]
    expected = list(evaluate(several, recordings, both))
    assert expected[0].loss != pytest.approx(expected[1].loss, rel=0.01)
    assert_alike(evaluated(several, recordings, both, backend), expected, simulated_here=[1])


class Untouched:
    def refusal(self, model, names):
        return "another source" if "rv_source" in names else ""

    def signals(self, model, parameters):
        raise AssertionError("the card is asked")


def test_what_needs_activation_or_other_sources_is_simulated_here(simulator, points):
    """Whether a network is activated as mapped hearts are; sources that vary."""
    sources = AveragedOver(ParameterSpace((free("rv_source"),)))
    for other, each in (
        (replace(simulator.prior, mapped=True), points[:2]),
        (replace(simulator.prior, averaged=sources), [np.append(points[0], 0.5)]),
    ):
        elsewhere = replace(simulator, prior=other, backend=Untouched())
        assert elsewhere.from_backend(each) == [None] * len(each)
    with pytest.raises(AssertionError, match="the card is asked"):
        replace(simulator, backend=Untouched()).from_backend(points[:2])


def test_sources_of_the_ecg_are_not_of_the_card(model, backend):
    for name in ("rv_source", "axial_source"):
        refusal = backend.refusal(model, ["cv", name])
        assert refusal == f"parameter '{name}' changes the ECG alone"
    assert backend.refusal(model, ["cv", "interventricular_delay", "fibre_speed"]) == ""


def test_further_recordings_are_simulated_here(backend, simulator, recordings, points):
    """Paced ones after an intrinsic one."""
    both = (*recordings, replace(recordings[0], scenario=case(his=His(right=0.0))))
    alone = evaluated(simulator, both, points[:2], None)
    for one, other in zip(evaluated(simulator, both, points[:2], backend), alone, strict=True):
        np.testing.assert_allclose(one.loss, other.loss, rtol=0.1 * Study.tolerance)
        assert one.loss != other.loss


def test_networks_are_simulated_here(backend, simulator, recordings):
    """With all that a card does not give."""
    of_card = replace(simulator, backend=backend)
    (network,) = networks(of_card, recordings[0], [NETWORK])
    assert network.beat.coupled.retrograde


def test_the_command_says_in_one_line_what_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("fascicle.core.errors.find_spec", lambda name: None)
    arguments = ["fascicle", "fit", "default", "target.nc", "--out", f"{tmp_path}/study"]
    for more, message in (
        (["cuda"], "device 'cuda' needs cupy; install it"),
        (["gpu"], "unknown device 'gpu'; give cuda"),
    ):
        monkeypatch.setattr("sys.argv", [*arguments, "--device", *more])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


@pytest.mark.slow
def test_a_fit_on_a_card_is_opened_without_one(backend, model, recordings, tmp_path):
    """What threads find again is close enough to what the card found."""
    settings = {"effective": 20, "prior_simulations": 100}
    settings |= {"parameters": {"conduction": "left bundle branch block"}}
    fitted = fascicle.fit(
        model.heart.folder, recordings[0].target, tmp_path / "study", backend=backend, **settings
    )
    opened = fascicle.load_study(tmp_path / "study")
    for name, values in fitted.population.values.items():
        np.testing.assert_array_equal(values, opened.population.values[name])
