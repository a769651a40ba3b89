"""Targets of recordings, synthetic ones whose QRS is known exactly and real ones."""

import numpy as np
import pytest
from quality_recordings import analysed

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS, lead_matrix
from fascicle.recording.pipeline import analyse, make_target
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import MissingMetadataError, Recording

ONSET, OFFSET = -45.0, 55.0  # ms from the nominal R


def hump(t, start, end):
    """sin² between start and end, 0 outside: its ends are known."""
    phase = np.clip((t - start) / (end - start), 0, 1)
    return np.sin(np.pi * phase) ** 2


def beat(t, tall_t=1.0):
    """Nine electrode potentials (mV) of one beat; the QRS spans ONSET to OFFSET."""
    rng = np.random.default_rng(3)
    r, s, p, wave_t = rng.normal(size=(4, 9))
    return (
        1.2 * r[:, None] * hump(t, ONSET, 20)
        + 0.7 * s[:, None] * hump(t, -10, OFFSET)
        + 0.08 * p[:, None] * hump(t, -200, -100)
        + 0.25 * tall_t * wave_t[:, None] * hump(t, 130, 330)
    )


def ecg(rate=500.0, seconds=10.0, interval=850.0, jitter=15.0, ectopic=(), tall_t=1.0):
    """(12, n) mV and the R times (ms)."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * rate)) * 1000 / rate
    times = np.arange(400.0, t[-1], interval)
    times += rng.uniform(-jitter, jitter, 100)[: len(times)]
    signal = np.zeros((12, len(t)))
    for k, centre in enumerate(times):
        if k in ectopic:
            wide = np.random.default_rng(9).normal(size=(9, 1)) * hump(t - centre, -90, 110)
            signal += lead_matrix() @ (2.0 * wide)
        else:
            signal += lead_matrix() @ beat(t - centre, tall_t)
    return signal + 0.004 * rng.normal(size=signal.shape), times


@pytest.fixture(scope="module")
def plain():
    return make_target(Recording(ecg()[0], 500.0, "plain"))


@pytest.fixture(scope="module")
def ectopic():
    return Recording(ecg(ectopic=(2, 5, 8))[0], 500.0, "ectopic")


def true_window(target):
    """Window in the target's own time: its R is not the nominal one, but a constant away."""
    clean = lead_matrix() @ beat(target.time)
    shifts = np.arange(-60, 61)
    inner = slice(100, -100)
    score = [np.sum(np.roll(clean, s, axis=1)[:, inner] * target.mean[:, inner]) for s in shifts]
    shift = shifts[int(np.argmax(score))]
    return ONSET + shift, OFFSET + shift


@pytest.mark.parametrize("rate", [250.0, 977.0, 2000.0])
def test_window_is_found_at_every_sampling_rate(rate):
    target = make_target(Recording(ecg(rate, seconds=6.0)[0], rate, "synthetic"))
    onset, offset = true_window(target)
    assert target.qrs_onset == pytest.approx(onset, abs=7)
    assert target.qrs_offset == pytest.approx(offset, abs=7)
    assert target.heart_rate == pytest.approx(60000 / 850, rel=0.02)
    assert np.diff(target.time) == pytest.approx(1.0)
    assert 0.0 in target.time


@pytest.mark.parametrize(("interval", "tall_t"), [(360.0, 1.0), (1500.0, 1.0), (1200.0, 5.0)])
def test_slow_and_fast_rhythms_and_tall_t_waves(interval, tall_t):
    signal, times = ecg(interval=interval, jitter=3.0, tall_t=tall_t)
    target = make_target(Recording(signal, 500.0, "synthetic"))
    assert target.heart_rate == pytest.approx(60000 / interval, rel=0.02)
    assert len(target.beats) >= len(times) - 2
    assert np.ptp(target.time) <= min(700, interval) + 1
    if interval > 500:
        assert target.qrs_duration == pytest.approx(OFFSET - ONSET, abs=14)


def test_drift_is_removed(plain):
    clean, _ = ecg()
    t = np.arange(clean.shape[1]) / 500.0
    drift = 0.3 * np.sin(2 * np.pi * 0.25 * t) + 0.05 * t
    drifting = make_target(Recording(clean + drift, 500.0, "drifting"))
    inside = plain.qrs_samples
    assert np.abs(drifting.qrs - plain.mean[:, drifting.qrs_samples]).max() < 0.02
    assert drifting.standard_deviation[:, inside].max() < 0.1
    assert np.abs(drifting.mean[:, inside.start]).max() < 0.02


def test_ectopic_beats_are_left_out_unless_they_are_asked_for(plain, ectopic):
    target = make_target(ectopic)
    assert target.provenance["beats_found"] == "12"
    assert len(target.beats) == len(plain.beats) - 3
    assert np.abs(target.qrs - plain.mean[:, target.qrs_samples]).max() < 0.03
    many = make_target(Recording(ecg(ectopic=(1, 3, 5, 7))[0], 500.0, "many"))
    assert "only 8 of 12 beats are of class A" in "\n".join(many.warnings)
    of_class = make_target(ectopic, beat_class="B")
    named = make_target(ectopic, beats=(3, 6, 9))
    assert np.array_equal(named.beats, of_class.beats)
    assert named.provenance["beat_class"] == "B"
    assert named.provenance["beat_numbers"] == "3, 6, 9"
    mixed = make_target(ectopic, -60, 60, beats=(2, 3))
    assert mixed.provenance["beat_class"] == "A, B"
    with pytest.raises(InputError, match="not both"):
        make_target(ectopic, beats=(2, 3), beat_class="A")


def test_beats_that_alternate_may_be_twice_as_many_as_there_are():
    """Ectopic beats, and T waves as steep as a QRS, which no rule tells from them."""
    bigeminy, times = ecg(ectopic=range(1, 12, 2))
    target = make_target(Recording(bigeminy, 500.0, "bigeminy"))
    assert target.provenance["beats_found"] == str(len(times))
    assert "beats of two classes alternate" in "\n".join(target.warnings)
    assert "are of class A" not in "\n".join(target.warnings)
    rate = 500.0
    t = np.arange(round(10 * rate)) * 1000 / rate
    signal = 0.004 * np.random.default_rng(0).normal(size=(12, len(t)))
    steep_t = np.random.default_rng(5).normal(size=(9, 1))
    for centre in np.arange(400.0, t[-1], 1000.0):
        wave = steep_t * hump(t - centre, 250, 350)
        signal += lead_matrix() @ (beat(t - centre, tall_t=0) + wave)
    doubled = make_target(Recording(signal, rate, "doubled"))
    assert doubled.heart_rate == pytest.approx(120, rel=0.05)
    assert "twice as many were found as there are" in "\n".join(doubled.warnings)
    chosen = make_target(Recording(signal, rate, "doubled"), beats=(3, 5, 7))
    assert "alternate" not in "\n".join(chosen.warnings)


def test_window_can_be_given(plain):
    recording = Recording(ecg()[0], 500.0, "synthetic")
    target = make_target(recording, onset=-60, offset=80.5)
    assert (target.qrs_onset, target.qrs_offset, target.qrs_duration) == (-60, 80.5, 140.5)
    assert target.qrs.shape == (12, 141)
    assert target.provenance["qrs_onset_from"] == "given"
    only_one = make_target(recording, offset=90.0)
    assert only_one.qrs_offset == 90.0
    assert only_one.qrs_onset == plain.qrs_onset
    for onset, offset in ((20, -20), (-10, 5), (-400, 50), (-50, 900), (float("nan"), 50)):
        with pytest.raises(InputError, match=r"^.*QRS window.* ms.*$"):
            make_target(recording, onset=onset, offset=offset)


def changed(rows, samples, value):
    def change(signal):
        signal[rows, samples] = value
        return signal

    return change


@pytest.mark.parametrize(
    ("change", "rate", "words"),
    [
        (changed(7, slice(None), 0.3), 500.0, r"no signal in lead V2; .*leads=\['I', 'II', 'III',"),
        (changed(1, slice(40, 50), np.nan), 500.0, r"lead II lacks 10 samples .*40, at 0.080 s"),
        (lambda s: s, 125.0, "sampling rate is 125 Hz"),
        (lambda s: s[:, :150], 500.0, "0.30 s long"),
        (lambda s: np.tile(s, 200), 500.0, "2000 s long, .*; cut it to 1800 s"),
        (lambda s: np.full_like(s, np.nan), 500.0, "no lead holds a sample"),
        (lambda s: s[:11], 500.0, r"shape \(11, 5000\)"),
        (lambda s: s[:, :800], 500.0, "a single beat .*noise=0.03 is a guess"),
        (lambda s: s[:, 20:220], 500.0, "noise="),
        (lambda s: 1000 * s, 500.0, "spans .* mV in one beat"),
        (np.zeros_like, 500.0, "no signal in any lead"),
        (changed([*range(6), *range(7, 12)], slice(None), 0.0), 500.0, "no signal in leads I, II"),
        (lambda s: np.pad(s, ((0, 0), (0, 15_000))), 500.0, "no signal in any lead for up to 30"),
        (lambda s: np.tile([[0.0, 1.0]], (12, 2500)), 500.0, "QRS|the same"),
        (
            lambda s: 0.1 * np.random.default_rng(1).normal(size=s.shape), 500.0,
            "beats|mV in one beat",
        ),
    ],
)  # fmt: skip
def test_unusable_recordings_are_refused_in_one_line(change, rate, words):
    with pytest.raises(InputError, match=words) as info:
        make_target(Recording(change(ecg()[0]), rate, "file.csv"))
    assert str(info.value).startswith("file.csv: ")
    assert "\n" not in str(info.value)


@pytest.mark.parametrize(("factor", "size"), [(0.1, "low"), (5.0, "high")])
def test_an_implausible_amplitude_is_asked_and_may_be_confirmed(tmp_path, factor, size):
    signal, _ = ecg(seconds=5.0)
    signal = factor * signal * 1.6 / np.ptp(signal, axis=1).max()  # mV
    table = tmp_path / "ecg.csv"
    header = ",".join(f"{lead} (mV)" for lead in LEADS)
    np.savetxt(table, signal.T, "%.5f", ",", header=header, comments="")

    def made(unit=None):
        return make_target(read_recording(table, sampling_rate=500.0, unit=unit))

    with pytest.raises(MissingMetadataError, match=r"the QRS spans .* mV .* by unit="):
        made()
    assert f"{size} voltage: the QRS spans" in "\n".join(made("mV").warnings)
    # a simulated ECG in memory is in mV by definition
    assert make_target(Recording(signal, 500.0, "simulated")).qrs_duration > 50


def test_odd_rates_do_not_drift():
    """Beats half a minute on lie where they were recorded."""
    signal, times = ecg(rate=499.93, seconds=30.0, jitter=0.0)
    beats = analyse(Recording(signal, 499.93, "synthetic")).beats
    assert len(times) == len(beats)
    assert beats[-1].time - beats[0].time == pytest.approx((len(times) - 1) * 0.85, abs=0.0015)


def test_real_recordings(data_folder):
    for file in ("ludb/24", "ludb/23", "ludb/119"):
        with pytest.raises(InputError, match=r"gains.*shared_gain=True"):
            make_target(read_recording(data_folder / "ecg" / file))
    known = {"LBBB": (7, 162), "RBBB": (10, 137), "normal": (8, 87), "infarct": (50, 130)}
    for name, (count, width) in known.items():
        target = analysed(data_folder)[name].target
        assert len(target.beats) == pytest.approx(count, abs=2)
        assert target.qrs_duration == pytest.approx(width, abs=10)
        before = (target.time >= target.qrs_onset - 15) & (target.time < target.qrs_onset)
        assert np.abs(target.mean[:, before]).max() < 0.06
