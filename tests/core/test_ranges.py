"""What no heart and no recording has is refused in one line of four digits, wherever it enters."""

import dataclasses
import re

import numpy as np
import pytest
from anatomies import NETWORK
from pydicom.data import get_testdata_file

import fascicle
from fascicle.core.errors import InputError, ValueRefusedError
from fascicle.core.leads import LEADS
from fascicle.core.quantities import QUANTITIES
from fascicle.core.ranges import RANGES, check_array, within
from fascicle.forward.primitives import His, JunctionDelays, SlowConduction, Stimulus
from fascicle.heart.conduction import Conduction, Region
from fascicle.recording.recording import Recording


class Thing:
    """Something that Python writes with its address, here one of many decimal digits."""

    def __repr__(self):
        return "<Thing at 0x7f9755524970>"


WRONG = (1e9, -1e308, np.float32(3e38), 10**400, "a", [1.0], True, np.array([1.0, 2.0]), Thing(),
         np.nan, np.inf)  # fmt: skip
PLACE = (0.0, 0.0, 0.0)

# Every way into the model for a number that is no parameter, and whether it may be infinite
ENTRIES = {
    "stimulus time": (lambda x: Stimulus(x, PLACE), False),
    "stimulus position": (lambda x: Stimulus(0.0, (0.0, x, 0.0)), False),
    "stimulus radius": (lambda x: Stimulus(0.0, PLACE, radius=x), False),
    "slowing speed": (lambda x: SlowConduction("lv", x), False),
    "slowing centre": (
        lambda x: SlowConduction("lv", 0.5, centre=(x, 0.0, 0.0), radius=1.0),
        False,
    ),
    "slowing radius": (lambda x: SlowConduction("lv", 0.5, centre=PLACE, radius=x), False),
    "his time": (lambda x: His(time=x), True),
    "his root time": (lambda x: His(root_time=x), False),
    "his branch": (lambda x: His(left=x), False),
    "anterograde delay": (lambda x: JunctionDelays(anterograde=x), True),
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
        for name in (*Conduction.conductivities, "alpha", "endocardial_layer", "endocardial_speed")
    },
}


def refusal(enter, value):
    """The message with which a value is refused: one line of short numbers."""
    with pytest.raises(InputError) as info:
        enter(value)
    message = str(info.value)
    assert "\n" not in message
    assert len(message) < 350
    assert not re.search(r"\d{7}|\.\d{6}", message)  # no number in full
    return message


@pytest.mark.parametrize("name", ENTRIES)
def test_of_what_is_given_beside_parameters(name):
    enter, infinite = ENTRIES[name]
    for value in WRONG:
        if infinite and isinstance(value, float) and value == np.inf:
            enter(value)
        else:
            refusal(enter, value)


@pytest.mark.parametrize("name", QUANTITIES)
def test_of_parameters(small_model, name):
    for value in WRONG:
        if not (name.endswith("_delay") and isinstance(value, float) and value == np.inf):
            given = NETWORK | {name: value}
            assert f"'{name}'" in refusal(small_model.simulate, given)


def test_of_a_recording():
    signal = np.random.default_rng(0).normal(0, 0.1, (12, 2000))
    signal[LEADS.index("V2"), 700] = 100_001.0
    message = refusal(lambda x: Recording(x, 1000.0, "a.csv"), signal)
    assert message.startswith("a.csv: a sample")
    assert "give -100000 to 100000 mV" in message
    check_array("potential", np.array([np.nan, np.inf, 1.0]), "a sample")  # others judge these
    check_array("potential", np.array([]), "a sample")


def test_of_a_target(tmp_path):
    import xarray as xr

    from fascicle.recording.target_files import write_target

    path, changed = tmp_path / "t.nc", tmp_path / "changed.nc"
    recording = fascicle.read_recording(get_testdata_file("waveform_ecg.dcm", download=False))
    write_target(fascicle.make_target(recording), path)
    dataset = xr.load_dataset(path, engine="h5netcdf")
    dataset["beats"][0, 3, 5] = 1e155
    dataset.to_netcdf(changed, engine="h5netcdf")
    assert "changed.nc" in refusal(fascicle.read_target, changed)


@pytest.mark.parametrize("name", RANGES)
def test_ends_are_possible_and_what_is_beyond_is_not(name):
    known = RANGES[name]
    for value in (known.low, known.high, known.also):
        if value is not None:
            assert within(name, value, "it") == value
    for value in (known.low - abs(known.low) - 1e-9, known.high * 1.01):
        if value != known.also:
            with pytest.raises(ValueRefusedError, match=r"^it is .*; give "):
                within(name, value, "it")


def test_texts_and_places():
    for make in (lambda x: Stimulus(0.0, PLACE, tree=x), lambda x: SlowConduction(x, 0.5)):
        for value in (1.0, True, b"lv"):
            with pytest.raises(ValueRefusedError):
                make(value)
    for place in ("abc", (1.0, 2.0), 5.0, np.zeros(4)):
        with pytest.raises(ValueRefusedError, match="three coordinates"):
            Stimulus(0.0, place)
    with pytest.raises(ValueRefusedError, match="'time'"):  # frozen, and checked when replaced
        dataclasses.replace(Stimulus(0.0, PLACE), time=1e308)


def test_trees_of_no_heart_are_refused_before_they_take_all_memory(small_model):
    endless = NETWORK | {"generations": 100, "branch_length": 0.5}
    assert "tree grows to more than" in refusal(small_model.simulate, endless)


def test_objects_are_shown_on_one_line_without_arrays(small_model):
    simulation = small_model.simulate(NETWORK)
    recording = fascicle.read_recording(get_testdata_file("waveform_ecg.dcm", download=False))
    analysis = fascicle.analyse(recording)
    heart, tree = small_model.heart, simulation.trees[0]
    for thing in (heart, heart.lv, small_model, simulation, tree, recording, analysis,
                  analysis.target):  # fmt: skip
        text = repr(thing)
        assert "\n" not in text
        assert "array" not in text
        assert len(text) < 300
        assert text.startswith(type(thing).__name__)
    assert " × ".join(map(str, analysis.target.beats.shape)) in repr(analysis.target)
    assert f"qrs_onset={analysis.target.qrs_onset:.4g}" in repr(analysis.target)
