"""Synthetic recordings are what they say."""

import numpy as np
import pytest
from quality_recordings import synthetic

from benchmarks.synthetic_recordings.rhythms import NOISES, RHYTHMS
from fascicle.core.leads import INDEPENDENT_ROWS


def inside(truth, n, rate):
    t = np.arange(n) / rate
    return ((t >= truth.onsets[:, None]) & (t <= truth.offsets[:, None])).any(axis=0)


@pytest.mark.parametrize("rhythm", RHYTHMS)
@pytest.mark.parametrize("heart_rate", [35, 100, 180])
def test_beats_are_where_and_as_often_as_stated(rhythm, heart_rate):
    recording, truth = synthetic(1, rhythm=rhythm, heart_rate=heart_rate, seconds=20.0)
    assert len(truth.r_times) == len(truth.kinds) > 5
    assert truth.onsets[0] >= 0
    assert truth.offsets[-1] <= recording.duration
    ends = np.stack([truth.onsets, truth.r_times, truth.offsets], axis=1).ravel()
    assert (np.diff(ends) > 0).all()
    if rhythm not in ("pauses", "fibrillation"):
        assert len(truth.r_times) * 3 == pytest.approx(heart_rate, abs=6)


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


def test_einthoven_holds_in_noise_and_the_same_seed_gives_the_same():
    recording, again = (synthetic(8, noise_db=10.0, noise=tuple(NOISES))[0] for _ in range(2))
    assert recording.signal[0] + recording.signal[2] == pytest.approx(recording.signal[1])
    assert np.array_equal(recording.signal, again.signal)


def test_noise_without_a_beat_is_an_error():
    options = {"seconds": 1.6, "heart_rate": 25}
    seed = next(seed for seed in range(50) if not len(synthetic(seed, **options)[1].r_times))
    with pytest.raises(ValueError, match="no beat in"):
        synthetic(seed, noise_db=10.0, **options)
