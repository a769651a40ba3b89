"""What no heart and no recording has is refused in one line of four digits, wherever it enters."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import fascicle
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.core.quantities import QUANTITIES
from fascicle.core.ranges import RANGES, check_array, within
from fascicle.forward.scenario import His, Scenario, Slowing, Stimulus
from fascicle.heart.conduction import CONDUCTIVITIES, Conduction, Region
from fascicle.recording.recording import Recording


class Thing:
    """Something that Python writes with its address, here one of many decimal digits."""

    def __repr__(self):
        return "<Thing at 0x7f9755524970>"


HUGE = (1e9, -1e9, 1e308, -1e308, 1e155, np.float32(3e38), 10**400, -(10**5000))
NO_NUMBERS = ("a", [1.0], True, np.array([1.0, 2.0]), Thing())
NONE = (np.nan, np.inf, -np.inf)
IDS = [f"{k}" for k in range(len(HUGE) + len(NO_NUMBERS) + len(NONE))]
PLACE = (0.0, 0.0, 0.0)

# Every way into the model for a number that is no parameter, and whether it may be infinite
ENTRIES = {
    "stimulus time": (lambda x: Stimulus(x, PLACE), False),
    "stimulus position": (lambda x: Stimulus(0.0, (0.0, x, 0.0)), False),
    "stimulus radius": (lambda x: Stimulus(0.0, PLACE, radius=x), False),
    "slowing speed": (lambda x: Slowing("lv", x), False),
    "slowing centre": (lambda x: Slowing("lv", 0.5, centre=(x, 0.0, 0.0), radius=1.0), False),
    "slowing radius": (lambda x: Slowing("lv", 0.5, centre=PLACE, radius=x), False),
    "his time": (lambda x: His(time=x), True),
    "his root time": (lambda x: His(root_time=x), False),
    "his branch": (lambda x: His(left=x), False),
    "anterograde delay": (lambda x: Scenario(anterograde_delay=x), True),
    "region conductivity": (lambda x: Region(x, 1), False),
    "region centre": (lambda x: Region(0.5, centre=(0.0, x, 0.0), radius=1.0), False),
    "region radius": (lambda x: Region(0.5, centre=PLACE, radius=x), False),
    "onset": (lambda x: fascicle.TargetOptions(onset=x), False),
    "offset": (lambda x: fascicle.TargetOptions(offset=x), False),
    "noise": (lambda x: fascicle.TargetOptions(noise=x), False),
    "low-pass": (lambda x: fascicle.TargetOptions(lowpass=x), False),
    "recorder's low-pass": (lambda x: fascicle.TargetOptions(recorder_lowpass=x), False),
    "notch": (lambda x: fascicle.TargetOptions(notch=x), False),
    "sampling rate": (lambda x: Recording(np.zeros((12, 1000)), x, "a.csv"), False),
    **{
        name: (lambda x, name=name: Conduction(**{name: x}), False)
        for name in (*CONDUCTIVITIES, "alpha", "endocardial_layer", "endocardial_speed")
    },
}


def refusal(enter, value):
    """The message with which a value is refused: one line of short numbers."""
    with pytest.raises(InputError) as info:
        enter(value)
    message = str(info.value)
    assert "\n" not in message
    assert len(message) < 250
    assert not re.search(r"\d{7}|\.\d{6}", message)  # no number in full
    return message


@pytest.mark.parametrize("name", ENTRIES)
@pytest.mark.parametrize("value", [*HUGE, *NO_NUMBERS, *NONE], ids=IDS)
def test_of_what_is_given_beside_parameters(name, value):
    enter, infinite = ENTRIES[name]
    if infinite and isinstance(value, float) and value == np.inf:
        enter(value)
        return
    assert "give" in refusal(enter, value) or name in ("sampling rate", "notch")


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("value", [*HUGE, *NO_NUMBERS, *NONE], ids=IDS)
def test_of_parameters(default_model, name, value):
    if name.endswith("_delay") and isinstance(value, float) and value == np.inf:
        return
    parameters = dict(fascicle.EXAMPLE_PARAMETERS)
    message = refusal(lambda x: default_model.simulate(parameters | {name: x}), value)
    assert f"'{name}'" in message


@pytest.mark.parametrize("value", [1e155, -1e9, 100_001.0])
def test_of_a_recording(value):
    signal = np.random.default_rng(0).normal(0, 0.1, (12, 2000))
    signal[LEADS.index("V2"), 700] = value
    message = refusal(lambda x: Recording(x, 1000.0, "a.csv"), signal)
    assert message.startswith("a.csv: a sample")
    assert "give -100000 to 100000 mV" in message


@pytest.mark.parametrize("value", [1e155, 200_000.0])
def test_of_a_target(tmp_path, value):
    import xarray as xr
    from pydicom.data import get_testdata_file

    from fascicle.recording.target_files import write_target

    path = tmp_path / "t.nc"
    recording = fascicle.read_recording(get_testdata_file("waveform_ecg.dcm", download=False))
    write_target(fascicle.make_target(recording), path)
    dataset = xr.load_dataset(path, engine="h5netcdf")
    dataset["beats"][0, 3, 5] = value
    changed = tmp_path / "changed.nc"
    dataset.to_netcdf(changed, engine="h5netcdf")
    message = refusal(fascicle.read_target, changed)
    assert "beats reach" in message


def test_of_what_is_not_finite_in_an_array_others_judge():
    check_array("potential", np.array([np.nan, np.inf, 1.0]), "a sample")
    check_array("potential", np.array([]), "a sample")


@pytest.mark.parametrize("name", RANGES)
def test_ends_are_possible_and_what_is_beyond_is_not(name):
    known = RANGES[name]
    for value in (known.low, known.high, known.also):
        if value is not None:
            assert within(name, value, "it") == value
    for value in (known.low - abs(known.low) - 1e-9, known.high * 1.01):
        if value != known.also:
            with pytest.raises(InputError, match=r"^it is .*; give "):
                within(name, value, "it")


def test_texts():
    for value in (1.0, None, True, b"lv"):
        if value is not None:
            with pytest.raises(InputError, match="give a text"):
                Stimulus(0.0, PLACE, tree=value)
        with pytest.raises(InputError, match="give a text"):
            Slowing(value, 0.5)
        with pytest.raises(InputError, match="give a text"):
            Scenario(silent=(value,))
    for place in ("abc", (1.0, 2.0), 5.0, np.zeros(4)):
        with pytest.raises(InputError, match="three coordinates"):
            Stimulus(0.0, place)


@pytest.mark.parametrize(
    "rules",
    [
        {"clearance": 0.0},
        {"clearance": 0.0, "segments": 1, "generations": 100, "branch_length": 0.5},
        {"generations": 100, "branch_length": 0.5},
        {"segments": 1000, "branch_length": 0.5},
    ],
)
def test_trees_of_no_heart_are_refused_before_they_take_all_memory(default_model, rules):
    parameters = dict(fascicle.EXAMPLE_PARAMETERS) | rules
    message = refusal(lambda x: default_model.simulate(x), parameters)
    assert "tree grows to more than" in message


def test_options_and_python_say_the_same():
    from fascicle.cli.quantities import fixed_values
    from fascicle.core.quantities import checked

    with pytest.raises(InputError) as of_option:
        fixed_values(["root_time=1e9"])
    with pytest.raises(InputError) as of_python:
        checked({"root_time": 1e9})
    assert str(of_option.value) == f"--fix root_time=1e9: {of_python.value}"


def test_a_frozen_scenario_is_checked_when_it_is_changed():
    with pytest.raises(InputError, match="its time"):
        dataclasses.replace(Stimulus(0.0, PLACE), time=1e308)
