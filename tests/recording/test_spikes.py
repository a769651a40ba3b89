"""Pacing spikes: found, taken out, not seen where there are none; ends of the QRS after them."""

import numpy as np
import pytest
from quality_recordings import real, synthetic
from scipy.ndimage import gaussian_filter1d

import fascicle
from benchmarks.pacing_spikes import DISTURBANCES, PACING, UNPACED, counts, disturbed, paced
from benchmarks.synthetic_recordings.rhythms import RHYTHMS, Synthesis, hump, synthetic_recording
from fascicle.core.leads import lead_matrix
from fascicle.recording.recording import Recording
from fascicle.recording.spikes import find_spikes, remove_spikes, spike_tail

# Of the beats and spikes of the recordings of which the ends of the QRS are known (mV)
SIZES = np.array([0.3, -1.0, -1.3, 0.35, 0.8, -1.15, -0.9, -1.4, -1.5, -1.2, -0.6, 0.25])[:, None]
SPIKE = np.array([0.5, -0.6, -1.1, 0.05, 0.8, -0.85, 0.4, 0.6, 0.7, 0.7, 0.45, 0.2])[:, None]
CYCLE, FIRST = 950, 600  # ms


@pytest.mark.parametrize(
    ("rate", "size", "noise_db"),
    [(250.0, 1.0, None), (500.0, 40.0, 15.0), (1000.0, 3.0, 20.0), (2000.0, 1.0, 25.0)],
)
def test_atrial_and_ventricular_spikes_are_found(rate, size, noise_db):
    total, atrial = np.zeros(3), 0
    for seed in range(6):
        recording, truth = synthetic(
            seed, rhythm="paced", rate=rate, spike_size=size, noise_db=noise_db
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
    for seed, rate in enumerate((250.0, 1000.0)):
        for options in ({"height": 5.0}, {"noise_db": 10.0, "noise": ("white", "muscle")}):
            recording, truth = synthetic(seed, rhythm=rhythm, rate=rate, **options)
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


@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_spikes_lie_about_the_pulse_and_what_is_left_is_the_beat(rate):
    options = {"rhythm": "paced", "rate": rate, "respiration": 0.0}
    recording, truth = synthetic(3, spike_size=20.0, **options)
    bare, _ = synthetic(3, spike_size=1e-9, **options)
    assert np.abs(recording.signal - bare.signal).max() > 10
    spikes = find_spikes(recording.signal, rate)
    assert np.abs(remove_spikes(recording.signal, spikes, rate) - bare.signal).max() < 0.1
    assert len(spikes) == len(truth.spikes) > 5
    assert (spikes[:, 0] / rate <= truth.spikes + 1 / rate).all()
    assert (spikes[:, 1] / rate >= truth.spikes).all()
    assert (np.diff(spikes, axis=1) <= max(0.008 * rate, 5)).all()


@pytest.mark.parametrize("rate", [250.0, 800.0])
@pytest.mark.parametrize("what", DISTURBANCES)
def test_no_spike_is_invented(what, rate):
    for seed in range(3):
        rng = np.random.default_rng([seed, int(rate)])
        synthesis = Synthesis(rhythm=UNPACED[seed % len(UNPACED)], rate=rate)
        recording, _ = synthetic_recording(rng, synthesis)
        signal = disturbed(rng, recording.signal, rate, what)
        assert find_spikes(signal, rate).shape == (0, 2), (seed, what)


def test_hum_of_one_source_in_coarse_digits_is_no_spike():
    """Its crests are alike in pattern, so that one that stood out used to draw in the others."""
    for seed in range(4):
        rng = np.random.default_rng([8, 4 * seed + 3])
        recording, _ = synthetic_recording(rng, Synthesis(rate=800.0, seconds=30.0))
        t = np.arange(recording.signal.shape[1]) / 800.0
        hum = sum(
            rng.uniform() * np.sin(2 * np.pi * 50 * harmonic * t + rng.uniform(0, 6))
            for harmonic in (1, 3, 5, 7)
        )
        lead = lead_matrix() @ rng.uniform(0.4, 2, 9)
        signal = recording.signal + 0.48 * lead[:, None] * hum / np.abs(hum).max()
        assert len(find_spikes(0.02 * np.round(signal / 0.02), 800.0)) == 0, seed


@pytest.mark.parametrize("pacing", PACING)
def test_every_kind_of_pacing_is_found(pacing):
    for seed, rate in enumerate((250.0, 500.0)):
        for what in ("clean", "digits", "muscle", "edge"):
            rng, signal, times = paced(seed, pacing, rate)
            signal = disturbed(rng, signal, rate, what, size=0.1)
            found, missed, false = counts(find_spikes(signal, rate), times, rate)
            assert (missed, false) == (0, 0), (seed, what)
            assert found > 5


def test_spikes_of_two_chambers_below_tall_t_waves():
    """Those of the atria are before no wave as high as a T wave, but come at the same rate."""
    rng = np.random.default_rng([106, 11])
    recording, truth = synthetic_recording(rng, Synthesis(rhythm="paced", tall_t=6.0, noise_db=20))
    spikes = find_spikes(recording.signal, recording.sampling_rate)
    found, missed, false = counts(spikes, truth.spikes, recording.sampling_rate)
    assert (found, missed, false) == (len(truth.spikes), 0, 0)


def test_a_single_beat_keeps_its_spikes():
    for seed in range(6):
        _, signal, times = paced(seed, "biventricular", 500.0)
        start = round(500.0 * (times[4] - 0.4))
        beat = signal[:, start : start + 500]
        inside = times[(times > start / 500 + 0.05) & (times < start / 500 + 0.5)] - start / 500
        assert counts(find_spikes(beat, 500.0), inside, 500.0)[:2].tolist() == [len(inside), 0]


def test_real_recordings_have_no_spikes(data_folder):
    for name, recording in real(data_folder).items():
        for digit, factor in ((0.005, 2), (0.02, 1)):
            signal = digit * np.round(recording.signal / digit)
            rate = recording.sampling_rate / factor
            assert len(find_spikes(signal[:, ::factor], rate)) == 0, name


def paced_recording(latency, length, rise, share=0.0, decay=10.0, atrial=None):
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
    return marked(*paced_recording(30, 140, 1.2))[0]


@pytest.mark.parametrize(
    ("latency", "length", "rise"), [(6, 130, 2.0), (40, 130, 2.0), (20, 180, 2.5), (6, 270, 2.0)]
)
def test_slow_first_part_after_a_spike(latency, length, rise):
    off, sd, analysis = marked(*paced_recording(latency, length, rise))
    # such a QRS becomes visible, at 0.02 mV, after 5 to 15 ms
    assert (np.abs(off - (8, -8)) <= 2 * sd).all()
    assert analysis.classes[0].description == "paced"


@pytest.mark.parametrize(("share", "decay"), [(0.1, 4.0), (0.03, 10.0), (0.1, 25.0)])
def test_tail_of_a_spike_is_no_qrs(clean, share, decay):
    off, _, analysis = marked(*paced_recording(30, 140, 1.2, share, decay))
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
    without, _, _ = marked(*paced_recording(20, 120, 1.3))
    for latency in (None, 20):
        off, _, _ = marked(*paced_recording(latency, 120, 1.3, atrial=160))
        assert off == pytest.approx(without, abs=4)


def test_spike_into_a_qrs_that_has_begun():
    """Pseudofusion: the onset lies before the spike, and the beat is not called paced."""
    off, _, analysis = marked(*paced_recording(-40, 100, 1.3))
    assert off == pytest.approx((0, 0), abs=9)
    assert analysis.classes[0].description == ""


# Right values: onset and offset (ms from R) of the file's QRS, and the features of its class
@pytest.mark.parametrize(
    ("name", "onset", "offset", "description"),
    [
        ("c08_rv_slow_150.xml", -148, 125, "paced"),
        ("c05_spike_decay.hea", -68, 62, "paced"),
        ("c03_triangle_muse.xml", -72, 72, ""),
        ("biventricular_vv15.csv", -90, 65, "paced"),  # 15 ms apart, the first fires the QRS
        ("two_spikes_8ms.csv", -90, 65, "paced"),
        ("st_elevation_convex.csv", -45, 45, ""),  # of 0.96 mV, from the J point on
    ],
)
def test_cases(data_folder, name, onset, offset, description):
    analysis = fascicle.analyse(fascicle.read_recording(data_folder / "cases" / name))
    target = analysis.target
    assert target.qrs_onset == pytest.approx(onset, abs=10)
    assert abs(target.qrs_offset - offset) <= 2 * target.offset_sd
    assert analysis.classes[0].description == description
    assert not any(word in "\n".join(target.warnings) for word in ("--swap", "clipped"))
    assert not any(c.met for c in target.conventional_criteria if "left bundle" in c.name)


def test_nothing_is_left_of_two_spikes_in_the_qrs(data_folder):
    """They ring at 150 Hz, faster than a QRS."""
    recording = fascicle.read_recording(data_folder / "cases" / "two_spikes_8ms.csv")
    qrs = fascicle.make_target(recording).qrs
    ringing = qrs - gaussian_filter1d(qrs, 5.0)
    assert np.abs(ringing).max() < 0.05  # mV


@pytest.mark.parametrize("count", ["3", "7", "arms_reversed"])
def test_muscle_twitches_are_no_spikes(data_folder, count):
    """Without them nothing keeps reversed arms from being found."""
    path = data_folder / "cases" / f"muscle_twitches_{count}.csv"
    analysis = fascicle.analyse(fascicle.read_recording(path))
    assert analysis.classes[0].description == ""
    assert analysis.target.earliest_onset is None
    assert ("--swap RA-LA" in "".join(analysis.target.warnings)) == (count == "arms_reversed")
