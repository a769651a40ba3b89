"""Several recordings of one heart in a fit: how they are given, kept, compared and said."""

from dataclasses import replace

import arviz as az
import numpy as np
import pytest
from builders import case, recorded
from numpy.testing import assert_allclose

import fascicle
from fascicle.cli.options import with_scenario
from fascicle.core.errors import InputError
from fascicle.core.parameters import NETWORK_SPACE
from fascicle.forward.likelihood import QrsLikelihood, cosines, matern, separable
from fascicle.forward.primitives import SlowConduction, Stimulus
from fascicle.forward.scenario_files import find_scenario, read_scenario, scenario_text
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import (
    TargetComparison,
    digests,
    evaluate,
    given_recordings,
    read_recordings,
    write_recordings,
)
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
def intrinsic(default_model):
    return default_model.simulate(fascicle.EXAMPLE_PARAMETERS)


@pytest.fixture(scope="module")
def both(default_model, intrinsic):
    """Recordings of an intrinsic beat, and of one in which the right endocardium is stimulated."""
    vertices, fire = default_model.heart.vertices, intrinsic.trees[1].nodes[0]
    nearest = vertices[np.linalg.norm(vertices - fire, axis=1).argmin()]
    paced = case(stimuli=(Stimulus(0.0, tuple(map(float, nearest))),), inactive=("lv", "rv"))
    beat = default_model.simulate(fascicle.EXAMPLE_PARAMETERS, paced)
    return [recorded(intrinsic), (recorded(beat, 1), paced)]


def test_recordings_are_kept(tmp_path, both):
    path = tmp_path / "scenario.toml"
    path.write_text(scenario_text(EVERYTHING))
    assert read_scenario(path) == (EVERYTHING, ())
    path.unlink()
    given = given_recordings(both)
    write_recordings(tmp_path, given)
    assert {path.name for path in tmp_path.iterdir()} == {
        "target.nc", "target-2.nc", "scenario-2.toml",
    }  # fmt: skip
    again = read_recordings(tmp_path, 2)
    assert [*map(digests, again)] == [*map(digests, given)]
    assert digests(given[0])[1] == ""
    assert len({digest for one in given for digest in digests(one)}) == 4


def test_scenarios_by_name_and_recordings_that_are_refused(both, intrinsic, tmp_path):
    (found,) = given_recordings((both[0], "rv-apical-pacing"))
    assert found[1] == read_scenario(find_scenario("rv-apical-pacing"))[0]
    path = tmp_path / "scar.toml"
    path.write_text("[[region]]\nconductivity = 0.0\nlabel = 1\n")
    for given, message in (
        ([], "no target is given"),
        ((both[0], "rv-apicl-pacing"), "did you mean 'rv-apical-pacing'"),
        ([(both[0], path)], r"scar\.toml: has regions .* heart\.toml"),
    ):
        with pytest.raises(InputError, match=message):
            given_recordings(given)
    with pytest.raises(InputError, match=r"rv\.toml: has trees of its own"):
        scenario_text(case(trees=((intrinsic.trees[0], 0.0),), source="rv.toml"))


def test_fits_that_are_refused_before_anything_is_written(both, tmp_path):
    """By the paper's method, which knows one intrinsic beat; a site outside the heart."""
    far = case(stimuli=(Stimulus(0.0, (0.0, 0.0, 900.0)),))
    of_the_paper = "'paper' fits one recording of an intrinsic beat"
    for given, method, message in (
        (both, "paper", of_the_paper),
        ([both[1]], "paper", of_the_paper),
        ([both[0], (both[1][0], far)], "posterior", "from the"),
    ):
        with pytest.raises(InputError, match=message):
            fascicle.fit("default", given, tmp_path / "s", method=method)
    assert not (tmp_path / "s").exists()


def test_arguments_of_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd:name.toml").touch()
    for text in ("a.nc", "odd:name.nc", "rv-paced.nc:", "odd:name.toml"):
        assert with_scenario(text).name == text
    for text in ("rv-paced.nc:rv.toml", "rv-paced.nc:rv-apical-pacing", "rec:rv.toml"):
        assert [each.name for each in with_scenario(text)] == text.split(":")


def likelihood(target):
    modes = cosines(target.qrs.shape[1])
    unit = separable(np.eye(8), matern(len(modes)), modes)
    return QrsLikelihood(target, 1e-4 * np.eye(len(unit)), unit, 0.3, np.zeros((0, 12, 12)))


def test_likelihoods_and_losses_add_up(default_model, both):
    first, second = (
        TargetComparison(target, scenario, likelihood(target), free_gain=True)
        for target, scenario in ((both[0], None), both[1])
    )
    simulator = PointSimulator(default_model, Prior(NETWORK_SPACE))
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
@pytest.mark.usefixtures("plain_tissue")
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
    with pytest.raises(InputError, match=r"another study \(with other further targets; "):
        fascicle.fit("default", both[0], folder, **SMALL)
