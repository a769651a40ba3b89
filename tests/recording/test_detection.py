"""R peaks where leads are bad or absent, at the ends, and in short pieces; synthetic truths."""

import numpy as np
import pytest
from quality_recordings import synthetic

from benchmarks.synthetic_recordings.rhythms import NOISES
from fascicle.core.leads import INDEPENDENT_ROWS, LEADS
from fascicle.recording.detection import complete_leads, magnitude, r_peaks

RATE = 500.0


def sinus(seed=0, **options):
    recording, truth = synthetic(seed, noise_db=20.0, **options)
    return recording.signal, truth


def assert_all_found(signal, truth, rate=RATE, tolerance=0.02):
    peaks = r_peaks(signal, rate) / rate
    assert peaks == pytest.approx(truth.r_times, abs=tolerance)


@pytest.mark.parametrize("rate", [250.0, 977.0, 2000.0])
def test_at_every_sampling_rate(rate):
    signal, truth = sinus(rate=rate)
    assert_all_found(signal, truth, rate)


FAULTS = {
    "noise": lambda n, rng: 5 * rng.standard_normal(n),
    "steps": lambda n, rng: np.cumsum(np.where(rng.random(n) < 12 / n, rng.choice([-5, 5], n), 0)),
    "clipping": lambda n, rng: np.where(np.sin(rng.uniform(0.006, 0.04) * np.arange(n)) > 0, 5, -5),
    "spikes": lambda n, rng: np.where(rng.random(n) < 15 / n, 8.0, 0.0),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_one_bad_lead_neither_makes_nor_hides_beats(fault):
    for row in (1, 8):
        signal, truth = sinus(seed=3)
        signal[row] += FAULTS[fault](signal.shape[1], np.random.default_rng(5))
        assert_all_found(signal, truth)


@pytest.mark.parametrize(
    "absent",
    [[], ["I", "II"], ["V1", "V2", "V3", "V4", "V5", "V6"], list(LEADS[:6]), list(LEADS[1:])],
)
def test_absent_and_flat_leads(absent):
    signal, truth = sinus(seed=4)
    signal[7] = 0.3
    signal[[LEADS.index(lead) for lead in absent]] = np.nan
    assert_all_found(signal, truth, tolerance=0.05 if absent else 0.02)


@pytest.mark.parametrize("gap", [0.0, 0.15])
def test_beats_next_to_the_ends(gap):
    for seed in range(4):
        signal, truth = sinus(seed=seed)
        first = int(max(truth.onsets[0] - gap, 0) * RATE)
        stop = int((truth.offsets[-1] + gap) * RATE) + 1
        peaks = (first + r_peaks(signal[:, first:stop], RATE)) / RATE
        assert peaks == pytest.approx(truth.r_times, abs=0.02)


@pytest.mark.parametrize("heart_rate", [50, 150])
def test_pieces_of_paper_recordings(heart_rate):
    signal, truth = sinus(seed=heart_rate, seconds=2.5, heart_rate=heart_rate, respiration=0.05)
    assert len(truth.r_times) >= 1
    for first in (0, 3, 6, 9):
        piece = np.full_like(signal, np.nan)
        piece[first : first + 3] = signal[first : first + 3]
        assert_all_found(piece, truth, tolerance=0.06)


def test_neither_voltage_nor_unit_matter():
    signal, truth = sinus(seed=1, height=0.3, respiration=0.05)
    assert_all_found(signal, truth)
    assert np.array_equal(r_peaks(signal, RATE), r_peaks(1e-3 * signal, RATE))
    assert len(r_peaks(np.zeros((12, 1000)), RATE)) == 0


def test_magnitude_uses_the_leads_that_are_there():
    signal = np.full((12, 3), np.nan)
    signal[[0, 1, 2, 6]] = [[3.0] * 3, [4.0] * 3, [100.0] * 3, [5.0] * 3]
    assert magnitude(signal) == pytest.approx(np.sqrt(50 / 3))
    signal[0, 1] = np.nan
    assert complete_leads(signal) == [1, 2, 6]
    with pytest.raises(ValueError, match="no lead is complete"):
        complete_leads(np.full((12, 3), np.nan))


@pytest.mark.parametrize(
    ("rhythm", "seed"), [("sinus", 6), ("sinus", 8), ("pauses", 0), ("pauses", 2), ("pauses", 8)]
)
def test_t_waves_as_high_as_the_qrs_are_no_beats(rhythm, seed):
    """They pass the threshold: without a look at their shape, nearly each would be a beat."""
    signal, truth = sinus(seed=[seed, 7], rhythm=rhythm, tall_t=8.0)
    assert_all_found(signal, truth, tolerance=0.06)


@pytest.mark.parametrize("heart_rate", [50, 100])
@pytest.mark.parametrize("tall_t", [0.0, 2.0])
def test_early_slow_ectopic_beats_stay(heart_rate, tall_t):
    """In bigeminy they alternate with the others as T waves would."""
    for seed in range(2):
        signal, truth = sinus(seed=seed, rhythm="bigeminy", heart_rate=heart_rate, tall_t=tall_t)
        assert {"normal", "ectopic"} == set(truth.kinds)
        assert_all_found(signal, truth, tolerance=0.06)


def inside(truth, n, rate):
    t = np.arange(n) / rate
    return ((t >= truth.onsets[:, None]) & (t <= truth.offsets[:, None])).any(axis=0)


@pytest.mark.parametrize("rhythm", ["bigeminy", "blocked"])
def test_the_qrs_is_zero_outside_its_ends_and_not_inside(rhythm):
    recording, truth = synthetic(2, rhythm=rhythm, rate=2000.0, tall_t=0.0, respiration=0.0)
    size = np.abs(recording.signal).max(axis=0)
    t = np.arange(len(size)) / 2000

    def largest(first, last):
        return max(size[(t > a) & (t < b)].max(initial=0) for a, b in zip(first, last, strict=True))

    before, after = truth.onsets, truth.offsets
    assert largest(before - 0.029, before) == 0  # further back is the P wave
    assert largest(after, after + 0.05) == 0
    assert 1e-4 < largest(before, before + 0.004) < 0.2
    assert 1e-4 < largest(after - 0.004, after) < 0.2
    assert largest(before, after) == pytest.approx(size.max())


@pytest.mark.parametrize("noise", NOISES)
def test_height_and_signal_to_noise_ratio(noise):
    recording, truth = synthetic(
        3, noise_db=12.0, noise=(noise,), height=1.4, respiration=0.0, beat_spread=0.0
    )
    assert np.abs(truth.clean).max() == pytest.approx(1.4, rel=0.02)
    qrs = inside(truth, truth.clean.shape[1], 500.0)
    signal = np.mean(truth.clean[INDEPENDENT_ROWS][:, qrs] ** 2)
    added = np.mean((recording.signal - truth.clean)[INDEPENDENT_ROWS] ** 2)
    assert 10 * np.log10(signal / added) == pytest.approx(12.0, abs=0.1)
