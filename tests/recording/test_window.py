"""The QRS of signals whose ends are known, and how sure their ends are."""

import numpy as np
import pytest
from clinical import SHORT_BUNDLES

from benchmarks.qrs_window import simulated
from benchmarks.synthetic_recordings.rhythms import hump
from fascicle.core.leads import lead_matrix
from fascicle.forward.simulation_files import example_parameters
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.window import (
    OFFSET_ERROR,
    ONSET_ERROR,
    SMOOTHING,
    qrs_window,
    smoothing_against_ringing,
    window_uncertainty,
)


def depolarisation(start, end, length, power=1.0):
    """(12, n) mV, every ms, smooth, nonzero from start to end (ms) only."""
    t = np.arange(length)
    phase = np.clip((t - start) / (end - start), 0, 1)
    turns = np.array([1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5])[:, None]
    return lead_matrix() @ (np.sin(np.pi * phase) ** power * np.sin(np.pi * turns * phase + turns))


def beat(start=150, end=250, length=700):
    """QRS with a P wave that ends 40 ms before it, and a T wave (12, n) mV, every 1 ms."""
    t = np.arange(length)
    p_wave = 0.12 * np.exp(-(((t - start + 85) / 20.0) ** 2))
    t_wave = 0.3 * np.exp(-(((t - end - 200) / 55.0) ** 2))
    return depolarisation(start, end, length) + p_wave + t_wave


BEAT_WINDOW = qrs_window(beat())


@pytest.mark.parametrize(("start", "end"), [(40, 120), (60, 240), (30, 200)])
def test_ends_of_a_clean_qrs(start, end):
    onset, offset = qrs_window(depolarisation(start, end, 400))
    # A kink at the true end is smoothed by a 4 ms Gaussian, so it is seen up to 2.5 widths early.
    assert start - 10 <= onset <= start + 1
    assert end - 1 <= offset <= end + 10
    assert qrs_window(depolarisation(0, 100, 101)) == (0, 100)  # fills the array


def test_a_qrs_between_p_and_t_waves():
    assert qrs_window(beat()) == BEAT_WINDOW == pytest.approx((150, 250), abs=8)


TIME = np.arange(700)
COSINES = np.cos(np.arange(12))[:, None]
NOISE = 0.3 * np.random.default_rng(0).standard_normal(700)


def with_rows(rows, change):
    """The beat with some leads changed."""
    signal = beat()
    signal[rows] = change(signal[rows])
    return signal


@pytest.mark.parametrize(
    ("signal", "tolerance"),
    [
        (1e-6 * beat(), 5), (1e3 * beat(), 5),  # uncalibrated
        (beat() + np.linspace(-1, 1, 12)[:, None] * (2 + TIME / 2000), 2),  # level and drift
        *((beat() + 0.2 * np.sin(0.002 * np.pi * hertz * TIME + np.arange(12)[:, None]), 5)
          for hertz in (50, 60)),
        *((with_rows(row, lambda lead: lead + NOISE), 6) for row in (0, 1, 7, 11)),
        (with_rows([0, 3, 8, 9], lambda leads: np.nan), 6),
        (with_rows([8, 9, 10], lambda leads: 0.2), 6),
        (beat() + 1.5e-3 * COSINES * np.clip(TIME - 250, 0, 150), 12),  # slope of the ST segment
    ],
)  # fmt: skip
def test_what_the_window_does_not_depend_on(signal, tolerance):
    """Amplitude, level, drift, interference, one noisy lead, absent and flat leads, ST slope."""
    assert qrs_window(signal) == pytest.approx(BEAT_WINDOW, abs=tolerance)


def short_pr(height):
    """The P wave, of 75 ms, ends 5 ms before the QRS; what smoothing shows of both merges."""
    p_wave = (
        np.cos(0.3 * np.arange(12))[:, None] * np.sin(np.pi * np.clip((TIME - 70) / 75, 0, 1)) ** 2
    )
    qrs = np.clip((TIME - 150) / 20.0, 0, 1) * depolarisation(150, 250, 700)
    return qrs + height * p_wave


def p_wave_into_low_qrs(height, length):
    qrs = 0.1 * depolarisation(250, 350, 800)  # 0.2 mV in the largest lead
    p_wave = height * hump(np.arange(800.0), 250 - length, 250, 2.0, 2.0)
    return qrs + lead_matrix() @ np.linspace(0.4, 1.0, 9)[:, None] * p_wave


def t_wave_from_the_j_point(height):
    t_wave = height * hump(np.arange(800.0), 332, 540, 1.7, 2.0)
    qrs = 1.5 * depolarisation(250, 330, 800)
    return qrs + lead_matrix() @ np.linspace(-1.0, 0.6, 9)[:, None] * t_wave


def slurred_upstroke():
    """A delta wave of 40 ms and 0.25 mV."""
    rise = np.clip((TIME - 150) / 40.0, 0, 1) ** 1.3 * np.clip((240 - TIME) / 40.0, 0, 1)
    return depolarisation(190, 270, 700) + 0.25 * COSINES * rise


def fragmented():
    """A steep start, a slow middle with notches, a steep end."""
    signal = depolarisation(150, 230, 700) + 0.4 * depolarisation(200, 370, 700)
    notches = (depolarisation(start, start + 20, 700) for start in (240, 275, 310))
    return signal + 0.1 * sum(notches)


def delta_wave(height, length):
    """The PR segment is isoelectric for 20 ms; the delta wave (mV, ms) rises linearly."""
    start = 150 - length
    p_wave = 0.1 * np.sin(np.pi * np.clip((TIME - start + 100) / 80, 0, 1)) ** 2
    delta = np.interp(TIME, [start, 160, 200], [0, height, 0])
    direction = np.cos(0.3 * np.arange(12))[:, None]
    return 0.4 * depolarisation(150, 250, 700) + direction * (p_wave + delta)


def in_digits(digit):
    """Triangles of some 0.01 mV/ms: what is slower than a digit a sample."""
    beats = np.linspace(0.3, 1.2, 12)[:, None] * np.interp(TIME, [228, 300, 372], [0, 1, 0])
    beats = beats + 0.005 * np.random.default_rng(0).standard_normal((8, 12, 700))
    return (np.round(beats / digit) * digit).mean(axis=0)


@pytest.mark.parametrize(
    ("signal", "window", "tolerance"),
    [
        *((short_pr(height), (150, 250), 15) for height in (0.05, 0.1, 0.15)),
        *((p_wave_into_low_qrs(*p), (250, 350), 12) for p in ((0.15, 90), (0.3, 110))),  # mV, ms
        *((t_wave_from_the_j_point(height), (250, 330), 16) for height in (0.2, 0.5)),
        (slurred_upstroke(), (150, 270), 10), (fragmented(), (150, 370), 10),
        *((delta_wave(height, length), (150 - length, 250), 9)
          for height in (0.15, 0.3) for length in (30, 50)),
        *((in_digits(digit), (228, 372), 7) for digit in (0.001, 0.00488, 0.02)),
    ],
)  # fmt: skip
def test_difficult_beats(signal, window, tolerance):
    assert qrs_window(signal) == pytest.approx(window, abs=tolerance)


def test_no_signal_is_an_error():
    with pytest.raises(ValueError, match="do not move"):
        qrs_window(np.zeros((12, 100)))
    with pytest.raises(ValueError, match="lead"):
        qrs_window(np.full((12, 100), np.nan))
    signal = np.zeros((12, 300))
    signal[7, 100:] = 1.0
    with pytest.raises(ValueError, match="one of many alone"):
        qrs_window(signal)


def test_nothing_before_the_end_of_a_spike_counts():
    signal = beat()
    signal[:, 140:144] += 5.0 * np.cos(np.arange(12))[:, None]
    assert qrs_window(signal)[0] < 140
    onset, offset = qrs_window(signal, not_before=146)
    assert 146 <= onset == pytest.approx(150, abs=6)
    assert offset == BEAT_WINDOW[1]


def in_leads(leads, start, end, size=0.06):
    """A wave (12, 700), mV, in some leads only."""
    phase = np.clip((np.arange(700) - start) / (end - start), 0, 1)
    wave = np.zeros((12, 700))
    wave[list(leads)] = size * np.sin(np.pi * phase) ** 2
    return wave


def test_two_electrodes_decide_but_not_one_nor_the_limb_leads_that_share_theirs():
    """Some leads move 25 ms before and after the others: all together hardly do."""
    for leads in ([6, 8], [0, 1, 2, 7]):
        moved = beat() + in_leads(leads, 125, 175, 0.2) + in_leads(leads, 225, 275, 0.2)
        onset, offset = qrs_window(moved)
        assert 125 <= onset <= 141
        assert 265 <= offset <= 281
    for leads in ([7], [11], range(6)):
        moved = beat() + in_leads(leads, 110, 175) + in_leads(leads, 225, 300)
        assert qrs_window(moved) == pytest.approx(BEAT_WINDOW, abs=6)


def test_marks_that_rest_on_few_leads_are_less_sure():
    beats = np.stack([beat()] * 3)
    apart = beats + in_leads([6, 8], 110, 175, 0.3) + in_leads([6, 8], 225, 300, 0.3)
    sure, unsure = (np.array(window_uncertainty(some)) for some in (beats, apart))
    assert (unsure > sure + 3).all()


def test_the_window_is_the_same_with_the_noise_of_recordings_as_without(default_model):
    """A simulated ECG has none: the level must not be that of the noise."""
    block = {"interventricular_delay": -60.0}
    simulation = default_model.simulate(example_parameters(default_model) | block)
    clean = simulation.qrs_duration
    assert -10 < clean - np.ptp(simulation.activation) < 5
    rng = np.random.default_rng(5)
    noisy = []
    for _ in range(8):
        case = simulated(rng, simulation, 30.0, 10)
        onset, offset = qrs_window(case.beats.mean(axis=0))
        # some are slowed to a wide QRS
        noisy.append(offset - onset - (case.offset - case.onset))
    assert np.median(noisy) == pytest.approx(clean - np.ptp(simulation.activation), abs=6)


def lowpass(cutoff, order):
    return Filter(FilterKind.LOW_PASS, cutoff, FilterOrigin.STATED, order)


def test_ringing_is_no_qrs(default_model):
    leads = default_model.simulate(SHORT_BUNDLES).leads
    sharp = np.pad(leads, ((0, 0), (250, 250)))
    size, true = sharp.shape[1], qrs_window(sharp)
    for cutoff, order in ((35.0, 20.0), (40.0, 20.0), (40.0, 10.0)):
        filters = (lowpass(cutoff, order),)
        gain = filters[0].gain(np.fft.rfftfreq(size, 1e-3))
        blurred = np.fft.irfft(gain * np.fft.rfft(sharp), size)
        assert np.ptp(qrs_window(blurred)) - np.ptp(true) > 20
        found = qrs_window(blurred, smoothing=smoothing_against_ringing(filters))
        assert found == pytest.approx(true, abs=11)


def test_gentle_and_fast_filters_need_no_smoothing():
    notch = Filter(FilterKind.NOTCH, 50.0, FilterOrigin.FILE, 30.0)
    assert smoothing_against_ringing(()) == SMOOTHING
    assert smoothing_against_ringing((lowpass(40.0, 2.0), lowpass(150.0, 20.0), notch)) == SMOOTHING
    assert smoothing_against_ringing((lowpass(100.0, 20.0), lowpass(40.0, 20.0))) == 10.0


def noisy_beats(rng, count, noise):
    clean = depolarisation(200, 300, 700, power=1.5)
    return clean + noise * rng.standard_normal((count, *clean.shape))


def test_noisier_beats_are_less_sure_and_more_beats_are_surer():
    rng = np.random.default_rng(1)
    few, quiet, many, clean = (
        np.array(window_uncertainty(noisy_beats(rng, *case)))
        for case in ((6, 0.15), (6, 0.02), (48, 0.15), (5, 0.0))
    )
    assert (few > quiet + 0.3).all()
    assert (few > many + 0.3).all()
    assert clean == pytest.approx((ONSET_ERROR, OFFSET_ERROR), abs=0.5)  # of the method
    one = noisy_beats(rng, 1, 0.0)
    little, much = (np.array(window_uncertainty(one, noise=noise)) for noise in (0.005, 0.15))
    assert little == pytest.approx((ONSET_ERROR, OFFSET_ERROR), abs=0.5)
    assert (much > little + 0.5).all()


def test_uncertainty_after_a_spike_and_with_absent_leads():
    """A spike whose height varies makes the onset unsure unless it is left out."""
    rng = np.random.default_rng(5)
    beats = noisy_beats(rng, 6, 0.02)
    beats[:, :, 180:183] += rng.choice([0.0, 3.0], (6, 1, 1)) * np.cos(np.arange(12))[:, None]
    beats[:, [2, 8]] = np.nan
    after = window_uncertainty(beats, not_before=185)
    assert after[0] == pytest.approx(ONSET_ERROR, abs=0.5)


def test_noise_of_the_found_ends_is_foreseen():
    """Over many recordings the ends scatter about as much as is said of each."""
    rng = np.random.default_rng(6)
    windows, variances = [], []
    for _ in range(12):
        beats = noisy_beats(rng, 6, 0.3)
        windows.append(qrs_window(beats.mean(axis=0)))
        variances.append(np.square(window_uncertainty(beats)))
    assert window_uncertainty(beats) == window_uncertainty(beats.copy())  # it draws alike
    scatter = np.std(windows, axis=0)
    foreseen = np.sqrt(np.mean(variances, axis=0) - np.square([ONSET_ERROR, OFFSET_ERROR]))
    assert (foreseen > 0.6 * scatter).all()
    assert (foreseen < 2.5 * scatter).all()
