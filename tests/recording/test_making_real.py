"""Targets of real recordings against manual and machine annotations."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.errors import InputError
from fascicle.io.recordings import read_recording
from fascicle.leads import LEADS
from fascicle.recording.detection import r_peaks
from fascicle.recording.making import make_target
from fascicle.recording.resampling import resample

TRIM = 2  # leads left out at each end: one lead marked oddly does not decide


def annotated_windows(stem):
    """QRS of every beat marked in all leads: earliest onset and latest offset, trimmed (ms)."""
    import wfdb

    marks = {}
    for lead in LEADS:
        annotation = wfdb.rdann(str(stem), lead.lower())
        times = 1000 * annotation.sample / annotation.fs
        symbols = annotation.symbol
        for k in range(1, len(symbols) - 1):
            if symbols[k - 1 : k + 2] == ["(", "N", ")"]:
                beat = next((b for b in marks if abs(b - times[k]) < 200), times[k])
                marks.setdefault(beat, []).append((times[k - 1], times[k + 1]))
    onsets, offsets = [], []
    for beat in sorted(marks):
        if len(marks[beat]) == len(LEADS):
            first, last = np.sort(np.array(marks[beat]), axis=0).T
            onsets.append(first[TRIM])
            offsets.append(last[-1 - TRIM])
    return np.array(onsets), np.array(offsets)


def placed_in_beats(times, target, recording):
    """Median of absolute times (ms) relative to the target's R, found by correlation."""
    signal = resample(recording.signal, recording.sampling_rate)
    inside = target.qrs_samples
    template = target.qrs - target.qrs.mean(axis=1, keepdims=True)
    width = inside.stop - inside.start
    relative = []
    for peak in r_peaks(signal, 1000.0):
        begin = peak + int(target.time[inside.start])
        starts = [s for s in range(begin - 40, begin + 41) if 0 <= s <= signal.shape[1] - width]
        if not starts:
            continue
        best = max(starts, key=lambda s: float(np.sum(signal[:, s : s + width] * template)))
        r_time = best - target.time[inside.start]
        near = times[np.abs(times - r_time) < 200]
        relative.extend(near[:1] - r_time)
    assert len(relative) >= 5
    return float(np.median(relative))


# Reached: 24 onset +9, offset +1 ms; 23 +9, -3 ms; 119 0, 0 ms. The annotators put the onset where
# the PR segment stops being still, some ms before any lead has left the isoelectric line by 20 uV.
@pytest.mark.parametrize(
    ("record", "onset_tolerance", "offset_tolerance", "rate"),
    [("24", 12, 6, 50.6), ("23", 12, 6, 59.3), ("119", 6, 6, 60.4)],
)
def test_window_against_manual_marks(data_folder, record, onset_tolerance, offset_tolerance, rate):
    folder = data_folder / "ecg" / "ludb"
    recording = read_recording(folder / f"{record}_common.hea")
    target = make_target(recording)
    onsets, offsets = annotated_windows(folder / record)
    onset = placed_in_beats(onsets, target, recording)
    offset = placed_in_beats(offsets, target, recording)
    assert target.qrs_onset == pytest.approx(onset, abs=onset_tolerance)
    assert target.qrs_offset == pytest.approx(offset, abs=offset_tolerance)
    assert target.heart_rate == pytest.approx(rate, abs=1.0)
    assert "warnings" not in target.provenance


def test_bundle_branch_blocks_are_wide_and_the_normal_is_not(data_folder):
    folder = data_folder / "ecg" / "ludb"
    width = {
        record: make_target(read_recording(folder / f"{record}_common")).qrs_duration
        for record in ("24", "23", "119")
    }
    assert width["24"] == pytest.approx(173, abs=8)
    assert width["23"] == pytest.approx(147, abs=8)
    assert width["119"] == pytest.approx(97, abs=8)


def test_detrended_beats_start_from_zero(data_folder):
    target = make_target(read_recording(data_folder / "ecg" / "ludb" / "24_common.hea"))
    before = (target.time >= target.qrs_onset - 15) & (target.time < target.qrs_onset)
    assert np.abs(target.mean[:, before]).max() < 0.02
    assert target.beats.shape == (7, 12, len(target.time))


def test_gain_per_lead_is_refused(data_folder):
    with pytest.raises(InputError, match=r"I \+ III - II is off by 0.19 mV.*--shared-gain"):
        make_target(read_recording(data_folder / "ecg" / "ludb" / "24.hea"))


def test_long_recording_keeps_its_beats(data_folder):
    target = make_target(read_recording(data_folder / "ecg" / "ptb-s0010" / "s0010_re.hea"))
    assert len(target.beats) >= 48
    assert target.heart_rate == pytest.approx(81.9, abs=0.5)
    assert target.qrs_onset == pytest.approx(-42, abs=6)
    assert target.qrs_offset == pytest.approx(95, abs=8)


def test_machine_measurements_in_the_dicom_file():
    import pydicom
    from pydicom.data import get_testdata_file

    path = get_testdata_file("waveform_ecg.dcm", download=False)
    notes = pydicom.dcmread(path).WaveformAnnotationSequence
    marks = {"QRS Onset": [], "QRS Offset": []}
    for note in notes:
        name = (
            note.ConceptNameCodeSequence[0].CodeMeaning if "ConceptNameCodeSequence" in note else ""
        )
        if name in marks and note.ReferencedWaveformChannels[0] == 1:
            marks[name].append(float(note.ReferencedSamplePositions))
    recording = read_recording(path)
    target = make_target(recording)
    onset = placed_in_beats(np.array(marks["QRS Onset"]), target, recording)
    offset = placed_in_beats(np.array(marks["QRS Offset"]), target, recording)
    # Reached: onset -2.5, offset -0.5 ms
    assert target.qrs_onset == pytest.approx(onset, abs=6)
    assert target.qrs_offset == pytest.approx(offset, abs=6)
    assert target.qrs_duration == pytest.approx(75, abs=6)
    assert target.heart_rate == pytest.approx(60000 / 982, abs=1)
