"""Recordings from WFDB, DICOM and CSV files, good and bad."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pydicom
import pytest
import wfdb
from pydicom.data import get_testdata_file

from fascicle.errors import InputError
from fascicle.io.recordings import read_recording
from fascicle.leads import LEADS, lead_matrix

RATE, N = 500, 2000


@pytest.fixture
def signal():
    """(12, n) mV, every lead different, limb leads consistent."""
    t = np.arange(N) / RATE
    waves = np.array([np.sin(2 * np.pi * (1 + k) * t + k) for k in range(9)])
    return lead_matrix() @ waves


def table(signal, names=None, time="time_ms"):
    step = 1000 / RATE if time == "time_ms" else 1 / RATE
    columns = {time: step * np.arange(signal.shape[1])}
    return pd.DataFrame(columns | dict(zip(names or LEADS, signal, strict=True)))


def save(frame, path, **options):
    frame.to_csv(path, index=False, **options)
    return path


def write_wfdb(folder, signal, units="mV", names=LEADS, rate=RATE):
    wfdb.wrsamp(
        "rec", fs=rate, units=[units] * len(signal), sig_name=list(names), p_signal=signal.T,
        fmt=["16"] * len(signal), write_dir=str(folder),
    )  # fmt: skip
    return folder / "rec.hea"


def refused(path, *words):
    with pytest.raises(InputError) as info:
        read_recording(path)
    message = str(info.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for word in words:
        assert word in message, message


class TestWfdb:
    @pytest.mark.parametrize(("units", "factor"), [("mV", 1), ("uV", 1e3), ("V", 1e-3)])
    def test_units(self, tmp_path, signal, units, factor):
        path = write_wfdb(tmp_path, factor * signal, units, [lead.lower() for lead in LEADS])
        for name in (path, path.with_suffix("")):
            recording = read_recording(name)
            assert recording.signal == pytest.approx(signal, abs=1e-3)
            assert recording.sampling_rate == 500

    def test_unknown_units(self, tmp_path, signal):
        refused(write_wfdb(tmp_path, signal, "mmHg"), "unknown units 'mmHg'", "lead I")

    def test_uncalibrated(self, tmp_path, signal):
        path = write_wfdb(tmp_path, signal)
        lines = path.read_text().splitlines()
        lines[3] = "rec.dat 16 0 16 0 0 0 0 III"
        path.write_text("\n".join(lines) + "\n")
        refused(path, "unknown units", "signal 3")

    def test_truncated_signal(self, tmp_path, signal):
        path = write_wfdb(tmp_path, signal)
        data = path.with_suffix(".dat").read_bytes()
        path.with_suffix(".dat").write_bytes(data[: len(data) // 2 + 1])
        refused(path, "truncated or damaged")

    def test_missing_signal_file(self, tmp_path, signal):
        path = write_wfdb(tmp_path, signal)
        path.with_suffix(".dat").unlink()
        refused(path, "rec.dat is missing")
        path.with_suffix(".dat").touch()
        refused(path)

    @pytest.mark.parametrize(
        "content", ["", "rec 0 500 0\n", "rubbish\n\n", "rec 12 0 2000\n", "\0\1"]
    )
    def test_bad_headers(self, tmp_path, content):
        path = tmp_path / "rec.hea"
        path.write_text(content)
        refused(path)

    def test_signal_file_instead_of_header(self, tmp_path, signal):
        path = write_wfdb(tmp_path, signal)
        refused(path.with_suffix(".dat"), ".hea")

    def test_low_rate(self, tmp_path, signal):
        refused(write_wfdb(tmp_path, signal, rate=100), "100 Hz", "250 Hz")

    def test_ptb(self, data_folder):
        recording = read_recording(data_folder / "ecg" / "ptb-s0010" / "s0010_re")
        assert recording.signal.shape == (12, 38400)
        # First samples of the header over its gain
        assert recording.signal[:, 0] == pytest.approx(
            np.array([-489, -458, 31, 474, -260, -214, -88, -241, -112, 212, 393, 390]) / 2000
        )
        assert recording.signal[0] + recording.signal[2] == pytest.approx(
            recording.signal[1], abs=0.0011
        )


class TestDicom:
    @pytest.fixture
    def path(self):
        return get_testdata_file("waveform_ecg.dcm", download=False)

    def test_rhythm_in_mv(self, path):
        recording = read_recording(path)
        assert recording.signal.shape == (12, 10000)
        assert recording.sampling_rate == 1000
        raw = pydicom.dcmread(path).waveform_array(0)[:, 7]
        assert recording.signal[7] == pytest.approx(raw / 1000)
        assert 0.5 < np.ptp(recording.signal, axis=1).max() < 5

    def changed(self, path, tmp_path, change):
        dataset = pydicom.dcmread(path)
        change(dataset)
        dataset.save_as(tmp_path / "a.dcm")
        return tmp_path / "a.dcm"

    def test_millivolt_and_unknown_units(self, path, tmp_path):
        def to(unit):
            def change(dataset):
                for channel in dataset.WaveformSequence[0].ChannelDefinitionSequence:
                    channel.ChannelSensitivityUnitsSequence[0].CodeValue = unit

            return change

        original = read_recording(path).signal
        thousandfold = read_recording(self.changed(path, tmp_path, to("mV"))).signal
        assert thousandfold == pytest.approx(1000 * original)
        refused(self.changed(path, tmp_path, to("1")), "unknown units", "lead I")

    def test_no_sensitivity(self, path, tmp_path):
        def change(dataset):
            del dataset.WaveformSequence[0].ChannelDefinitionSequence[4].ChannelSensitivity

        refused(self.changed(path, tmp_path, change), "unknown units of lead aVL")

    def test_missing_lead(self, path, tmp_path):
        def change(dataset):
            for group in dataset.WaveformSequence:
                source = group.ChannelDefinitionSequence[8].ChannelSourceSequence[0]
                source.CodeValue, source.CodeMeaning = "X", "other"

        refused(self.changed(path, tmp_path, change), "lead V3 missing")

    def test_no_waveform(self, path, tmp_path):
        def change(dataset):
            del dataset.WaveformSequence

        refused(self.changed(path, tmp_path, change), "without a waveform")

    @pytest.mark.parametrize("size", [0, 100, 400, 2000, 100_000, 240_000])
    def test_truncated(self, path, tmp_path, size):
        with open(path, "rb") as file:
            content = file.read(size)
        (tmp_path / "a.dcm").write_bytes(content)
        refused(tmp_path / "a.dcm")


def test_paths_that_are_not_recordings(tmp_path):
    refused(tmp_path, "is a folder")
    refused(tmp_path / "none.hea", "no such file")
    for name, word in [("a.pkl", "pickle"), ("a.mat", ".csv"), ("a.xml", "convert"), ("a", ".csv")]:
        (tmp_path / name).write_bytes(b"\x80\x04N.")
        refused(tmp_path / name, word)


def test_same_recording_from_two_formats(data_folder, tmp_path):
    path = data_folder / "ecg" / "ludb" / "119_common.hea"
    shutil.copy(path, tmp_path / "119_common.hea")
    shutil.copy(path.with_name("119.dat"), tmp_path / "119.dat")
    first = read_recording(tmp_path / "119_common.hea")
    times = np.arange(first.signal.shape[1]) / first.sampling_rate
    frame = pd.DataFrame(
        {"time_s": times} | {f"{k}_uV": 1e3 * v for k, v in zip(LEADS, first.signal, strict=True)}
    )
    second = read_recording(save(frame, tmp_path / "a.csv"))
    assert second.signal == pytest.approx(first.signal, abs=1e-9)
