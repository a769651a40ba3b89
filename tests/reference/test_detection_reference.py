"""Beats against manual and machine marks, and against what synthetic recordings consist of."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic_recordings.rhythms import RHYTHMS, Synthesis, synthetic_recording
from fascicle.core.leads import LEADS
from fascicle.recording.choices import TargetOptions
from fascicle.recording.detection import r_peaks
from fascicle.recording.lead_groups import lead_groups
from fascicle.recording.pipeline import analyse
from fascicle.recording.readers.read import read_recording
from fascicle.recording.spikes import find_spikes, remove_spikes

pytestmark = pytest.mark.slow

SAME_BEAT = 0.2  # s; marks of several leads closer than this belong to one beat
RATES = (35, 60, 90, 130, 180)  # beats per minute


def found_in(path):
    recording = read_recording(path)
    assert len(find_spikes(recording.signal, recording.sampling_rate)) == 0
    return r_peaks(recording.signal, recording.sampling_rate) / recording.sampling_rate


def marked_peaks(stem):
    """R peaks (s) marked in the twelve leads, an array for each beat; first and last mark."""
    import wfdb

    peaks, every = [], []
    for lead in LEADS:
        marks = wfdb.rdann(str(stem), lead.lower())
        times = marks.sample / marks.fs
        every.extend(times)
        peaks.extend(time for time, kind in zip(times, marks.symbol, strict=True) if kind == "N")
    peaks = np.sort(peaks)
    beats = np.split(peaks, np.flatnonzero(np.diff(peaks) > SAME_BEAT) + 1)
    return beats, min(every), max(every)


@pytest.mark.parametrize(("record", "count"), [("24", 7), ("23", 8), ("119", 8)])
def test_every_manual_beat_and_no_other(data_folder, record, count):
    """And in the analysis, within 20 ms of the median over the leads of the annotators' R peaks."""
    folder = data_folder / "ecg" / "ludb"
    beats, first, last = marked_peaks(folder / record)
    assert len(beats) == count
    found = found_in(folder / f"{record}_common.hea")
    inside = found[(found >= first) & (found <= last)]
    assert len(inside) == count
    # The leads' peaks lie up to 0.13 s apart; the one found is that of some lead.
    for peak, beat in zip(inside, beats, strict=True):
        assert np.abs(beat - peak).min() <= 0.02
        assert abs(np.median(beat) - peak) <= 0.03
    analysis = analyse(read_recording(folder / f"{record}_common.hea"))
    analysed = np.array([beat.time for beat in analysis.beats])
    for beat in beats:
        assert np.abs(analysed - np.median(beat)).min() <= 0.0201


def test_every_beat_that_the_machine_marked(data_folder):
    import pydicom

    path = data_folder / "ecg" / "dicom" / "waveform_ecg.dcm"
    fiducial = [
        int(mark.ReferencedSamplePositions) / 1000
        for mark in pydicom.dcmread(path).WaveformAnnotationSequence
        if mark.AnnotationGroupNumber >= 100  # groups below are of the median beat
        and mark.ConceptNameCodeSequence[0].CodeMeaning == "Fiducial Point"
    ]
    assert len(fiducial) == 10
    assert found_in(path) == pytest.approx(fiducial, abs=0.02)


def test_every_beat_that_the_annotated_ecg_lists(data_folder):
    path = data_folder / "ecg" / "aecg" / "Example_aECG.xml"
    found = found_in(path)
    assert len(found) == path.read_text().count('code="MDC_ECG_BEAT"') == 12
    assert np.diff(found).min() > 0.75
    assert np.diff(found).max() < 0.95


def test_long_recording_of_an_infarction_has_no_gap_and_no_double_beat(data_folder):
    found = found_in(data_folder / "ecg" / "ptb-s0010" / "s0010_re.hea")
    assert len(found) == 52
    assert np.diff(found).min() > 0.68
    assert np.diff(found).max() < 0.80


def outcome(found, truth):
    """Beats found, beats missed, and marks that are no beat."""
    free = np.ones(len(found), dtype=bool)
    for onset, offset in zip(truth.onsets, truth.offsets, strict=True):
        here = np.flatnonzero(free & (found >= onset - 0.02) & (found <= offset + 0.02))
        free[here[:1]] = False
    return np.array([(~free).sum(), len(truth.onsets) - (~free).sum(), free.sum()])


def synthetic_outcome(rhythm, noise_db, seeds, **options):
    total = np.zeros(3)
    for seed in seeds:
        for heart_rate in RATES:
            recording, truth = synthetic_recording(
                np.random.default_rng([seed, heart_rate]),
                Synthesis(rhythm=rhythm, heart_rate=heart_rate, noise_db=noise_db, **options),
            )
            signal, rate = recording.signal, recording.sampling_rate
            if rhythm == "paced":
                signal = remove_spikes(signal, find_spikes(signal, rate), rate)
            peaks = r_peaks(signal, rate) / rate
            total += outcome(peaks, truth)
    return total


@pytest.mark.parametrize("noise", [("white",), ("muscle", "mains", "motion", "wander")])
def test_beats_in_noise_of_15_db(noise):
    by_rhythm = {
        rhythm: synthetic_outcome(rhythm, 15.0, range(100, 102), noise=noise) for rhythm in RHYTHMS
    }
    total = sum(by_rhythm.values())
    assert total[:2].sum() > 900
    assert_found(total, 0.99, 0.99)
    for found in by_rhythm.values():
        assert_found(found, 0.97, 0.97)


def assert_found(outcomes, sensitivity, predictive_value):
    found, missed, false = outcomes
    assert found / (found + missed) >= sensitivity
    assert found / (found + false) >= predictive_value


@pytest.mark.parametrize(
    ("noise_db", "predictive_value", "options"),
    [(5.0, 0.96, {}), (15.0, 0.98, {"tall_t": 3.0})],
    ids=["noise", "T waves as tall as the QRS"],
)
def test_beats_that_are_hard_to_see(noise_db, predictive_value, options):
    outcomes = [synthetic_outcome(rhythm, noise_db, range(2), **options) for rhythm in RHYTHMS]
    assert_found(sum(outcomes), 0.98, predictive_value)


def test_beats_among_t_waves_higher_than_the_qrs():
    """At 50 to 110 beats per minute; faster ones run into one another."""
    total = np.zeros(3)
    for rhythm in RHYTHMS:
        for seed in range(100, 112):
            recording, truth = synthetic_recording(
                np.random.default_rng([seed, 11]),
                Synthesis(rhythm=rhythm, tall_t=6.0, noise_db=20.0),
            )
            spikes = find_spikes(recording.signal, recording.sampling_rate)
            clean = replace(
                recording, signal=remove_spikes(recording.signal, spikes, recording.sampling_rate)
            )
            (group,) = lead_groups(clean, spikes, TargetOptions())
            total += outcome(group.times, truth)
    assert total[:2].sum() > 600
    assert_found(total, 0.99, 0.99)
