"""What conduction states block, alone and under pacing."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import fascicle
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.errors import ValueRefusedError
from fascicle.forward.scenario_files import read_scenarios


def simulated(model, conduction, scenario=None):
    if scenario is not None:
        (scenario,) = read_scenarios(scenario).values()
    return model.simulate({**fascicle.EXAMPLE_PARAMETERS, "conduction": conduction}, scenario)


def duration(*given):
    return np.ptp(simulated(*given).activation)


@pytest.mark.parametrize(
    "state",
    [
        "left bundle branch block",
        "right bundle branch block",
        "left anterior fascicular block",
        "left posterior fascicular block",
    ],
)
def test_a_state_is_the_scenario_of_the_same_name(default_model, state):
    blocked = simulated(default_model, state)
    (scenario,) = read_scenarios(state.replace(" ", "-")).values()
    expected = default_model.simulate(fascicle.EXAMPLE_PARAMETERS, scenario)
    assert_array_equal(blocked.leads, expected.leads)
    number = CONDUCTION_STATES[state].number
    assert_array_equal(simulated(default_model, number).leads, blocked.leads)
    usual = simulated(default_model, "normal")
    assert np.abs(blocked.activation - usual.activation).max() > 5


@pytest.mark.parametrize("state", ["left bundle branch delay", "intraventricular delay"])
def test_delays_are_in_other_quantities(default_model, state):
    usual = simulated(default_model, "normal")
    assert_array_equal(simulated(default_model, state).leads, usual.leads)


def test_pacing_keeps_the_block(default_model):
    """Paced below it, the other ventricle is reached through the tissue alone."""
    paced, state = "left-bundle-branch-pacing", "right bundle branch block"
    free, kept = duration(default_model, "normal", paced), duration(default_model, state, paced)
    assert kept > free + 10
    above = "his-pacing-uncorrected"
    assert duration(default_model, state, above) == pytest.approx(duration(default_model, state))


def test_pacing_that_recruits_a_branch_does_not(default_model):
    state = "right bundle branch block"
    his = [duration(default_model, each, "his-pacing") for each in ("normal", state)]
    assert his[0] == his[1]


def test_a_fascicle_stays_blocked_whatever_is_paced(default_model):
    state = "right bundle branch and left anterior fascicular block"
    recruited = simulated(default_model, state, "his-pacing")
    both, usual = (
        simulated(default_model, each, "his-pacing")
        for each in ("left anterior fascicular block", "normal")
    )
    assert_array_equal(recruited.leads, both.leads)
    assert np.abs(recruited.activation - usual.activation).max() > 5


def test_an_unknown_state(default_model):
    with pytest.raises(ValueRefusedError, match="did you mean 'left bundle branch block'"):
        simulated(default_model, "left bundle branch blok")
    with pytest.raises(ValueRefusedError, match="'conduction' is 'none'; give one of normal, left"):
        simulated(default_model, "none")
