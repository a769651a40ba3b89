"""Families of scenarios: what moves, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from builders import case

from fascicle.core.errors import InputError
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.forward.primitives import His, Stimulus
from fascicle.networks.target_comparison import Network
from fascicle.prediction.comparison import Varied, delays, radii, segments, simulate_sweep

HIS = His(time=np.inf)
PAIR = case((Stimulus(5.0, site="rv apex"), Stimulus(10.0, (1.0, 2.0, 3.0))), his=HIS)


def test_delays_move_the_last_stimulus():
    found = delays(PAIR, "-20:20:10")
    assert found.varied == Varied.DELAY
    first, _ = PAIR.of(Stimulus)
    assert found.scenarios == {
        delay: case((first, Stimulus(5.0 + delay, (1.0, 2.0, 3.0))), his=HIS)
        for delay in (-20, -10, 0, 10, 20)
    }


def test_segments_move_the_last_stimulus_of_the_tissue():
    wide = case((*PAIR.of(Stimulus), Stimulus(0.0, site="left bundle", tree="lv")))
    found = segments(wide, "epicardium")
    assert found.varied == Varied.SEGMENT
    first, _, of_tree = wide.of(Stimulus)
    assert found.scenarios == {
        k: case((first, Stimulus(10.0, site=f"segment {k} epicardium"), of_tree))
        for k in range(1, 18)
    }


@pytest.mark.parametrize(
    "given",
    ["", "1", "0:10", "a:b:c", "0:10:0", "0:10:-1", "10:0:1", "0:0:1", "0:1e9:1", "nan:1:1"],
)
def test_what_is_no_sweep(given):
    with pytest.raises(InputError, match=f"'{given}' ") as caught:
        delays(PAIR, given)
    assert "as -60:60:10" in str(caught.value)


def test_what_cannot_be_moved():
    with pytest.raises(InputError, match="1 stimuli; a delay needs two"):
        delays(case(PAIR.of(Stimulus)[:1]), "0:10:1")
    with pytest.raises(InputError, match="no stimulus of the myocardium, which"):
        segments(case((Stimulus(0.0, site="left bundle", tree="lv"),)), "epicardium")
    with pytest.raises(InputError, match="no layer 'middle'; choose endocardium or epicardium"):
        segments(PAIR, "middle")


def test_radii_are_of_all_stimuli_of_the_tissue():
    bundle = Stimulus(0.0, site="left bundle", tree="lv", radius=1.0)
    found = radii(case((bundle, *PAIR.of(Stimulus))), "0:6:3")
    assert found.varied == Varied.RADIUS
    assert list(found.scenarios) == [0, 3, 6]
    for radius, scenario in found.scenarios.items():
        assert scenario.of(Stimulus)[0] == bundle
        assert [stimulus.radius for stimulus in scenario.of(Stimulus)[1:]] == [radius] * 2
    with pytest.raises(InputError, match="the scenario: no stimulus of the myocardium"):
        radii(case((bundle,)), "0:6:3")


class TestSimulated:
    @pytest.fixture(scope="class")
    def fitted(self, default_model, simulated_by):
        simulator, recording = simulated_by
        own = default_model.simulate(EXAMPLE_PARAMETERS)
        every = [Network(EXAMPLE_PARAMETERS, own, own.leads, 1.0, gain) for gain in range(1, 8)]
        return SimpleNamespace(
            simulator=simulator,
            recordings=(recording,),
            population=every,
            networks=lambda progress, chosen: [every[k] for k in chosen],
        )

    def test_networks_are_spread_over_the_population(self, fitted):
        paced = case((Stimulus(0.0, site="rv free wall"),), inactive=("lv", "rv"))
        found = simulate_sweep(fitted, radii(paced, "0:8:8"), 3)
        assert found.called(8.0) == "8 mm"
        one, other = (found.predicted[radius] for radius in (0.0, 8.0))
        areas = one.indices["qrs_area"]
        np.testing.assert_allclose(areas / areas[0], [1, 4, 7])
        assert (one.indices["total_activation_time"] > other.indices["total_activation_time"]).all()

    def test_a_segment_that_cannot_be_fired_is_named(self, fitted, monkeypatch):
        """The others are simulated; if none can be, the sweep is refused."""
        sites = fitted.simulator.model.sites
        position = type(sites).position

        def lacking(self, name):
            if name.startswith(lost):
                raise InputError(f"'{name}' holds no tissue")
            return position(self, name)

        monkeypatch.setattr(type(sites), "position", lacking)
        sites._known.clear()
        lost = ("segment 3 ", "segment 17 ")
        paced = segments(case((Stimulus(0.0, site="rv apex"),), his=HIS), "endocardium")
        found = simulate_sweep(fitted, paced, 2)
        assert sorted(found.predicted) == [k for k in range(1, 18) if k not in (3, 17)]
        assert found.impossible == {
            k: f"segment {k}: 'segment {k} endocardium' holds no tissue" for k in (3, 17)
        }
        lost = "segment "
        with pytest.raises(InputError, match="segment 1: 'segment 1 endocardium' holds no"):
            simulate_sweep(fitted, paced, 2)
