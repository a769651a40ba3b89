"""Scenarios over a population, the library of them, and what is made of their activations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import case

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.beat import Beat
from fascicle.forward.primitives import His, Stimulus
from fascicle.forward.scenario import Scenario
from fascicle.forward.scenario_files import find_scenario, library, read_scenario, read_scenarios
from fascicle.networks.target_comparison import Network
from fascicle.prediction.predicted import RINGING, Predicted
from fascicle.prediction.scenarios import (
    LEAD_IN,
    qrs_aligned,
    simulate_scenarios,
    with_intrinsic_beat,
)

OF_THE_TISSUE = (
    "biventricular-pacing", "left-bundle-branch-pacing-nonselective", "left-septal-pacing",
    "left-bundle-optimised-crt", "rv-apical-pacing", "rv-outflow-pacing",
)  # fmt: skip
PARAMETERS = EXAMPLE_PARAMETERS | {"root_time": -50.0, "cv": 2.5}


@pytest.fixture(scope="module")
def networks(default_model):
    each = [PARAMETERS, PARAMETERS | {"cv": 3.0}, PARAMETERS | {"alpha": 0.06}]
    return [Network(p, s := default_model.simulate(p), s.leads, 1.0, 2.0) for p in each]


@pytest.fixture(scope="module")
def predicted(simulated_by, networks):
    names = ["intrinsic", "his-pacing", "left-bundle-branch-block", "left-bundle-branch-pacing"]
    return simulate_scenarios(*simulated_by, networks, read_scenarios(names))


class TestLibrary:
    @pytest.mark.parametrize("name", library())
    def test_every_scenario_runs_captures_and_is_described(self, name, default_model):
        scenario, regions = read_scenario(find_scenario(name))
        assert scenario.description
        assert not regions
        simulation = default_model.simulate(PARAMETERS, scenario)
        assert isinstance(simulation, Beat)
        assert 40 < simulation.qrs_duration < 220
        assert np.isfinite(simulation.activation).all()
        assert simulation.coupled.captured.all()
        assert name not in OF_THE_TISSUE or len(simulation.coupled.captured)

    def test_regions_are_refused(self, tmp_path):
        path = tmp_path / "scar.toml"
        path.write_text("[[region]]\nlabel = 1\nconductivity = 0.0\n")
        with pytest.raises(InputError, match=r"scar.toml: has regions; put them into the heart"):
            read_scenarios([str(path)])


class TestPredicted:
    def test_the_own_beat_is_what_was_learnt(self, predicted, networks):
        for k, (beat, network) in enumerate(
            zip(predicted["intrinsic"].beats, networks, strict=True)
        ):
            own = network.beat
            np.testing.assert_allclose(beat.activation, own.activation, rtol=1e-6, atol=1e-5)
            np.testing.assert_array_equal(beat.leads, 2 * own.leads)
            inside = predicted["intrinsic"].filtered(k)[:, RINGING:-RINGING]
            np.testing.assert_allclose(inside, 2 * own.leads, atol=1e-9)
            assert beat.trees == own.trees
            for times, expected in zip(beat.coupled.trees, own.coupled.trees, strict=True):
                np.testing.assert_allclose(times, expected, rtol=1e-6, atol=1e-5)

    def test_indices_are_counted_from_the_stimulus(self, predicted):
        assert np.isnan(predicted["intrinsic"].indices["qrs_from_stimulus"]).all()
        assert np.isnan(predicted["left-bundle-branch-block"].indices["qrs_from_stimulus"]).all()
        paced = predicted["his-pacing"].indices
        first = [b.activation.min() for b in predicted["his-pacing"].beats]
        latency = paced["qrs_from_stimulus"] - paced["qrs_duration"]
        np.testing.assert_allclose(latency, first, atol=10.0)
        assert ((latency > 30) & (latency < 70)).all()

    def test_pacing_both_bundles_undoes_a_late_left_one(self, predicted):
        intrinsic, his, block, pacing = (prediction.indices for prediction in predicted.values())
        assert (his["total_activation_time"] < intrinsic["total_activation_time"]).all()
        assert (block["lv_rv_delay"] >= intrinsic["lv_rv_delay"]).all()
        assert (pacing["lv_rv_delay"] < 0).all()


def test_a_gain_that_was_drawn_stands_in_place_of_the_best(simulated_by, networks, predicted):
    drawn = replace(networks[0], drawn_gain=3.0)
    found = simulate_scenarios(*simulated_by, [drawn], {"intrinsic": Scenario()})["intrinsic"]
    before = predicted["intrinsic"]
    np.testing.assert_allclose(found.beats[0].leads, 1.5 * before.beats[0].leads)
    assert found.indices["qrs_area"][0] == pytest.approx(1.5 * before.indices["qrs_area"][0])


def test_stimuli_that_capture_nothing_are_seen(simulated_by, networks):
    """One before all fronts, one in the middle of the beat, one with a radius long after it."""
    stimuli = (
        Stimulus(-60.0, site="rv apex"),
        Stimulus(0.0, site="left bundle", tree="lv"),
        Stimulus(300.0, site="segment 12 epicardium", radius=5.0),
    )
    found = simulate_scenarios(*simulated_by, networks, {"late": case(stimuli)})["late"]
    assert [beat.captured.tolist() for beat in found.beats] == [[True, False]] * 3
    np.testing.assert_array_equal(found.captured, [1, 0])


def test_the_own_beat_keeps_its_name(tmp_path):
    path = tmp_path / "intrinsic.toml"
    path.write_text("inactive_root = [{tree = 'rv'}]\n")
    with pytest.raises(InputError, match=r"intrinsic.toml: 'intrinsic' is the intrinsic beat"):
        with_intrinsic_beat(read_scenarios([path]))
    assert list(with_intrinsic_beat(read_scenarios(["his-pacing", "intrinsic"]))) == [
        "intrinsic", "his-pacing",
    ]  # fmt: skip


def test_errors_name_the_file_or_the_scenario(simulated_by, networks, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text("[[stimulus]]\ntime = 0\nsite = 'rv apx'\n")
    with pytest.raises(InputError, match=r"case.toml: there is no site 'rv apx'; did you mean"):
        simulate_scenarios(*simulated_by, networks, read_scenarios([path]))
    far = case((Stimulus(0.0, (1e4, 0.0, 0.0)),))
    with pytest.raises(InputError, match=r"far: stimulus at \(10000, 0, 0\): \d"):
        simulate_scenarios(*simulated_by, networks, {"far": far})


def test_maps_and_percentiles_by_hand():
    """Three networks on five vertices, of which one is reached by two and another by none."""
    times = np.array(
        [
            [0.0, 10.0, 20.0, 30.0, np.inf],
            [5.0, 25.0, 15.0, np.inf, np.inf],
            [0.0, 10.0, 50.0, 20.0, np.inf],
        ]
    )
    beats = [SimpleNamespace(activation=row) for row in times]
    totals = {"total_activation_time": np.array([30.0, 20.0, 50.0])}
    found = Predicted(case(his=His()), beats, totals)
    assert [*found.percentile_networks().values()] == [1, 0, 2]
    totals = {"total_activation_time": np.random.default_rng(0).permutation(np.arange(21.0))}
    numbers = Predicted(case(his=His()), beats, totals).percentile_networks()
    assert {name: totals["total_activation_time"][k] for name, k in numbers.items()} == {
        "5th percentile": 1, "median": 10, "95th percentile": 19,
    }  # fmt: skip
    maps = found.maps
    np.testing.assert_allclose(maps["activation_mean"], [0, 40 / 3, 80 / 3, 25, np.nan])
    np.testing.assert_allclose(maps["activation_sd"][:2], [0, np.std([10, 20, 10])])
    np.testing.assert_allclose(maps["activation_sd"][3], 5.0)
    np.testing.assert_allclose(maps["probability_latest_fifth"], [0, 1 / 3, 1 / 3, 1 / 2, np.nan])


def test_a_steep_filter_changes_the_ecg_and_no_index(simulated_by, networks, predicted):
    target = SimpleNamespace(response=lambda f: np.where(f < 0.03, 1.0, 0.0))
    filtered = simulated_by[0], SimpleNamespace(target=target, scenario=None)
    found = simulate_scenarios(*filtered, networks[:1], {"intrinsic": Scenario()})["intrinsic"]
    for name, values in found.indices.items():
        np.testing.assert_array_equal(values, predicted["intrinsic"].indices[name][:1])
    before, after = predicted["intrinsic"].filtered(0), found.filtered(0)
    assert np.abs(after - before).max() > 0.05 * np.abs(before).max()
    assert np.abs(after[:, :RINGING]).max() > 0  # it rings


def test_ecgs_begin_at_their_onsets(predicted):
    time, (ecgs,) = qrs_aligned(predicted["left-bundle-branch-pacing"])
    assert time[0] == -LEAD_IN
    assert ecgs.shape == (3, 12, len(time))
    strength = np.abs(ecgs).max(axis=(0, 1))
    assert strength[:LEAD_IN].max() < 0.05 * strength.max()
    assert strength[LEAD_IN + 5 : LEAD_IN + 40].max() > 0.1 * strength.max()
    assert strength[-1] < 0.02 * strength.max()
