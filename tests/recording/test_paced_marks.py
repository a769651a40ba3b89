"""Ends of the QRS after pacing spikes: slow first parts, tails, atrial spikes, pseudofusion."""

import numpy as np
import pytest

import fascicle
from benchmarks.synthetic_recordings.rhythms import hump
from fascicle.recording.recording import Recording
from fascicle.recording.spikes import spike_tail

SIZES = np.array([0.3, -1.0, -1.3, 0.35, 0.8, -1.15, -0.9, -1.4, -1.5, -1.2, -0.6, 0.25])[:, None]
SPIKE = np.array([0.5, -0.6, -1.1, 0.05, 0.8, -0.85, 0.4, 0.6, 0.7, 0.7, 0.45, 0.2])[:, None]
CYCLE, FIRST = 950, 600  # ms


def paced(latency, length, rise, share=0.0, decay=10.0, atrial=None):
    """Recording (1000 Hz) and truth: onset and offset of the first QRS (ms).

    `share` of the spike is left when it ends, and decays with `decay` (ms); the atrial spike comes
    `atrial` ms before the ventricular one, or in its place where `latency` is None.
    """
    t, signal = np.arange(7000.0), np.zeros((12, 7000))
    for start in np.arange(FIRST, 6000, CYCLE):
        onset = start + (latency if latency is not None else atrial)
        signal += SIZES * hump(t, onset, onset + length, rise, 2.0)
        signal -= 0.3 * SIZES * hump(t, onset + length, onset + length + 260, 3, 2)
        if latency is not None:
            since = t - start
            signal += 2 * SPIKE * ((since >= 0) & (since < 2))
            tail = np.exp(-np.maximum(since - 2, 0) / decay)
            signal += 2 * share * SPIKE * tail * ((since >= 2) & (since < 200))
        if atrial is not None:
            begin = onset - atrial - (latency or 0)
            signal += 1.5 * SPIKE * ((t >= begin) & (t < begin + 2))
            signal += 0.12 * np.abs(SIZES) * hump(t, begin + 15, begin + 105, 2, 2)
    signal += 0.004 * np.random.default_rng(0).standard_normal(signal.shape)
    signal[2], signal[3] = signal[1] - signal[0], -(signal[0] + signal[1]) / 2
    signal[4], signal[5] = signal[0] - signal[1] / 2, signal[1] - signal[0] / 2
    return Recording(signal, 1000.0, "paced"), (onset, onset + length)


def marked(recording, truth):
    """Found less true ends of the window (ms), the standard deviations stated, and the analysis."""
    analysis = fascicle.analyse(recording)
    r = 1000 * analysis.beats[-1].time
    target = analysis.target
    assert np.abs(r - np.mean(truth)) < 110
    off = np.array([target.qrs_onset, target.qrs_offset]) + r - truth
    return off, np.array([target.onset_sd, target.offset_sd]), analysis


@pytest.fixture(scope="module")
def clean():
    """Differences of the ends where no tail follows the spikes."""
    return marked(*paced(30, 140, 1.2))[0]


@pytest.mark.parametrize(
    ("latency", "length", "rise"), [(6, 130, 2.0), (40, 130, 2.0), (20, 180, 2.5), (6, 270, 2.0)]
)
def test_slow_first_part_after_a_spike(latency, length, rise):
    off, sd, analysis = marked(*paced(latency, length, rise))
    # such a QRS becomes visible, at 0.02 mV, after 5 to 15 ms
    assert (np.abs(off - (8, -8)) <= 2 * sd).all()
    assert analysis.classes[0].description == "paced"


@pytest.mark.parametrize(("share", "decay"), [(0.1, 4.0), (0.03, 10.0), (0.1, 25.0)])
def test_tail_of_a_spike_is_no_qrs(clean, share, decay):
    off, _, analysis = marked(*paced(30, 140, 1.2, share, decay))
    assert off == pytest.approx(clean, abs=4)
    target = analysis.target
    after = (target.time > target.earliest_onset) & (target.time < target.qrs_onset - 8)
    assert np.abs(target.mean[:, after]).max() < 0.03  # mV; up to 0.2 with the tail


def test_a_qrs_is_no_tail():
    t = np.arange(400.0)
    for rise in (1.0, 1.5, 2.5):
        beat = SIZES * hump(t, 100, 260, rise, 2.0)
        assert np.abs(spike_tail(beat, 100)).max() < 0.02


def test_atrial_pacing_and_both_chambers():
    without, _, _ = marked(*paced(20, 120, 1.3))
    for latency in (None, 20):
        off, _, _ = marked(*paced(latency, 120, 1.3, atrial=160))
        assert off == pytest.approx(without, abs=4)


def test_spike_into_a_qrs_that_has_begun():
    """Pseudofusion: the onset lies before the spike, and the beat is not called paced."""
    off, _, analysis = marked(*paced(-40, 100, 1.3))
    assert off == pytest.approx((0, 0), abs=9)
    assert analysis.classes[0].description == ""


# Right values: onset and offset (ms from R) of the file's QRS, and of the class what is said.
@pytest.mark.parametrize(
    ("name", "onset", "offset", "description"),
    [
        ("c08_rv_slow_150.xml", -148, 125, "paced"),
        ("c05_spike_decay.hea", -68, 62, "paced"),
        ("c03_triangle_muse.xml", -72, 72, ""),
    ],
)
def test_cases(data_folder, name, onset, offset, description):
    analysis = fascicle.analyse(fascicle.read_recording(data_folder / "cases" / name))
    target = analysis.target
    assert target.qrs_onset == pytest.approx(onset, abs=7)
    assert abs(target.qrs_offset - offset) <= 2 * target.offset_sd
    assert analysis.classes[0].description == description
