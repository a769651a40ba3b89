"""`fascicle target` from the command line; the recordings themselves: tests/io."""

import json
import pickle
import re

import numpy as np
import pytest
from pydicom.data import get_testdata_file

from benchmarks.synthetic_recordings.rhythms import Synthesis, synthetic_recording
from fascicle.core.leads import LEADS
from fascicle.recording import filter_estimate, window
from fascicle.recording.filters import FilterOrigin
from fascicle.recording.target_files import read_target

pytestmark = pytest.mark.usefixtures("blank_pictures")
RATE, SECONDS = 500, 8


def table(path, leads=LEADS, unit="_mV", rate=RATE, seconds=SECONDS, change=None):
    """Write a synthetic recording: beats each 0.8 s, perhaps with changed leads."""
    recording, _ = synthetic_recording(
        np.random.default_rng(6),
        Synthesis(rate=rate, seconds=seconds, heart_rate=75.0, noise_db=30.0, respiration=0.02),
    )
    signal = recording.signal.copy()
    if change is not None:
        change(signal)
    t = 1000 * np.arange(signal.shape[1]) / rate
    rows = [LEADS.index(lead) for lead in leads]
    header = ",".join(["time_ms", *(lead + unit for lead in leads)])
    np.savetxt(
        path, np.column_stack([t, *signal[rows]]), delimiter=",", header=header, comments="",
        fmt="%.5f",
    )  # fmt: skip
    return path


def flat_v2(signal):
    signal[LEADS.index("V2")] = 0.1


def arms_exchanged(signal):
    i, ii, iii, avr, avl, avf = signal[:6].copy()
    signal[:6] = -i, iii, ii, avl, avr, avf


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return table(tmp_path_factory.mktemp("recording") / "rec.csv")


@pytest.fixture
def target_refused(outside, refused):
    def call(recording, *words, extra=()):
        message = refused(["target", recording, *extra, "--out", outside / "t.nc"], *words)
        assert list(outside.iterdir()) == []
        return message

    return call


def test_dicom(outside, run):
    dicom = get_testdata_file("waveform_ecg.dcm", download=False)
    ended = run("target", dicom, "--out", outside / "mein Ziel ♥.nc")
    assert ended.status == 0
    target = read_target(outside / "mein Ziel ♥.nc")
    assert 60 < target.qrs_duration < 130
    assert f"{len(target.beats)} used at" in ended.out
    (line,) = (line for line in ended.out.splitlines() if line.startswith("QRS"))
    assert line.split()[1] == f"{target.qrs_duration:.0f}"
    assert line.endswith("ms about R")
    assert "none of the conventional criteria of bundle branch or fascicular block" in ended.out
    assert sorted(path.suffix for path in outside.iterdir()) == [".nc", ".png"]
    assert (outside / "mein Ziel ♥.png").read_bytes().startswith(b"\x89PNG")
    assert "Einthoven" in ended.out
    said = json.loads(run("target", dicom, "--out", outside / "t.nc", "--json").out)
    assert said["qrs_duration_ms"] == target.qrs_duration
    criteria = {one["name"]: one["met"] for one in said["conventional_criteria"]}
    assert criteria == {one.name: one.met for one in target.conventional_criteria}
    assert said["qrs_onset_sd_ms"] == target.onset_sd


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"leads": LEADS[:9]}, ("V4", "; ")),
        ({"change": flat_v2}, ("V2", "--leads I,II,III,aVR,aVL,aVF,V1,V3,V4,V5,V6")),
        ({"unit": " [furlong]"}, ("unknown unit", "furlong", "; ")),
    ],
)
def test_recordings_that_will_not_do(tmp_path, target_refused, options, words):
    file = table(tmp_path / "rec.csv", **options)
    target_refused(file, file, "; ", *words)


def test_files_that_are_no_recordings(tmp_path, target_refused):
    target_refused(tmp_path / "none.csv", "none.csv: no such file; give")
    target_refused(tmp_path, tmp_path, "is not an ordinary file; give one recording file")
    for name, words in (("a.txt", "; "), ("a.xml", "; "), ("a", "; give")):
        (tmp_path / name).write_text("hello\n")
        target_refused(tmp_path / name, name, words)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps([1]))
    target_refused(tmp_path / "a.pkl", "'.pkl' recordings cannot be read; give")


@pytest.mark.parametrize("suffix", [".csv", ".hea", ".dcm", ".xml", ".scp", ".h5", ".mat", ""])
def test_rubbish(tmp_path, target_refused, suffix):
    path = tmp_path / f"rubbish{suffix}"
    path.write_bytes(pickle.dumps({"a": 1}))
    target_refused(path, path)


def made(run, outside, recording, *options):
    """Target made with options, and how the command ended."""
    ended = run("target", recording, *options, "--out", outside / "t.nc")
    assert ended.status == 0, ended.err
    return read_target(outside / "t.nc"), ended


@pytest.fixture
def quick(monkeypatch):
    """Look for no filters, and estimate no uncertainty: most of the time of a target."""
    monkeypatch.setattr(filter_estimate, "estimated_lowpass", lambda *_: None)
    monkeypatch.setattr(window, "window_uncertainty", lambda *_: (4.0, 5.0))


def test_beats_class_and_window(quick, recording, run, outside):
    everything, _ = made(run, outside, recording)
    chosen, _ = made(run, outside, recording, "--onset", -40, "--offset", 60)
    assert (chosen.qrs_onset, chosen.qrs_offset) == (-40, 60)
    assert chosen.heart_rate == pytest.approx(75, abs=1)
    some, _ = made(run, outside, recording, "--exclude-beat", "3", "--exclude-beat", "5-6")
    assert len(some.beats) == len(everything.beats) - 3
    assert some.provenance["choice_exclude"] == "3, 5, 6"
    three, ended = made(run, outside, recording, "--beats", "2-4")
    assert len(three.beats) == 3
    assert "not chosen" in ended.out
    assert three.beats == pytest.approx(everything.beats[1:4], abs=0.05)
    one, _ = made(run, outside, recording, "--beats", "2", "--noise", "0.03")
    assert one.noise == 0.03
    same, _ = made(run, outside, recording, "--class", "A")
    assert np.array_equal(same.beats, everything.beats)


def test_pacing_spikes_are_printed(quick, data_folder, run, outside):
    _, ended = made(run, outside, data_folder / "cases" / "two_spikes_8ms.csv")
    assert re.search(r"(?m)^pacing spikes +7, cut out, at 0\.40, 1\.20, .*, … s$", ended.out)


def test_leads_and_polarity(quick, recording, tmp_path, run, outside):
    truth, _ = made(run, outside, recording)
    without, ended = made(run, outside, recording, "--leads", "I,II,V1-V4,V6")
    assert [LEADS[k] for k in np.flatnonzero(~without.used)] == ["V5"]
    assert "III, aVR, aVL, aVF" in ended.out
    flat = table(tmp_path / "flat.csv", change=flat_v2)
    others, _ = made(run, outside, flat, "--leads", "I-aVF,V1,V3-V6")
    assert not others.used[LEADS.index("V2")]
    wrong = table(tmp_path / "wrong.csv", change=lambda s: np.negative(s[6:8], out=s[6:8]))
    mended, _ = made(run, outside, wrong, "--invert", "V1", "--invert", "v2")
    assert mended.beats == pytest.approx(truth.beats, abs=1e-4)
    arms = table(tmp_path / "arms.csv", change=arms_exchanged)
    mended, _ = made(run, outside, arms, "--swap", "RA-LA")
    assert mended.beats == pytest.approx(truth.beats, abs=1e-4)


def test_filters(tmp_path, run, outside):
    noisy = table(tmp_path / "rec.csv", change=lambda s: s.__iadd__(hum(s)))
    humming, ended = made(run, outside, noisy)
    assert "at 50 Hz" in ended.err
    quiet, _ = made(run, outside, noisy, "--notch", "50", "--lowpass", "150")
    # 0.08 mV of hum in V6, whose phase differs from beat to beat
    assert humming.standard_deviation[11].mean() > 0.05
    assert quiet.standard_deviation[11].mean() < 0.5 * humming.standard_deviation[11].mean()
    assert quiet.provenance["choice_notch_hz"] == "50"


def test_filters_are_told(recording, run, outside):
    target, ended = made(run, outside, recording)
    assert target.response is None
    assert re.search(r"^filters +none known$", ended.out, re.MULTILINE)
    target, ended = made(run, outside, recording, "--recorder-lowpass", "100", "--lowpass", "150")
    told = "low-pass 100 Hz (order 2), the recorder's, as the user says"
    own = "low-pass 150 Hz (order 2), applied by this program"
    assert re.search(rf"^filters +{re.escape(f'{told}; {own}')}$", ended.out, re.MULTILINE)
    assert target.provenance["filters"] == f"{told}\n{own}"
    assert target.provenance["choice_recorder_lowpass_hz"] == "100"
    alone = [one.gain(np.array([100.0]))[0] for one in target.filters]
    assert alone[0] == pytest.approx(0.5**0.5)
    assert target.response(np.array([0.1]))[0] == pytest.approx(alone[0] * alone[1])


def test_single_averaged_beat(data_folder, run, outside):
    """One living subject's beat, behind a steep low-pass; the published QRS is 88 ms long."""
    beat = data_folder / "hearts" / "dti004" / "ecg_beat.csv"
    target, ended = made(run, outside, beat, "--unit", "uV", "--noise", "0.03")
    assert target.heart_rate is None
    (lowpass,) = target.filters
    assert lowpass.origin is FilterOrigin.ESTIMATED
    assert lowpass.frequency == pytest.approx(35.0, abs=1.0)
    assert target.qrs_duration == pytest.approx(88.0, abs=11.0)
    assert re.search(r"^beats +1 used$", ended.out, re.MULTILINE)
    assert "noise                  0.03 mV, as stated" in ended.out
    assert [line for line in ended.err.splitlines() if line.startswith("warning")] == [
        "warning: the recorder's low-pass at 35 Hz, estimated from the spectrum, strongly smooths "
        "the QRS (150 Hz are recommended); export the recording unfiltered"
    ]


def hum(signal):
    t = np.arange(signal.shape[1]) / RATE
    return 0.08 * np.sin(2 * np.pi * 50 * t) * np.linspace(0.5, 1, 12)[:, None]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--onset", "nan", "--offset", "50"), "; "),
        (("--onset", "50", "--offset", "-40"), "; "),
        (("--class", "B"), "there is no class B; the beats are of class A"),
        (("--beats", "77"), "there is no beat 77"),
        (("--beats", "4-x"), "give numbers such as 3 or 1-4,7"),
        (("--beats", "3"), "state its noise by --noise"),
        (("--noise", "0.04"), "--noise is for a single beat"),
        (("--leads", "I,II,V9"), "V9"),
        (("--leads", "V6-V1"), "V6-V1"),
        (("--swap", "RA-V1"), "cannot swap RA-V1"),
        (("--shared-gain",), "leave out --shared-gain"),
        (("--notch", "55"), "notch filter at 55 Hz"),
        (("--recorder-lowpass", "5"), "recorder's low-pass is 5 Hz; give 20 to 1000 Hz"),
    ],
)
def test_choices_that_cannot_be(recording, target_refused, options, words):
    target_refused(recording, words, extra=options)


def test_what_was_said_of_the_file_is_said_again(quick, tmp_path, outside, run):
    bare = table(tmp_path / "rec.csv", leads=LEADS[::-1], unit="")
    target, ended = made(run, outside, bare, "--unit", "mV")
    assert target.heart_rate == pytest.approx(75, abs=1)
    assert re.search(r"(?m)^read with +unit mV$", ended.out)
    target, ended = made(run, outside, bare, "--unit", "mV", "--invert", "V2", "--json")
    assert json.loads(ended.out)["read_with"] == ["unit mV", "upside down: V2"]
    assert (target.provenance["choice_unit"], target.provenance["inverted"]) == ("mV", "V2")


def test_gains_per_lead_are_caught_and_repaired(quick, data_folder, outside, run, target_refused):
    folder = data_folder / "ecg" / "ludb"
    target_refused(folder / "24.hea", "24.hea", "gains per lead are wrong", "--shared-gain")
    repaired, _ = made(run, outside, folder / "24.hea", "--shared-gain")
    assert repaired.provenance["shared_gain"] == "1000 per mV"
    right, _ = made(run, outside, folder / "24_common.hea")
    assert repaired.beats == pytest.approx(right.beats, abs=1e-4)
    half, _ = made(run, outside, folder / "24.hea", "--shared-gain", "--digits-per-mv", 2000)
    # 20 uV of half the size end the QRS elsewhere, which moves the isoelectric level
    assert half.beats == pytest.approx(right.beats / 2, abs=3e-3)


def test_out(quick, recording, tmp_path, outside, refused, run):
    refused(["target", recording, "--out", outside / "t.png"], "t.png", "such as target.nc")
    refused(["target", recording, "--out", outside], outside, "such as target.nc")
    (outside / "file").write_text("mine")
    refused(["target", recording, "--out", outside / "file" / "t.nc"], "; choose another place")
    assert [p.name for p in outside.iterdir()] == ["file"]
    good = outside / "t.nc"
    assert run("target", recording, "--out", good).status == 0
    before = good.read_bytes()
    refused(["target", table(tmp_path / "flat.csv", change=flat_v2), "--out", good], "flat")
    assert good.read_bytes() == before
