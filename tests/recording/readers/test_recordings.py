"""How the reader of a recording is chosen, and files that are none."""

from __future__ import annotations

import os
import shutil

import h5py
import numpy as np
import pandas as pd
import pytest
from pydicom.data import get_testdata_file
from refusals import refused

from fascicle.core.leads import LEADS
from fascicle.recording.readers.read import read_recording


@pytest.fixture
def dicom():
    return get_testdata_file("waveform_ecg.dcm", download=False)


@pytest.mark.parametrize("name", ["IM000001", "a.DCM", "1.2.840.10008.7", "a.img"])
def test_dicom_by_its_content(tmp_path, dicom, name):
    shutil.copy(dicom, tmp_path / name)
    recording = read_recording(tmp_path / name)
    assert recording.signal.shape == (12, 10000)
    assert recording.provenance["format"] == "DICOM waveform"
    assert len(recording.provenance["source_sha256"]) == 64


@pytest.mark.parametrize("name", ["a.csv", "a.xml", "a.edf", "a.hea", "a.mat"])
def test_dicom_under_another_name(tmp_path, dicom, name):
    shutil.copy(dicom, tmp_path / name)
    refused(tmp_path / name, "content is DICOM", "rename it")


@pytest.mark.parametrize(
    ("name", "start", "kind"),
    [
        ("a.dcm", b"<?xml version='1.0'?><a/>", "XML"),
        ("a.csv", b"\xef\xbb\xbf<AnnotatedECG/>", "XML"),
        ("a.txt", b"0       " + 300 * b" ", "EDF"),
        ("a.dcm", 16 * b"\0" + b"SCPECG" + 40 * b"\0", "SCP-ECG"),
        ("a.csv", b"MATLAB 5.0 MAT-file" + 500 * b" ", "MAT"),
    ],
)
def test_other_content_than_the_name_says(tmp_path, name, start, kind):
    (tmp_path / name).write_bytes(start)
    refused(tmp_path / name, f"content is {kind}", "rename it")


def test_hdf5_under_another_name(tmp_path):
    with h5py.File(tmp_path / "a.edf", "w") as file:
        file["leads"] = np.zeros(3)
    refused(tmp_path / "a.edf", "content is HDF5")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.pkl", ["pickle files can run any code"]),
        ("a.npy", ["without lead names"]),
        ("a.dat", [".hea file beside it"]),
        ("a.pdf", ["digitise the picture"]),
        ("a.zip", ["'.zip' recordings cannot be read", ".csv"]),
        ("a", ["recordings of unknown kind", ".csv"]),
    ],
)
def test_kinds_that_are_not_read(tmp_path, name, words):
    (tmp_path / name).write_bytes(b"\x80\x04N.")
    refused(tmp_path / name, *words)


@pytest.mark.parametrize(
    "suffix", [".hea", ".dcm", ".xml", ".scp", ".edf", ".mat", ".csv", ".tsv", ".txt", ".pkl", ""]
)
def test_empty_files(tmp_path, suffix):
    (tmp_path / f"a{suffix}").write_bytes(b"")
    refused(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("name", ["a.hea", "a.dcm", "a.csv", "a.h5", "a"])
def test_files_too_large_are_not_opened(tmp_path, name):
    (tmp_path / name).touch()
    os.truncate(tmp_path / name, 600 * 2**20)
    refused(tmp_path / name, "600 MB", "at most 512 MB")


def test_paths_that_are_no_files(tmp_path):
    refused(tmp_path, "is a folder")
    (tmp_path / "a.hea").mkdir()
    refused(tmp_path / "a.hea", "is a folder")
    refused(tmp_path / "none.hea", "no such file")
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    refused(tmp_path / "loop.csv", "no such file")
    os.mkfifo(tmp_path / "pipe.csv")
    refused(tmp_path / "pipe.csv", "is not an ordinary file")


def test_same_recording_from_two_formats(data_folder, tmp_path):
    first = read_recording(data_folder / "ecg" / "ludb" / "119_common.hea")
    times = np.arange(first.signal.shape[1]) / first.sampling_rate
    frame = pd.DataFrame(
        {"time_s": times} | {f"{k}_uV": 1e3 * v for k, v in zip(LEADS, first.signal, strict=True)}
    )
    frame.to_csv(tmp_path / "a.csv", index=False)
    second = read_recording(tmp_path / "a.csv")
    assert second.signal == pytest.approx(first.signal, abs=1e-9)
    assert second.sampling_rate == first.sampling_rate
