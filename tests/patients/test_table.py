"""Tables of patients: what is read of them, and the line in which something is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from fascicle.core.errors import FileError, InputError
from fascicle.patients.patient import part_of, read_table

HEAD = "patient,heart,recording"
ROW = "anna,default,a.nc"


@pytest.fixture
def read(tmp_path):
    def write(text, name="t.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_table(path, tmp_path / "out")

    return write


def test_what_is_read(read, tmp_path):
    one, other = read(
        "\ufeffpatient,heart,recording,scenario,settings,effective,free_gain,sex,age\r\n"
        'anna, h/1 ,"a,b.nc",s.toml,x.toml,500,true,f,64\r\n,,,,,,,,\r\n\r\n'
        "b-2,default,/e/a.nc,,,,,,\r\n"
    )
    assert (one.name, one.heart, one.recording) == (
        "anna", tmp_path / "h" / "1", tmp_path / "a,b.nc",
    )  # fmt: skip
    assert (one.scenario, one.settings_file) == (tmp_path / "s.toml", tmp_path / "x.toml")
    assert one.settings == {"effective": 500, "free_gain": True}
    assert (one.person, other.person) == ({"sex": "f", "age": 64.0}, {})
    assert (other.heart, other.recording) == ("default", Path("/e/a.nc"))
    assert (other.scenario, other.settings) == (None, {})


@pytest.mark.parametrize("separator", [";", "\t"])
def test_other_separators(read, separator):
    (row,) = read(f"{HEAD}\n{ROW}\n".replace(",", separator))
    assert row.name == "anna"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "t.csv, line 1: column 'patient'"),
        (f"{HEAD}\n\n", "t.csv: has no patient"),
        (b"PK\x03\x04\xff\xfe", "t.csv: is not a table in text"),
        (f'{HEAD}\nanna,"default,a.nc\n', "t.csv: is not a table in text"),
        (f"{HEAD},hart\n{ROW},x\n", "line 1: column 'hart'"),
        (f"{HEAD},heart\n{ROW},x\n", "line 1: column 'heart'"),
        ("patient,heart\nanna,default\n", "line 1: column 'recording'"),
        (f"{HEAD}\n\n{ROW},x\n", "line 3: has other columns than the 3"),
        (f"{HEAD}\n{ROW}\nbert,default\n", "line 3: has other columns"),
        (f"{HEAD}\n{ROW}\nbert,,a.nc\n", "line 3: no heart is given"),
        (f"{HEAD}\n{ROW}\nAnna,default,a.nc\n", "line 3: patient 'Anna' is there twice"),
        (f"{HEAD}\n../x,default,a.nc\n", "line 2: '../x' cannot be the name of a folder"),
        (f"{HEAD}\n{'x' * 101},default,a.nc\n", "cannot be the name of a folder"),
        (f"{HEAD},effective\n{ROW},many\n", "line 2: 'effective' is 'many'"),
        (f"{HEAD},weight\n{ROW},70kg\n", "line 2: could not convert string to float: '70kg'; give"),
        (f"{HEAD}\nanna,default,a\0.nc\n", "line 2: recording is"),
    ],
)
def test_what_is_no_table(read, text, words):
    with pytest.raises(InputError) as caught:
        read(text)
    assert words in str(caught.value)


def test_no_file(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        read_table(tmp_path / "t.csv", tmp_path)


def test_parts_are_all_and_each_once():
    rows = list(range(1, 8))
    assert part_of(rows, None) == rows
    assert part_of(rows, "2/3") == [2, 5]
    assert sorted(row for i in (1, 2, 3) for row in part_of(rows, f"{i}/3")) == rows
    assert part_of(rows, "9/9") == []


@pytest.mark.parametrize("only", ["", "0/3", "4/3", "1", "1/0", "a/b", "1/2/3", "-1/3"])
def test_what_is_no_part(only):
    with pytest.raises(InputError, match="give i/n"):
        part_of([1, 2, 3], only)
