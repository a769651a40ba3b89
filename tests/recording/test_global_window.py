"""The global QRS: the outermost leads, of which no single one decides."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.qrs_window import simulated
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.recording.global_window import global_qrs_window
from fascicle.recording.target import Target
from fascicle.recording.window import qrs_window
from tests.recording.test_window_clean import beat, depolarisation

ONSET, OFFSET = 150, 250  # ms, of the usual leads
LIMB = range(6)


def in_leads(leads, start, end, size=0.06):
    """A wave (12, 700), mV, in some leads only."""
    phase = np.clip((np.arange(700) - start) / (end - start), 0, 1)
    wave = np.zeros((12, 700))
    wave[list(leads)] = size * np.sin(np.pi * phase) ** 2
    return wave


PLAIN = global_qrs_window(beat(), 1.0)


def test_ends_of_a_clean_qrs():
    onset, offset = PLAIN
    assert ONSET - 12 <= onset <= ONSET
    assert OFFSET <= offset <= OFFSET + 12


def test_leads_that_begin_earlier_and_end_later_decide():
    """The limb leads move 25 ms before and after the others: all together hardly do."""
    moved = beat() + in_leads(LIMB, 125, 175) + in_leads(LIMB, 225, 275)
    onset, offset = global_qrs_window(moved, 1.0)
    assert 115 <= onset <= 130
    assert 270 <= offset <= 285
    window = qrs_window(moved, 1.0)
    assert onset < window[0] - 3
    assert offset > window[1] + 3


@pytest.mark.parametrize("leads", [[7], [7, 8]])
def test_one_lead_or_two_alone_decide_nothing(leads):
    moved = beat() + in_leads(leads, 110, 175) + in_leads(leads, 225, 300)
    assert global_qrs_window(moved, 1.0) == pytest.approx(PLAIN, abs=8)


@pytest.mark.parametrize("lead", [0, 1, 7, 11])
def test_one_noisy_lead_decides_nothing(lead):
    signal = beat()
    signal[lead] += 0.3 * np.random.default_rng(lead).standard_normal(signal.shape[1])
    assert global_qrs_window(signal, 1.0) == pytest.approx(PLAIN, abs=6)


def test_leads_that_are_not_there_or_do_not_move_have_no_say():
    signal = beat()
    signal[[0, 3, 8, 9]] = np.nan
    assert global_qrs_window(signal, 1.0) == pytest.approx(PLAIN, abs=6)
    signal = beat()
    signal[[8, 9, 10]] = 0.2
    assert global_qrs_window(signal, 1.0) == pytest.approx(PLAIN, abs=6)


def test_it_depends_neither_on_amplitude_nor_on_the_step():
    assert global_qrs_window(1e-6 * beat(), 1.0) == PLAIN
    fine = depolarisation(ONSET, OFFSET, 0.5, 700)
    coarse = depolarisation(ONSET, OFFSET, 1.0, 700)
    assert 0.5 * np.array(global_qrs_window(fine, 0.5)) == pytest.approx(
        global_qrs_window(coarse, 1.0), abs=2
    )


def test_nothing_before_a_spike_is_looked_at():
    assert global_qrs_window(beat(), 1.0, not_before=146)[0] >= 146


def test_no_signal_is_an_error():
    with pytest.raises(ValueError, match="do not move"):
        global_qrs_window(np.zeros((12, 100)), 1.0)


def test_it_is_the_same_with_the_noise_of_recordings_as_without(default_model):
    """A simulated ECG has none: the level must not be that of the noise."""
    simulation = default_model.simulate(EXAMPLE_PARAMETERS)
    clean = simulation.global_qrs_duration
    assert clean == pytest.approx(np.ptp(simulation.activation), abs=12)
    rng = np.random.default_rng(5)
    noisy = []
    for _ in range(8):
        case = simulated(rng, simulation, 30.0, 10)
        onset, offset = global_qrs_window(case.beats.mean(axis=0), 1.0)
        # some are slowed to a wide QRS
        noisy.append(offset - onset - (case.offset - case.onset))
    assert np.median(noisy) == pytest.approx(clean - np.ptp(simulation.activation), abs=6)


def test_of_a_target():
    """Counted from the R peak, whatever the window is, and not before the end of a spike."""
    beats = np.stack([beat(), 1.1 * beat()])
    target = Target(beats, np.arange(700.0) - 200, -30.0, 30.0, 60.0)
    assert target.qrs_duration == 60
    assert target.global_qrs == pytest.approx((PLAIN[0] - 200, PLAIN[1] - 200))
    assert target.global_qrs_duration == PLAIN[1] - PLAIN[0]
    paced = Target(beats, target.time, -30.0, 30.0, 60.0, earliest_onset=-50.0)
    assert paced.global_qrs[0] >= -50
