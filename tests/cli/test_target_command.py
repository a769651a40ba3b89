"""`fascicle target` from the command line; the recordings themselves: tests/io."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from pydicom.data import get_testdata_file

from fascicle.io.targets import read_target
from fascicle.leads import LEADS

RATE, SECONDS = 500, 8


def table(path, leads=LEADS, unit="_mV", rate=RATE, seconds=SECONDS, flat=False, nan=False):
    """Write a made-up recording: a QRS each 0.8 s, other sizes in each lead."""
    t = np.arange(rate * seconds) / rate
    phase = (t - 0.4 + 0.4) % 0.8 - 0.4
    beat = np.exp(-((phase / 0.012) ** 2)) - 0.3 * np.exp(-(((phase - 0.03) / 0.012) ** 2))
    gains = np.linspace(0.4, 1.5, len(leads))
    columns = [t * 1000, *(gains[:, None] * (0 if flat else 1) * beat)]
    if nan:
        columns[1] = np.full(len(t), np.nan)
    header = ",".join(["time_ms", *(lead + unit for lead in leads)])
    np.savetxt(
        path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.5f"
    )
    return path


@pytest.fixture
def target_refused(outside, refused):
    def call(recording, *words, extra=()):
        message = refused(["target", recording, *extra, "--out", outside / "t.nc"], *words)
        assert list(outside.iterdir()) == []
        return message

    return call


def test_dicom(outside, run):
    recording = get_testdata_file("waveform_ecg.dcm", download=False)
    ended = run("target", recording, "--out", outside / "mein Ziel ♥.nc")
    assert ended.status == 0
    target = read_target(outside / "mein Ziel ♥.nc")
    assert 60 < target.qrs_duration < 130
    assert f"{len(target.beats)} at" in ended.out
    assert len(list(outside.iterdir())) == 1


def test_csv_and_window_of_ones_own(outside, tmp_path, run):
    recording = table(tmp_path / "rec.csv")
    out = outside / "t.nc"
    assert run("target", recording, "--onset", -40, "--offset", 60, "--out", out).status == 0
    target = read_target(out)
    assert (target.qrs_onset, target.qrs_offset) == (-40, 60)
    assert target.heart_rate == pytest.approx(75, abs=0.5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"leads": LEADS[:9]}, ("V4", "; ")),
        ({"flat": True}, ("flat",)),
        ({"seconds": 1}, ("; ",)),
        ({"unit": " [furlong]"}, ("unknown units", "; ")),
        ({"unit": ""}, ()),
        ({"nan": True}, ("; ",)),
    ],
)
def test_recordings_that_will_not_do(tmp_path, target_refused, run, outside, options, words):
    recording = table(tmp_path / "rec.csv", **options)
    if options == {"unit": ""}:  # our own format, so it will do
        assert run("target", recording, "--out", outside / "t.nc").status == 0
        return
    target_refused(recording, recording, "; ", *words)


def test_files_that_are_no_recordings(tmp_path, target_refused):
    target_refused(tmp_path / "none.csv", "none.csv: no such file; check")
    target_refused(tmp_path, tmp_path, "is a folder; give one recording file")
    for name, words in (
        ("a.txt", "cannot be read; give"),
        ("a.xml", "; convert it"),
        ("a", "; give"),
    ):
        (tmp_path / name).write_text("hello\n")
        target_refused(tmp_path / name, name, words)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps([1]))
    target_refused(tmp_path / "a.pkl", "pickle", "never opened, save the recording as CSV")


@pytest.mark.parametrize("suffix", [".csv", ".hea", ".dcm"])
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 500, bytes(range(256)) * 9, b"hello\n" * 9, pickle.dumps({"a": 1})]
)
def test_rubbish(tmp_path, target_refused, suffix, content):
    path = tmp_path / f"rubbish{suffix}"
    path.write_bytes(content)
    target_refused(path, path, "; ")


@pytest.mark.parametrize("cut", [0.01, 0.3, 0.9, 0.999])
def test_truncated_dicom(tmp_path, target_refused, cut):
    from pathlib import Path

    whole = Path(get_testdata_file("waveform_ecg.dcm", download=False)).read_bytes()
    path = tmp_path / "cut.dcm"
    path.write_bytes(whole[: int(cut * len(whole))])
    target_refused(path, path, "; ")


@pytest.mark.parametrize(
    ("onset", "offset"), [("nan", 50), (-40, "nan"), ("inf", 50), (50, -40), (-1e6, 50), (-40, 1e6)]
)
def test_windows_that_cannot_be(tmp_path, target_refused, onset, offset):
    recording = table(tmp_path / "rec.csv")
    target_refused(recording, "; ", extra=("--onset", onset, "--offset", offset))


def test_out(tmp_path, outside, refused, run):
    recording = table(tmp_path / "rec.csv")
    refused(
        ["target", recording, "--out", outside], outside, "is a folder; give the name of a file"
    )
    (outside / "file").write_text("mine")
    refused(["target", recording, "--out", outside / "file" / "t.nc"], "; choose another place")
    assert [p.name for p in outside.iterdir()] == ["file"]
    good = outside / "t.nc"
    assert run("target", recording, "--out", good).status == 0
    before = good.read_bytes()
    refused(["target", table(tmp_path / "flat.csv", flat=True), "--out", good], "flat")
    assert good.read_bytes() == before
