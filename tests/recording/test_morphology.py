"""Beats of synthetic rhythms, sorted by shape."""

from dataclasses import replace

import numpy as np
import pytest
from quality_recordings import synthetic

from fascicle.core.leads import independent_rows
from fascicle.recording.choices import TargetOptions
from fascicle.recording.filters import resample
from fascicle.recording.lead_groups import cluster_morphology, lead_groups, noise_energy
from fascicle.recording.spikes import find_spikes, remove_spikes


def independent(recording):
    """Independent leads (k, n), mV, every 1 ms."""
    return resample(recording.signal, 500.0)[independent_rows(recording.recorded)]


def found_beats(recording):
    signal, rate = recording.signal, recording.sampling_rate
    spikes = find_spikes(signal, rate)
    clean = replace(recording, signal=remove_spikes(signal, spikes, rate))
    (found,) = lead_groups(clean, spikes, TargetOptions())
    return found


@pytest.mark.parametrize("rhythm", ["sinus", "fibrillation", "bigeminy", "ectopics", "blocked"])
def test_one_class_for_each_kind_of_beat(rhythm):
    """Given the true R peaks, every class holds one kind, and every kind is one class."""
    for seed, noise_db in enumerate((None, 25.0, 15.0, 8.0, 8.0)):
        recording, truth = synthetic(seed, rhythm=rhythm, noise_db=noise_db)
        signal = independent(recording)
        classes, _ = cluster_morphology(
            signal, np.round(1000 * truth.r_times).astype(np.int64), noise_energy(signal)
        )
        pairs = set(zip(classes.tolist(), truth.kinds, strict=True))
        assert len(pairs) == len(set(classes)) == len(set(truth.kinds))


def test_marks_that_are_off_are_put_right():
    recording, truth = synthetic(5, noise_db=20.0)
    signal = independent(recording)
    peaks = np.round(1000 * truth.r_times).astype(np.int64)
    off = peaks + np.random.default_rng(1).integers(-30, 31, len(peaks))
    _, aligned = cluster_morphology(signal, off, noise_energy(signal))
    difference = aligned - peaks
    assert np.abs(difference - np.median(difference)).max() <= 3


def test_bigeminy_has_two_classes_of_which_the_narrower_comes_first():
    for seed in range(4):
        recording, truth = synthetic(seed, rhythm="bigeminy", noise_db=20.0, heart_rate=70.0)
        found = found_beats(recording)
        kinds = dict(zip(truth.kinds, truth.offsets - truth.onsets, strict=True))
        assert set(found.labels) == {"A", "B"}
        if len(found.of_class("A")) == len(found.of_class("B")):
            first = found.times[found.of_class("A")[0]]
            kind = truth.kinds[np.abs(truth.r_times - first).argmin()]
            assert kind == min(kinds, key=kinds.__getitem__)


def test_ectopic_and_paced_beats_are_described():
    recording, truth = synthetic(2, rhythm="ectopics", noise_db=25.0, seconds=20.0)
    found = found_beats(recording)
    assert found.describe("A") == ""
    assert "early" in found.describe("B")
    assert len(found.of_class("B")) == list(truth.kinds).count("ectopic") > 0
    paced, _ = synthetic(3, rhythm="paced", noise_db=25.0)
    assert found_beats(paced).describe("A").startswith("paced")


@pytest.mark.parametrize("rhythm", ["fibrillation", "pauses"])
def test_no_beat_is_there_twice(rhythm):
    """A high T wave has the R peak of the QRS next to it."""
    for seed in range(6):
        recording, truth = synthetic([seed, 7], rhythm=rhythm, noise_db=20.0, tall_t=8.0)
        found = found_beats(recording)
        assert found.intervals[1:].min() > 120
        assert len(found.labels) == len(found.peaks)
        assert np.abs(truth.r_times[:, None] - found.times).min(axis=1).max() < 0.1


def test_pure_noise_makes_classes_that_end():
    noise = 0.1 * np.random.default_rng(0).normal(size=(8, 5000))
    classes, aligned = cluster_morphology(noise, np.arange(400, 4800, 500), noise_energy(noise))
    assert set(classes) == set(range(classes.max() + 1))
    assert np.abs(aligned - np.arange(400, 4800, 500)).max() <= 60
