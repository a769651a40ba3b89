"""How the reader of a recording is chosen, and files that are none."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydicom.data import get_testdata_file
from refusals import read_as, refused

from fascicle.core.leads import LEADS, lead_matrix
from fascicle.recording.readers.formats import READERS, Reader, reader_of, register_reader
from fascicle.recording.readers.read import Channel, RawRecording, read_recording

XML = "HL7 aECG, GE MUSE or CardioSoft, Philips, Mortara or Schiller XML"
DOCS = Path(__file__).resolve().parents[3] / "docs"


@pytest.fixture
def dicom():
    return get_testdata_file("waveform_ecg.dcm", download=False)


@pytest.mark.parametrize("name", ["IM000001", "1.2.840.10008.7", "a.csv", "a.hea"])
def test_content_counts_before_the_name(tmp_path, dicom, name):
    shutil.copy(dicom, tmp_path / name)
    recording = read_recording(tmp_path / name)
    assert recording.signal.shape == (12, 10000)
    assert recording.provenance["format"] == "DICOM waveform"
    assert len(recording.provenance["source_sha256"]) == 64


@pytest.mark.parametrize(
    ("start", "format"),
    [
        (b"<?xml version='1.0'?><a/>", XML), (b"\xef\xbb\xbf<AnnotatedECG/>", XML),
        (b"0       " + 300 * b" ", "EDF"), (16 * b"\0" + b"SCPECG" + 40 * b"\0", "SCP-ECG"),
        (b"MATLAB 5.0 MAT-file" + 500 * b" ", "MATLAB"), (b"\x89HDF\r\n\x1a\n\0", "HDF5"),
        (b"ISHNE1.0\0", "ISHNE"), (b"time_ms,I_mV", "table"),
    ],
)  # fmt: skip
def test_format_of_a_content(tmp_path, start, format):
    (tmp_path / "a.csv").write_bytes(start)
    assert reader_of(tmp_path / "a.csv").format == format


@pytest.mark.parametrize("name", ["a.pkl", "a.dat", "a"])
def test_kinds_that_are_not_read(tmp_path, name):
    (tmp_path / name).write_bytes(b"\x80\x04N.")
    refused(tmp_path / name, "cannot be read", "WFDB (.hea)", "table (.csv, .tsv, .txt)")


@pytest.mark.parametrize("suffix", [".hea", ".dcm", ".xml", ".scp", ".edf", ".mat", ".csv", ""])
def test_files_empty_or_too_large(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(b"")
    refused(tmp_path / f"a{suffix}")
    os.truncate(tmp_path / f"a{suffix}", 600 * 2**20)
    refused(tmp_path / f"a{suffix}", *["600 MB", "at most 512 MB"] * (suffix != ""))


def test_paths_that_are_no_files(tmp_path):
    refused(tmp_path, "is not an ordinary file")
    (tmp_path / "a.hea").mkdir()
    refused(tmp_path / "a.hea", "is not an ordinary file")
    refused(tmp_path / "none.hea", "no such file")
    refused(Path("https://physionet.org/rec.hea"), "no such file")
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    refused(tmp_path / "loop.csv", "no such file")
    os.mkfifo(tmp_path / "pipe.csv")
    refused(tmp_path / "pipe.csv", "is not an ordinary file")


def test_the_documentation_names_every_format():
    text = (DOCS / "recordings.md").read_text(encoding="utf-8")
    for reader in READERS:
        assert f"| {reader.format} | {', '.join(f'`{s}`' for s in reader.suffixes)} |" in text


@pytest.fixture
def readers():
    """Takes back what a test registers."""
    before = list(READERS)
    yield
    READERS[:] = before


def test_the_example_of_the_documentation(readers, monkeypatch, tmp_path, dicom):
    """A format that is registered outside the package is one of those that are read."""
    page = (DOCS / "extending.md").read_text(encoding="utf-8").split("## Reader")[1]
    example = re.search(r"```python\n(.*?)```", page, re.DOTALL)[1]
    assert example.count("\n") < 40
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(example, found)
    expected = read_recording(dicom)
    recording = read_recording("a.lab")
    assert recording.provenance["format"] == "laboratory"
    assert recording.sampling_rate == 1000
    assert np.abs(recording.signal - expected.signal)[6:].max() <= 0.0025 + 1e-12
    assert recording.digits_per_millivolt[6] == 200
    assert len(found["target"].beats) > 5
    Path("a.lab").write_bytes(b"LAB 1000\n123")
    refused(Path("a.lab"), "damaged, truncated or unusual laboratory file")
    Path("a.lab2").write_bytes(b"lab")
    refused(Path("a.lab2"), "laboratory (.lab)")


class TestChecks:
    """What is checked once, whatever the format."""

    @pytest.fixture
    def path(self, readers, tmp_path):
        """A file whose reader finds what `found` says."""
        register_reader(Reader("any", (".any",), lambda path, _: self.raw(**self.found)))
        (tmp_path / "a.any").write_bytes(b"x")
        self.found = {}
        return tmp_path / "a.any"

    def raw(
        self, units=("mV",) * 12, names=LEADS, rate=500.0, lengths=(1000,) * 12, start=0, silent=()
    ):
        signal = lead_matrix() @ np.sin(np.arange(1, 10)[:, None] * np.arange(1000) / 200)
        signal[6, :start] = np.nan
        signal[list(silent)] = 0.0
        channels = [
            Channel(name, row[:length], unit, gain=200)
            for name, row, length, unit in zip(names, signal, lengths, units, strict=True)
        ]
        return RawRecording(channels, rate)

    def test_what_the_user_says(self, path):
        expected = read_recording(path).signal
        assert read_recording(path, unit="MV", sampling_rate=500).sampling_rate == 500
        refused(path, "lead I is in 'mV', unit= says 'uV'", unit="uV")
        refused(path, "is 500 Hz", "says 1000 Hz", sampling_rate=1000)
        self.found = {"units": [None] * 12, "rate": None}
        refused(path, "no sampling rate in the file", "sampling_rate=")
        refused(path, "unknown unit of lead I (the file names none)", sampling_rate=400)
        recording = read_as(path, 1e-3 * expected, unit="uV", sampling_rate=400)
        assert recording.digits_per_millivolt == pytest.approx(np.full(12, 2e5))
        assert recording.provenance["choice_unit"] == "uV"

    @pytest.mark.parametrize(
        ("found", "words"),
        [
            ({"units": ["adc"] * 12}, ["unknown unit of lead I ('adc')"]),
            ({"names": [*LEADS[:11], "V5"]}, ["lead V5 is there twice ('V5' and 'V5')"]),
            ({"names": ["I", *"xyzuv", *LEADS[6:]]}, ["lead II missing (found: I, V1"]),
            ({"names": [*LEADS[:6], "-V1", *LEADS[7:]]}, ["V1 missing", "leads=['I', 'II', 'III'"]),
            ({"lengths": [*[1000] * 11, 990]}, ["lead V6 has 990 samples, lead I 1000"]),
            ({"lengths": [100] * 12}, ["0.20 s long"]),
            ({"rate": 0.5}, ["0.5 Hz"]),
            ({"start": 300}, ["lead V1 lacks 300 samples (first: sample 0"]),
        ],
    )
    def test_refusals(self, path, found, words):
        self.found = found
        refused(path, *words)

    def test_limb_leads_follow_from_two(self, path):
        expected = read_recording(path).signal
        self.found = {"names": ["I", "II", *"xyzu", *LEADS[6:]]}
        recording = read_as(path, expected)
        assert recording.derived == ("III", "aVR", "aVL", "aVF")
        assert recording.ignored == ("u",)
        assert [*recording.additional] == ["X", "Y", "Z"]

    def test_leads_without_signal_were_not_recorded(self, path):
        expected = read_recording(path).signal
        self.found = {"silent": [2, 3]}
        recording = read_as(path, expected)
        assert recording.derived == ("III", "aVR")
        assert "\n".join(recording.remarks).endswith("empty from start to end: III, aVR")
        self.found = {"silent": [8]}
        refused(path, "lead V3 missing", "constant or empty: V3", "leads=['I', 'II', 'III', 'aVR'")
        recording = read_recording(path, leads=[lead for lead in LEADS if lead != "V3"])
        assert np.flatnonzero(~recording.recorded).tolist() == [8]


def test_a_reader_of_the_same_name_takes_the_place(readers, tmp_path):
    register_reader(Reader("table", (".csv",), lambda path, sampling_rate: None, largest=10))
    (tmp_path / "a.csv").write_bytes(b"x" * 100)
    refused(tmp_path / "a.csv", "at most 0 MB")
