"""Corrections of a recording: the true leads come back."""

import inspect

import numpy as np
import pytest
import typer

from fascicle.cli.commands import app
from fascicle.cli.recordings import target
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES, LEADS, lead_matrix
from fascicle.recording.choices import TargetOptions, invert, share_gain, swap
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording, derive_limb_leads


@pytest.fixture
def potentials():
    return np.random.default_rng(4).normal(size=(9, 1000))


def recorded(signal, only=None, **more):
    """A recording of all leads, or of some with the other limb leads computed."""
    if only is None:
        return Recording(signal, 500.0, "file", **more)
    signal = signal.copy()
    signal[[k for k, lead in enumerate(LEADS) if lead not in only]] = np.nan
    signal, derived = derive_limb_leads(signal, only)
    return Recording(signal, 500.0, "file", derived=derived, **more)


@pytest.mark.parametrize(
    ("first", "second"), [("RA", "LA"), ("LL", "RA"), ("LA", "LL"), ("V1", "V2")]
)
@pytest.mark.parametrize("only", [None, ("I", "aVF", "V1", "V2")])
def test_reversed_electrodes(potentials, first, second, only):
    exchanged = potentials.copy()
    a, b = ELECTRODES.index(first), ELECTRODES.index(second)
    exchanged[[a, b]] = exchanged[[b, a]]
    wrong = recorded(lead_matrix() @ exchanged, only)
    right = swap(wrong, first, second)
    there = right.recorded
    assert right.signal[there] == pytest.approx((lead_matrix() @ potentials)[there], abs=1e-12)
    assert (there == wrong.recorded).all()
    assert len(right.derived) == len(wrong.derived)
    assert right.provenance["swapped"] == f"{first}-{second}"


def test_inverted_lead_also_mends_those_computed_from_it(potentials):
    true = lead_matrix() @ potentials
    only = ("I", "II", *LEADS[6:])
    wrong_ii = true.copy()
    wrong_ii[1] *= -1
    wrong = recorded(wrong_ii, only)
    assert np.abs(wrong.signal[2] - true[2]).max() > 1
    assert invert(wrong, "II").signal == pytest.approx(true, abs=1e-12)


def test_corrections_follow_one_another(potentials):
    true = lead_matrix() @ potentials
    wrong = true.copy()
    wrong[6:8] = -true[[7, 6]]
    mended = swap(invert(invert(recorded(wrong), "V1"), "V2"), "V1", "V2")
    assert mended.signal == pytest.approx(true, abs=1e-12)
    assert mended.provenance == {"inverted": "V1, V2", "swapped": "V1-V2"}


def test_shared_gain_brings_back_the_digits(potentials):
    true = lead_matrix() @ potentials
    gains = np.linspace(700, 2900, 12)
    stated = recorded(1000 * true / gains[:, None], digits_per_millivolt=gains)
    assert share_gain(stated, 1000).signal == pytest.approx(true, abs=1e-12)
    assert share_gain(stated, 500).signal == pytest.approx(2 * true, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: invert(r, "III"), "III cannot be inverted"),
        (lambda r: swap(r, "RA", "V1"), "cannot swap RA-V1"),
        (lambda r: swap(r, "V1", "V2"), "cannot swap V1-V2"),
        (lambda r: swap(r, "RA", "RA"), "cannot swap RA-RA"),
        (share_gain, "does not state the gain"),
    ],
)
def test_impossible_corrections_are_refused(potentials, change, words):
    with pytest.raises(InputError, match=rf"^file: .*{words}"):
        change(recorded(lead_matrix() @ potentials, ("I", "II", "V1")))


def test_every_option_of_the_command_is_an_argument_in_python():
    command = typer.main.get_command(app).commands["target"]
    own = set(inspect.signature(target).parameters)  # those of every command are others
    reading, deciding = (
        set(inspect.signature(f).parameters) for f in (read_recording, make_target)
    )
    names = {
        each.name: {option.removeprefix("--").replace("-", "_") for option in each.opts}
        for each in command.params
        if each.name in own - {"recording", "out", "kind"}
    }
    names["beat_class"] = {"beat_class"}  # class is a word of Python
    missing = [name for name, spelt in names.items() if not spelt & (reading | deciding)]
    assert len(names) >= 15
    assert missing == []
    assert deciding >= set(inspect.signature(TargetOptions).parameters)


def test_corrections_are_arguments_of_reading(tmp_path):
    data = lead_matrix() @ np.sin(np.arange(1, 10)[:, None] * np.arange(1000) / 200)
    header = ",".join(["time_ms", *(f"{lead}_mV" for lead in LEADS)])
    columns = np.column_stack([2.0 * np.arange(1000), *data])
    np.savetxt(tmp_path / "a.csv", columns, delimiter=",", header=header, comments="", fmt="%.9f")
    plain = read_recording(tmp_path / "a.csv")
    read = read_recording(tmp_path / "a.csv", invert=["V1"], swap=["RA-LA", "V3-v4"])
    assert read.signal[6] == pytest.approx(-plain.signal[6])
    assert read.signal[[0, 8]] == pytest.approx(plain.signal[[0, 9]] * [[-1], [1]])
    with pytest.raises(InputError, match="shared_gain=True"):
        read_recording(tmp_path / "a.csv", digits_per_mv=500)
    with pytest.raises(InputError, match="two names"):
        read_recording(tmp_path / "a.csv", swap=["RA"])
