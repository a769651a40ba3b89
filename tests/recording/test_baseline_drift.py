"""Beats whose baseline drifts are left out, and no others."""

from dataclasses import replace

import numpy as np
import pytest
from quality_recordings import analysed, synthetic

from fascicle.core.leads import LEADS
from fascicle.recording.beats import Unused
from fascicle.recording.choices import TargetOptions
from fascicle.recording.pipeline import analyse
from fascicle.recording.recording import Recording

V6 = LEADS.index("V6")


def sinus(seed=3, noise_db=30.0, **more):
    return synthetic(seed, heart_rate=72.0, noise_db=noise_db, **more)[0]


def settling(recording, size=1.2, time_constant=0.3, start=0.0):
    """An electrode of V6 that settles from a time (s) on."""
    since = np.arange(recording.signal.shape[1]) / recording.sampling_rate - start
    signal = recording.signal.copy()
    signal[V6] += np.where(since >= 0, size * np.exp(-np.maximum(since, 0) / time_constant), 0.0)
    return replace(recording, signal=signal)


def left_out(analysis):
    return [beat.number for beat in analysis.beats if beat.unused is Unused.DRIFTING]


@pytest.fixture(scope="module")
def clean():
    return analyse(sinus())


def test_a_beat_on_a_settling_electrode_is_left_out_with_the_reason(clean):
    def spread(analysis):
        target = analysis.target
        return target.standard_deviation[V6, target.qrs_samples][-1]

    first = next(beat for beat in clean.beats if beat.used)
    disturbed = settling(sinus(), start=first.time - 0.3)
    found = analyse(disturbed)
    (beat,) = (beat for beat in found.beats if beat.unused is Unused.DRIFTING)
    named = tuple(beat.number for beat in clean.beats if beat.used)
    assert beat.number == first.number
    assert beat.drift.lead == "V6"
    assert beat.why_unused == f"baseline drifts by {abs(beat.drift.potential):.2f} mV in V6"
    assert found.target.provenance["beats_used"] == str(len(clean.target.beats) - 1)
    assert spread(found) < 1.2 * spread(clean)
    with_it = analyse(disturbed, TargetOptions(beats=named))
    assert len(with_it.target.beats) == len(clean.target.beats)  # what the user names is used
    assert spread(with_it) > 2 * spread(clean)


def test_a_push_leaves_out_its_beat_and_not_the_neighbours(clean):
    """The level of their neighbour, which their own line runs through, is off, too."""
    beat = clean.beats[5]
    found = analyse(settling(sinus(), size=1.0, time_constant=0.15, start=beat.time - 0.12))
    assert left_out(found) == [beat.number]


@pytest.mark.parametrize("noise", ["white", "muscle", "wander"])
def test_noise_and_breathing_leave_nothing_out(noise):
    for seed in range(2):
        assert left_out(analyse(sinus(seed, noise=(noise,), noise_db=15.0))) == []


def test_of_few_beats_none_is_left_out():
    short = settling(sinus())
    signal = short.signal[:, : round(3.4 * short.sampling_rate)]
    found = analyse(Recording(signal, short.sampling_rate, "short"))
    assert 2 <= len(found.target.beats) <= 4
    assert left_out(found) == []


def test_real_recordings(data_folder):
    """In 119 the electrode of V6 settles; in the DICOM file that of the left leg is pushed."""
    drifting = {"normal": {1: "V6"}, "DICOM": {4: "aVF"}}
    for name, analysis in analysed(data_folder).items():
        found = {beat.number: beat.drift.lead for beat in analysis.beats if beat.drift}
        assert found == drifting.get(name, {}), name
