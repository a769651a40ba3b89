"""How sure the ends of the QRS are."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.core.leads import lead_matrix
from fascicle.recording.window import OFFSET_ERROR, ONSET_ERROR, qrs_window, window_uncertainty

START, END, LENGTH = 200, 300, 700  # ms


def clean_beat():
    t = np.arange(LENGTH)
    phase = np.clip((t - START) / (END - START), 0, 1)
    turns = np.array([1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5])[:, None]
    return lead_matrix() @ (np.sin(np.pi * phase) ** 1.5 * np.sin(np.pi * turns * phase + turns))


def noisy_beats(rng, count, noise):
    return clean_beat() + noise * rng.standard_normal((count, 12, LENGTH))


def test_without_noise_the_error_of_the_method_remains():
    beats = np.repeat(clean_beat()[None], 5, axis=0)
    assert window_uncertainty(beats, 1.0) == pytest.approx((ONSET_ERROR, OFFSET_ERROR))


def test_noisier_beats_are_less_sure_and_more_beats_are_surer():
    rng = np.random.default_rng(1)
    few = window_uncertainty(noisy_beats(rng, 6, 0.3), 1.0)
    quiet = window_uncertainty(noisy_beats(rng, 6, 0.02), 1.0)
    many = window_uncertainty(noisy_beats(rng, 96, 0.3), 1.0)
    assert few[0] > quiet[0] + 0.5
    assert few[1] > quiet[1] + 0.5
    assert few[0] > many[0] + 0.5
    assert few[1] > many[1] + 0.5


def test_same_beats_same_answer():
    beats = noisy_beats(np.random.default_rng(2), 8, 0.1)
    assert window_uncertainty(beats, 1.0) == window_uncertainty(beats.copy(), 1.0)


def test_the_step_scales_it():
    beats = noisy_beats(np.random.default_rng(3), 6, 0.2)
    coarse = window_uncertainty(beats[..., ::2], 2.0)
    fine = window_uncertainty(beats, 1.0)
    assert coarse[0] == pytest.approx(fine[0], rel=0.5)
    assert coarse[1] == pytest.approx(fine[1], rel=0.5)


def test_one_beat_needs_its_noise():
    beat = clean_beat()[None]
    with pytest.raises(ValueError, match="state it"):
        window_uncertainty(beat, 1.0)
    little = window_uncertainty(beat, 1.0, noise=0.005)
    much = window_uncertainty(beat, 1.0, noise=0.15)
    assert little == pytest.approx((ONSET_ERROR, OFFSET_ERROR), abs=0.5)
    assert much[0] > little[0] + 0.5
    assert much[1] > little[1] + 0.5


def test_leads_that_are_not_there_are_ignored():
    beats = noisy_beats(np.random.default_rng(4), 6, 0.05)
    beats[:, [2, 8]] = np.nan
    assert np.isfinite(window_uncertainty(beats, 1.0)).all()


def test_the_end_of_a_spike_bounds_the_onset():
    """A spike whose height varies makes the onset unsure unless it is left out."""
    rng = np.random.default_rng(5)
    beats = noisy_beats(rng, 6, 0.02)
    beats[:, :, 180:183] += rng.choice([0.0, 3.0], (6, 1, 1)) * np.cos(np.arange(12))[:, None]
    after = window_uncertainty(beats, 1.0, not_before=185)
    assert after[0] == pytest.approx(ONSET_ERROR, abs=0.5)


def test_noise_of_the_found_ends_is_foreseen():
    """Over many recordings the ends scatter about as much as is said of each."""
    rng = np.random.default_rng(6)
    found, said = [], []
    for _ in range(12):
        beats = noisy_beats(rng, 6, 0.3)
        found.append(qrs_window(beats.mean(axis=0), 1.0))
        said.append(np.square(window_uncertainty(beats, 1.0)))
    scatter = np.std(found, axis=0)
    foreseen = np.sqrt(np.mean(said, axis=0) - np.square([ONSET_ERROR, OFFSET_ERROR]))
    assert (foreseen > 0.6 * scatter).all()
    assert (foreseen < 2.5 * scatter).all()
