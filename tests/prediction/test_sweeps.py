"""Families of scenarios: what moves, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.core.errors import InputError
from fascicle.forward.scenario import His, Scenario, Stimulus
from fascicle.prediction.sweeps import DELAY, SEGMENT, delays, segments

HIS = His(time=np.inf)
PAIR = Scenario((Stimulus(5.0, site="rv apex"), Stimulus(10.0, (1.0, 2.0, 3.0))), his=HIS)


def test_delays_move_the_last_stimulus():
    found = delays(PAIR, "-20:20:10")
    assert found.varied == DELAY
    assert list(found.scenarios) == [-20, -10, 0, 10, 20]
    for delay, scenario in found.scenarios.items():
        assert scenario.stimuli[0] == PAIR.stimuli[0]
        assert scenario.stimuli[1] == Stimulus(5.0 + delay, (1.0, 2.0, 3.0))
        assert scenario.his == HIS


def test_segments_move_the_last_stimulus_of_the_tissue():
    case = Scenario((*PAIR.stimuli, Stimulus(0.0, site="left bundle", tree="lv")))
    found = segments(case, "epicardium")
    assert found.varied == SEGMENT
    assert list(found.scenarios) == list(range(1, 18))
    for number, scenario in found.scenarios.items():
        assert scenario.stimuli[0] == case.stimuli[0]
        assert scenario.stimuli[1] == Stimulus(10.0, site=f"segment {number:g} epicardium")
        assert scenario.stimuli[2] == case.stimuli[2]


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
        delays(Scenario(PAIR.stimuli[:1]), "0:10:1")
    with pytest.raises(InputError, match="no stimulus of the tissue that could be moved"):
        segments(Scenario((Stimulus(0.0, site="left bundle", tree="lv"),)), "epicardium")
    with pytest.raises(InputError, match="no layer 'middle'; choose endocardium or epicardium"):
        segments(PAIR, "middle")
