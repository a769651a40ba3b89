"""What a user reads of a refusal, in Python and on the command line."""

import pickle

import pytest

from fascicle.core.errors import InputError, given_in
from fascicle.recording.recording import MissingMetadataError


@pytest.mark.parametrize(
    ("on_the_command_line", "in_python"),
    [
        ("read it with --shared-gain", "read it with shared_gain=True"),
        ("--digits-per-mv 40.5, or --unit uV", "digits_per_mv=40.5, or unit='uV'"),
        ("go on: --leads I,V1; or not", "go on: leads=['I', 'V1']; or not"),
        ("give --swap RA-LA", "give swap=['RA-LA']"),
        ("give it by --onset (ms), or --class", "give it by onset= (ms), or beat_class="),
        ("run 'fascicle fit --steps 9' again (--out)", "run 'fascicle fit --steps 9' again (out=)"),
        ("a--b -- c", "a--b -- c"),
    ],
)
def test_options_are_arguments_in_python(monkeypatch, on_the_command_line, in_python):
    error = InputError(on_the_command_line)
    assert str(error) == in_python
    with pytest.raises(InputError) as info, given_in("a.csv"):
        raise pickle.loads(pickle.dumps(error))  # as another process hands it over
    assert str(info.value) == f"a.csv: {in_python}"
    monkeypatch.setattr(InputError, "names_options", True)
    assert str(info.value) == f"a.csv: {on_the_command_line}"


def test_a_guess_is_what_to_write(monkeypatch):
    error = MissingMetadataError("no unit", "sampling_rate", 500.0, "usual")
    assert str(error) == "no unit; sampling_rate=500 is a guess: usual"
    monkeypatch.setattr(InputError, "names_options", True)
    assert str(error) == "no unit; --sampling-rate 500 is a guess: usual"
