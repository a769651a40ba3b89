"""Pacing spikes: found, taken out, and not seen where there are none."""

import numpy as np
import pytest

from benchmarks.synthetic_recordings.rhythms import RHYTHMS, Synthesis, synthetic_recording
from fascicle.recording.spikes import find_spikes, remove_spikes


def counts(found, times, rate):
    """Spikes found, missed, and marks that are none."""
    free = np.ones(len(found), dtype=bool)
    for time in times:
        begins, ends = found.T / rate
        here = np.flatnonzero(free & (begins <= time + 0.005) & (ends >= time))
        free[here[:1]] = False
    return np.array([(~free).sum(), len(times) - (~free).sum(), free.sum()])


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0, 2000.0])
@pytest.mark.parametrize(
    ("size", "noise_db"), [(1.0, None), (1.0, 25.0), (3.0, 20.0), (40.0, 15.0)]
)
def test_atrial_and_ventricular_spikes_are_found(rate, size, noise_db):
    total, atrial = np.zeros(3), 0
    for seed in range(6):
        recording, truth = synthetic_recording(
            np.random.default_rng(seed),
            Synthesis(rhythm="paced", rate=rate, spike_size=size, noise_db=noise_db),
        )
        total += counts(find_spikes(recording.signal, rate), truth.spikes, rate)
        atrial += len(truth.spikes) - len(truth.r_times)
    assert atrial > 10
    found, missed, false = total
    assert found + missed > 50
    assert missed <= 0.02 * (found + missed)
    assert false <= 0.01 * found


@pytest.mark.parametrize("rhythm", sorted(set(RHYTHMS) - {"paced"}))
def test_beats_and_noise_are_no_spikes(rhythm):
    for seed in range(2):
        for rate in (250.0, 1000.0):
            for options in ({"height": 5.0}, {"noise_db": 10.0, "noise": ("white", "muscle")}):
                recording, truth = synthetic_recording(
                    np.random.default_rng(seed), Synthesis(rhythm=rhythm, rate=rate, **options)
                )
                assert len(truth.r_times) > 2
                assert find_spikes(recording.signal, rate).shape == (0, 2)


def test_artefacts_of_one_electrode_are_no_spikes():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        recording, _ = synthetic_recording(rng, Synthesis(rate=1000.0, noise_db=25.0))
        signal = recording.signal
        for sample in rng.integers(0, 9990, 10):
            signal[rng.integers(6, 12), sample : sample + 2] += rng.uniform(1, 10)
        step = np.zeros(10000)
        step[6000:] = 3.0  # the right arm's electrode jumps
        signal += np.array([-1, -1, 0, 1, -0.5, -0.5, *[-1 / 3] * 6])[:, None] * step
        assert len(find_spikes(signal, 1000.0)) == 0


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
def test_spikes_lie_about_the_pulse_and_what_is_left_is_the_beat(rate):
    options = {"rhythm": "paced", "rate": rate, "respiration": 0.0}
    recording, truth = synthetic_recording(
        np.random.default_rng(3), Synthesis(spike_size=20.0, **options)
    )
    bare, _ = synthetic_recording(np.random.default_rng(3), Synthesis(spike_size=1e-9, **options))
    assert np.abs(recording.signal - bare.signal).max() > 10
    spikes = find_spikes(recording.signal, rate)
    assert np.abs(remove_spikes(recording.signal, spikes) - bare.signal).max() < 0.1
    assert len(spikes) == len(truth.spikes) > 5
    assert (spikes[:, 0] / rate <= truth.spikes + 1 / rate).all()
    assert (spikes[:, 1] / rate >= truth.spikes).all()
    assert (np.diff(spikes, axis=1) <= max(0.008 * rate, 5)).all()


def test_leads_recorded_one_group_after_another():
    recording, truth = synthetic_recording(
        np.random.default_rng(6), Synthesis(rhythm="paced", rate=500.0, spike_size=10.0)
    )
    signal = np.full_like(recording.signal, np.nan)
    for group in range(4):
        rows, samples = slice(3 * group, 3 * group + 3), slice(1250 * group, 1250 * (group + 1))
        signal[rows, samples] = recording.signal[rows, samples]
    spikes = find_spikes(signal, 500.0)
    found, missed, false = counts(spikes, truth.spikes, 500.0)
    assert found > 5
    assert missed <= 0.15 * found
    assert false == 0
    assert np.array_equal(np.isnan(remove_spikes(signal, spikes)), np.isnan(signal))
