"""Recordings from tables, good and bad."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import wfdb

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


class TestCsv:
    def test_our_own_format_is_in_mv(self, tmp_path, signal):
        recording = read_recording(save(table(signal), tmp_path / "ecg.csv"))
        assert recording.signal == pytest.approx(signal, abs=1e-12)
        assert recording.sampling_rate == pytest.approx(500)
        assert len(recording.provenance["source_sha256"]) == 64

    @pytest.mark.parametrize(
        ("pattern", "factor"),
        [("{}_uV", 1e3), ("{} [mV]", 1), ("{} (uV)", 1e3), ("lead {} (µV)", 1e3), ("{}_V", 1e-3)],
    )
    def test_units_in_the_header(self, tmp_path, signal, pattern, factor):
        names = [pattern.format(lead.upper()) for lead in LEADS]
        path = save(table(factor * signal, names, "time_s"), tmp_path / "a.csv")
        recording = read_recording(path)
        assert recording.signal == pytest.approx(signal, abs=1e-9)
        assert recording.sampling_rate == pytest.approx(500)

    def test_order_spelling_separator_and_extra_columns(self, tmp_path, signal):
        spelt = [
            "di",
            "DII",
            "d3",
            "AVR",
            "avl",
            "Lead aVF",
            "c1",
            "v2",
            "V3",
            "v4",
            "MDC_ECG_LEAD_V5",
            "V6",
        ]
        frame = table(signal, [f"{name}_mV" for name in spelt])
        frame = frame[[frame.columns[0], *frame.columns[:0:-1]]].assign(note_mV=1.0)
        recording = read_recording(save(frame, tmp_path / "a.csv", sep=";"))
        assert recording.signal == pytest.approx(signal, abs=1e-12)

    def test_limb_leads_follow_from_two(self, tmp_path, signal):
        frame = table(signal, [f"{lead}_mV" for lead in LEADS])
        frame = frame.drop(columns=["III_mV", "aVR_mV", "aVL_mV", "aVF_mV"])
        recording = read_recording(save(frame, tmp_path / "a.csv"))
        assert recording.signal == pytest.approx(signal, abs=1e-12)
        assert recording.provenance["derived_leads"] == "III, aVR, aVL, aVF"

    def test_plain_names_elsewhere_have_unknown_units(self, tmp_path, signal):
        path = save(table(signal, time="time_s"), tmp_path / "a.csv")
        refused(path, "unknown units", "I_mV", "I_uV")
        path = save(table(signal, [lead.lower() for lead in LEADS]), tmp_path / "b.csv")
        refused(path, "unknown units", "'i'")

    def test_unknown_unit(self, tmp_path, signal):
        path = save(table(signal, [f"{lead} [adc]" for lead in LEADS]), tmp_path / "a.csv")
        refused(path, "unknown units", "'adc'")

    def test_missing_leads_are_named(self, tmp_path, signal):
        frame = table(signal, [f"{lead}_mV" for lead in LEADS]).drop(columns=["V2_mV", "II_mV"])
        refused(save(frame, tmp_path / "a.csv"), "leads II, V2 missing", "found: I, III")

    def test_inverted_lead_is_not_the_lead(self, tmp_path, signal):
        names = [f"{lead}_mV".replace("V1", "-V1") for lead in LEADS]
        refused(save(table(signal, names), tmp_path / "a.csv"), "lead V1 missing")

    def test_time_column(self, tmp_path, signal):
        frame = table(signal)
        refused(
            save(frame.drop(columns="time_ms"), tmp_path / "a.csv"), "no time column", "time_ms"
        )
        refused(save(frame.rename(columns={"time_ms": "time"}), tmp_path / "b.csv"), "time_s")

    def test_uneven_times(self, tmp_path, signal):
        refused(save(table(signal).drop(index=range(90, 95)), tmp_path / "a.csv"), "not evenly")
        refused(save(table(signal)[::-1], tmp_path / "b.csv"), "times do not increase")

    def test_rounded_times_are_even_enough(self, tmp_path, signal):
        frame = table(signal)
        frame["time_ms"] = (np.arange(N) * 1000 / 256).round()
        recording = read_recording(save(frame, tmp_path / "a.csv"))
        assert recording.sampling_rate == pytest.approx(256, rel=1e-3)

    def test_text_and_holes(self, tmp_path, signal):
        frame = table(signal).astype(object)
        frame.loc[5, "V3"] = "0,25x"
        refused(save(frame, tmp_path / "a.csv"), "column 'V3'", "row 7", "0,25x")
        frame = table(signal)
        frame.loc[5, "V3"] = np.nan
        refused(save(frame, tmp_path / "b.csv"), "lead V3, sample 5", "not finite")

    def test_twice_the_same_lead(self, tmp_path, signal):
        frame = table(signal, [f"{lead}_mV" for lead in LEADS]).assign(v1_uV=1.0)
        refused(save(frame, tmp_path / "a.csv"), "lead V1 is there twice")

    @pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00\x01" * 30, b"time_ms,I\n", b'"a,b\n1'])
    def test_not_a_table(self, tmp_path, content):
        path = tmp_path / "a.csv"
        path.write_bytes(content)
        refused(path)
