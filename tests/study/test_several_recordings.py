"""Several recordings of one heart in a fit: how they are given, kept, compared and said."""

from dataclasses import replace

import arviz as az
import numpy as np
import pytest
from builders import case
from numpy.testing import assert_allclose

import fascicle
from fascicle.cli.options import with_scenario
from fascicle.core.errors import InputError
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.forward.likelihood import QrsLikelihood, cosines, matern, separable
from fascicle.forward.model import ForwardModel
from fascicle.forward.primitives import SlowConduction, Stimulus
from fascicle.forward.scenario_files import find_scenario, read_scenario, scenario_text
from fascicle.networks.prior import Prior
from fascicle.networks.recordings import (
    digests,
    given_recordings,
    read_recordings,
    write_recordings,
)
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import TargetComparison, evaluate
from fascicle.recording.target import Target, smooth_noise
from fascicle.reporting.study import drawings

SMALL = {"prior_simulations": 100, "effective": 20, "workers": 2}
EVERYTHING = case(
    stimuli=(Stimulus(3.5, (1.0, -2.0, 3.0)), Stimulus(0.0, (0.0, 0.0, 1e-3), "rv")),
    slow=(
        SlowConduction("lv", 0.0, part="bundle"),
        SlowConduction("rv", 0.5, None, (1.0, 2.0, 3.0), 4.0),
    ),
    inactive=("lv", "rv"),
    delays={"anterograde": 2.0, "retrograde": np.inf},
)


@pytest.fixture(scope="module")
def model():
    return ForwardModel(fascicle.load_heart("default"))


@pytest.fixture(scope="module")
def paced(model):
    """The right endocardium is stimulated, and no root fires."""
    fire = model.simulate(fascicle.EXAMPLE_PARAMETERS).trees[1].nodes[0]
    nearest = model.heart.vertices[np.linalg.norm(model.heart.vertices - fire, axis=1).argmin()]
    return case(stimuli=(Stimulus(0.0, tuple(map(float, nearest))),), inactive=("lv", "rv"))


def recorded(model, scenario=None, seed=0):
    """A recording of the example network, with ten beats."""
    simulation = model.simulate(fascicle.EXAMPLE_PARAMETERS, scenario)
    clean = np.pad(simulation.leads, ((0, 0), (80, 80)))
    time = np.arange(clean.shape[1]) - 80 + simulation.onset
    beats = clean + smooth_noise(np.random.default_rng(seed), (10, *clean.shape), 0.02)
    first, last = simulation.first_activation, np.nanmax(simulation.activation)
    onset = time[0] + 80 + first
    return Target(beats, time, float(onset), float(last), 60.0, {"source": "made"}, 4.0, 5.0)


@pytest.fixture(scope="module")
def both(model, paced):
    return [recorded(model), (recorded(model, paced, 1), paced)]


def test_scenarios_are_kept_as_text(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(scenario_text(EVERYTHING))
    assert read_scenario(path) == (EVERYTHING, ())


def test_a_scenario_of_the_library_is_given_by_its_name(model):
    (found,) = given_recordings((recorded(model), "rv-apical-pacing"))
    assert found[1] == read_scenario(find_scenario("rv-apical-pacing"))[0]
    with pytest.raises(InputError, match="did you mean 'rv-apical-pacing'"):
        given_recordings((recorded(model), "rv-apicl-pacing"))


def test_a_scenario_with_trees_of_its_own_is_refused(model):
    tree = model.simulate(fascicle.EXAMPLE_PARAMETERS).trees[0]
    with pytest.raises(InputError, match=r"rv\.toml: has trees of its own"):
        scenario_text(case(trees=((tree, 0.0),), source="rv.toml"))


def test_recordings_are_kept(both, tmp_path):
    given = given_recordings(both)
    write_recordings(tmp_path, given)
    assert {path.name for path in tmp_path.iterdir()} == {
        "target.nc", "target-2.nc", "scenario-2.toml",
    }  # fmt: skip
    again = read_recordings(tmp_path, 2)
    assert [*map(digests, again)] == [*map(digests, given)]
    assert digests(given[0])[1] == ""
    assert len({digest for one in given for digest in digests(one)}) == 4


def test_regions_are_the_hearts(both, tmp_path):
    path = tmp_path / "scar.toml"
    path.write_text("[[region]]\nconductivity = 0.0\nlabel = 1\n")
    with pytest.raises(InputError, match=r"scar\.toml: has regions .* heart\.toml"):
        given_recordings([(both[0], path)])


def test_no_recording_is_refused():
    with pytest.raises(InputError, match="no target is given"):
        given_recordings([])


def test_the_papers_method_knows_one_intrinsic_beat(both, tmp_path):
    for given in (both, [both[1]]):
        with pytest.raises(InputError, match="'paper' fits one recording of an intrinsic beat"):
            fascicle.fit("default", given, tmp_path / "s", method="paper")
    assert not (tmp_path / "s").exists()


def test_a_site_outside_the_heart_is_refused_before_anything_is_written(both, tmp_path):
    far = case(stimuli=(Stimulus(0.0, (0.0, 0.0, 900.0)),))
    with pytest.raises(InputError, match="from the"):
        fascicle.fit("default", [both[0], (both[1][0], far)], tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_arguments_of_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert with_scenario("a.nc").name == "a.nc"
    target, scenario = with_scenario("rv-paced.nc:rv.toml")
    assert (target.name, scenario.name) == ("rv-paced.nc", "rv.toml")
    target, scenario = with_scenario("rv-paced.nc:rv-apical-pacing")
    assert (target.name, scenario.name) == ("rv-paced.nc", "rv-apical-pacing")
    assert [each.name for each in with_scenario("rec:rv.toml")] == ["rec", "rv.toml"]
    assert with_scenario("odd:name.nc").name == "odd:name.nc"
    assert with_scenario("rv-paced.nc:").name == "rv-paced.nc:"
    (tmp_path / "odd:name.toml").touch()
    assert with_scenario("odd:name.toml").name == "odd:name.toml"


def likelihood(target):
    modes = cosines(target.qrs.shape[1])
    unit = separable(np.eye(8), matern(len(modes)), modes)
    return QrsLikelihood(target, 1e-4 * np.eye(len(unit)), unit, 0.3, np.zeros((0, 12, 12)))


def test_likelihoods_and_losses_add_up(model, paced, both):
    first, second = (
        TargetComparison(target, scenario, likelihood(target), free_gain=True)
        for target, scenario in ((both[0], None), both[1])
    )
    simulator = PointSimulator(model, Prior(NETWORK_SPACE))
    point = NETWORK_SPACE.to_unit(fascicle.EXAMPLE_PARAMETERS)
    one, other, together, swapped = (
        next(evaluate(simulator, recordings, [point]))
        for recordings in ([first], [second], [first, second], [replace(second, scenario=None)])
    )
    assert together.loss == pytest.approx(one.loss + other.loss)
    assert together.log_likelihood == pytest.approx(one.log_likelihood + other.log_likelihood)
    assert_allclose(together.log_likelihoods, [*one.log_likelihoods, *other.log_likelihoods])
    assert_allclose(together.beat_errors, one.beat_errors)
    # in the other's scenario the same network would not be explained
    assert swapped.log_likelihood < other.log_likelihood - 20
    assert other.loss < 0.1 * second.null_loss


@pytest.mark.slow
def test_a_fit_of_two_recordings(both, tmp_path):
    folder = tmp_path / "study"
    fitted = fascicle.fit("default", both, folder, **SMALL)
    again = fascicle.load_study(folder)
    assert again.verdict == fitted.verdict
    assert fitted.population.log_likelihoods.shape == (20, 2)
    assert "of recording 2" in " ".join(fitted.checks.probabilities)
    found = az.from_netcdf(folder / "posterior.nc")
    assert found.observed_data["ecg_2"].sizes["time_2"] == len(both[1][0].time)
    assert set(found.log_likelihood.data_vars) == {"ecg", "ecg_2"}
    assert {"ecg", "recording", "ecg-2", "recording-2"} <= drawings(again, again.networks()).keys()
    with pytest.raises(InputError, match=r"another study \(other targets: there "):
        fascicle.fit("default", both[0], folder, **SMALL)
