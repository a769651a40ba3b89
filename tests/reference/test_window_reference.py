"""The QRS window against manual and machine marks, and against the exact ends in synthetic ones."""

from __future__ import annotations

import numpy as np
import pytest

import fascicle
from benchmarks.synthetic_recordings.rhythms import Synthesis, synthetic_recording
from fascicle.core.leads import LEADS
from fascicle.recording.detection import r_peaks
from fascicle.recording.resampling import resample
from fascicle.recording.window import qrs_window, window_uncertainty

pytestmark = pytest.mark.slow

TRIM = 2  # leads left out at each end: one lead marked oddly does not decide
SAME_BEAT = 200  # ms
BEFORE, AFTER = 250, 450  # ms around the R peak


def manual_window(stem):
    """Times (ms) of earliest onsets and latest offsets, trimmed, of beats marked in all leads."""
    import wfdb

    beats = {}
    for lead in LEADS:
        marks = wfdb.rdann(str(stem), lead.lower())
        times = 1000 * marks.sample / marks.fs
        for k, symbols in enumerate(
            zip(marks.symbol, marks.symbol[1:], marks.symbol[2:], strict=False)
        ):
            if symbols == ("(", "N", ")"):
                beat = next((b for b in beats if abs(b - times[k + 1]) < SAME_BEAT), times[k + 1])
                beats.setdefault(beat, []).append((times[k], times[k + 2]))
    whole = [np.sort(ends, axis=0) for ends in beats.values() if len(ends) == len(LEADS)]
    return np.array([ends[TRIM, 0] for ends in whole]), np.array([e[-1 - TRIM, 1] for e in whole])


def r_times(recording, target):
    """Times (ms) at which the R peak of the target's mean QRS lies in the recording."""
    signal = resample(recording.signal, recording.sampling_rate)
    inside = target.qrs_samples
    shape = target.qrs - target.qrs.mean(axis=1, keepdims=True)
    width = inside.stop - inside.start
    begin = int(target.time[inside.start])
    found = []
    for peak in r_peaks(signal, 1000.0):
        starts = range(max(peak + begin - 40, 0), min(peak + begin + 41, signal.shape[1] - width))
        if starts:
            best = max(starts, key=lambda s: float(np.sum(signal[:, s : s + width] * shape)))
            found.append(best - begin)
    return np.array(found)


def relative(times, peaks):
    """Median of times (ms) from the R peak of their beat."""
    nearest = [t - peaks[np.argmin(np.abs(peaks - t))] for t in times]
    near = [d for d in nearest if abs(d) < SAME_BEAT]
    assert len(near) >= 5
    return float(np.median(near))


# Reached: 24 (left bundle branch block) +9, +5 ms; 23 (right) +6, 0 ms; 119 (normal) 0, +2 ms.
@pytest.mark.parametrize("record", ["24", "23", "119"])
def test_manual_marks(data_folder, record):
    folder = data_folder / "ecg" / "ludb"
    recording = fascicle.read_recording(folder / f"{record}_common.hea")
    target = fascicle.make_target(recording)
    onsets, offsets = manual_window(folder / record)
    peaks = r_times(recording, target)
    onset, offset = relative(onsets, peaks), relative(offsets, peaks)
    assert target.qrs_onset == pytest.approx(onset, abs=12)
    assert target.qrs_offset == pytest.approx(offset, abs=12)
    assert target.qrs_duration == pytest.approx(offset - onset, abs=15)


def test_machine_duration():
    """The electrocardiograph that wrote the file measured 75 ms."""
    from pydicom.data import get_testdata_file

    path = get_testdata_file("waveform_ecg.dcm", download=False)
    target = fascicle.make_target(fascicle.read_recording(path))
    assert target.qrs_duration == pytest.approx(75, abs=15)


def synthetic_errors(noise_db, count=24):
    """Found minus true ends (ms) and what was foreseen of them, each (count, 2)."""
    rng = np.random.default_rng(int(noise_db))
    off, foreseen = [], []
    while len(off) < count:
        rhythm = ("sinus", "blocked")[len(off) % 2]
        kind = "blocked" if rhythm == "blocked" else "normal"
        recording, truth = synthetic_recording(
            rng, Synthesis(rhythm=rhythm, noise_db=noise_db, noise=("white", "muscle"))
        )
        signal = resample(recording.signal, recording.sampling_rate)
        peaks = np.round(1000 * truth.r_times).astype(int)
        whole = (peaks >= BEFORE) & (peaks + AFTER < signal.shape[1])
        kept = np.flatnonzero(whole & (np.array(truth.kinds) == kind))
        beats = np.stack([signal[:, p - BEFORE : p + AFTER] for p in peaks[kept]])
        ends = (1000 * np.stack([truth.onsets, truth.offsets]) - peaks + BEFORE)[:, kept]
        off.append(qrs_window(beats.mean(axis=0), 1.0) - ends.mean(axis=1))
        foreseen.append(window_uncertainty(beats, 1.0))
    return np.array(off), np.array(foreseen)


# Smoothing shows a QRS that begins and ends with a kink some ms too wide.
@pytest.mark.parametrize("noise_db", [15, 20, 30])
def test_synthetic_recordings(noise_db):
    off, foreseen = synthetic_errors(noise_db)
    bias, spread = off.mean(axis=0), off.std(axis=0)
    assert (np.abs(bias) < 8).all()
    assert (spread < 6.5).all()
    assert (np.mean(np.abs(off) < 15, axis=0) >= 0.95).all()
    assert (np.mean(np.abs(off) <= 2 * foreseen, axis=0) >= 0.9).all()
