"""Gains of filters, which of them a target has passed, and what is found in a spectrum."""

from dataclasses import replace

import numpy as np
import pytest
from quality_recordings import beating, real, synthetic
from scipy.signal import bessel, butter, ellip, firwin, oaconvolve, sosfilt, sosfiltfilt

from benchmarks.fits import demo_recording
from benchmarks.synthetic_recordings.rhythms import RHYTHMS
from fascicle.core.errors import InputError
from fascicle.networks.target_comparison import target_digest
from fascicle.recording.choices import TargetOptions
from fascicle.recording.detection import r_peaks
from fascicle.recording.filter_estimate import estimated_lowpass, passed_filters
from fascicle.recording.filters import Filter, FilterKind, FilterOrigin, applied_filters
from fascicle.recording.pipeline import analyse
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Filters
from fascicle.recording.target import Target

RECORDER = FilterOrigin.FILE


@pytest.mark.parametrize(("lowpass", "mains"), [(40.0, None), (150.0, None), (None, 50.0)])
def test_gain_is_what_the_applied_filter_does(lowpass, mains):
    """Spectrum of what is left of an impulse."""
    impulse = np.zeros((1, 4000))
    impulse[0, 2000] = 1.0
    (applied,) = applied_filters(lowpass, mains)
    spectrum = np.abs(np.fft.rfft(applied.apply(impulse)[0]))
    frequency = np.fft.rfftfreq(4000, 1e-3)
    # the notch rings for longer than the signal lasts on either side
    atol = 1e-9 if mains is None else 1e-4
    np.testing.assert_allclose(applied.gain(frequency), spectrum, atol=atol)
    if lowpass is not None:
        assert np.interp(lowpass, frequency, spectrum) == pytest.approx(0.5)


def test_gains_are_3_db_down_where_they_should_and_those_of_several_multiply():
    for order in (1.0, 6.5, 20.0):
        lowpass = Filter(FilterKind.LOW_PASS, 40.0, RECORDER, order)
        zero, cutoff, far, farther = lowpass.gain(np.array([0.0, 40.0, 400.0, 800.0]))
        assert zero == 1.0
        assert cutoff == pytest.approx(0.5**0.5)
        assert far / farther == pytest.approx(2**order, rel=0.01)
    notch = Filter(FilterKind.NOTCH, 50.0, RECORDER, 30.0)
    gain = notch.gain(np.array([0.0, 50.0, 50.0 + 25.0 / 30.0, 40.0, 100.0]))
    np.testing.assert_allclose(gain, [1.0, 0.0, 0.5**0.5, 1.0, 1.0], atol=0.01)
    one = Filter(FilterKind.LOW_PASS, 40.0, RECORDER, 2.0)
    other = Filter(FilterKind.LOW_PASS, 100.0, RECORDER, 4.0)
    frequency = np.linspace(0, 200, 21)
    product = one.gain(frequency) * other.gain(frequency)
    plain = Target(np.zeros((2, 12, 50)), np.arange(-20.0, 30.0), -10.0, 20.0, 60.0)
    behind = replace(plain, filters=(one, other))
    np.testing.assert_allclose(behind.response(frequency / 1000), product, rtol=1e-12)
    assert plain.response is None


@pytest.mark.parametrize(
    ("frequency", "shape", "rate"),
    [(np.nan, 2.0, None), (40.0, -1.0, None), (600.0, 2.0, 1000.0), (40.0, 2.5, 1000.0),
     (40.0, 1e9, 1000.0), (40.0, 2.0, np.nan)],
)  # fmt: skip
def test_filters_that_cannot_be(frequency, shape, rate):
    with pytest.raises(ValueError, match="impossible"):
        Filter(FilterKind.LOW_PASS, frequency, RECORDER, shape, rate)


def passed(recording, **options):
    peaks = r_peaks(recording.signal, recording.sampling_rate)
    filters = passed_filters(recording, peaks, TargetOptions(**options))
    return [(one.kind.value, one.frequency, one.origin) for one in filters]


def test_the_file_counts_before_the_user():
    recording = beating()
    assert passed(recording) == []
    assert passed(recording, recorder_lowpass=100.0) == [("low-pass", 100.0, FilterOrigin.STATED)]
    named = replace(recording, filters=Filters(lowpass=150.0, notch=60.0, highpass=0.05))
    by_file = [("low-pass", 150.0, FilterOrigin.FILE), ("notch", 60.0, FilterOrigin.FILE)]
    assert passed(named) == passed(named, recorder_lowpass=150.0) == by_file
    with pytest.raises(InputError, match=r"150 Hz in the file, not 40 Hz; leave recorder_lowpass="):
        passed(named, recorder_lowpass=40.0)
    applied = FilterOrigin.APPLIED
    assert passed(named, lowpass=100.0, notch=50.0) == [
        *by_file, ("low-pass", 100.0, applied), ("notch", 50.0, applied)
    ]  # fmt: skip


def test_a_target_knows_what_it_has_passed():
    recording = beating()
    plain = analyse(recording).target
    assert plain.filters == ()
    assert plain.response is None
    assert plain.provenance["filters"] == "none known"
    stated = analyse(recording, TargetOptions(recorder_lowpass=50.0)).target
    np.testing.assert_array_equal(stated.beats, plain.beats)  # the recorder has done it already
    assert stated.response(np.array([0.05]))[0] == pytest.approx(0.5**0.5)  # cycles per sample
    assert "low-pass 50 Hz" in stated.provenance["filters"]
    assert target_digest(stated) != target_digest(plain)
    other = replace(stated, filters=(replace(stated.filters[0], origin=FilterOrigin.ESTIMATED),))
    assert target_digest(other) == target_digest(stated)


def test_a_stated_lowpass_is_set_against_the_spectrum():
    whole = replace(read_recording(demo_recording()), filters=Filters())
    steep = butter(10, 40.0, fs=whole.sampling_rate, output="sos")
    smoothed = replace(whole, signal=sosfiltfilt(steep, np.nan_to_num(whole.signal)))

    def said(recording, **options):
        return "\n".join(analyse(recording, TargetOptions(**options)).target.warnings)

    assert "the spectrum shows a low-pass at 3" in said(smoothed, recorder_lowpass=60.0)
    assert "the spectrum shows" not in said(smoothed)
    assert "the spectrum shows" not in said(whole, recorder_lowpass=60.0)


def steep(cutoff, rate):
    """Steep low-passes, run once or forward and backward."""
    twice = butter(10, cutoff, fs=rate, output="sos")
    elliptic = ellip(6, 0.5, 60, cutoff, fs=rate, output="sos")
    taps = firwin(round(0.2 * rate) | 1, cutoff, fs=rate)
    return {
        "Butterworth": lambda signal: sosfiltfilt(twice, signal),
        "elliptic": lambda signal: sosfilt(elliptic, signal),
        "FIR": lambda signal: oaconvolve(
            oaconvolve(signal, taps[None], "same", 1), taps[None], "same", 1
        ),
    }


def gentle(cutoff, rate):
    """Low-passes that look like a smooth QRS."""
    return {
        "Butterworth": lambda signal: sosfilt(butter(2, cutoff, fs=rate, output="sos"), signal),
        "Bessel": lambda s: sosfilt(bessel(4, cutoff, fs=rate, output="sos", norm="mag"), s),
    }


def cut_off(apply, rate):
    """Frequency (Hz) at which a filter is 3 dB down."""
    impulse = np.zeros((1, 8 * rate))
    impulse[0, 4 * rate] = 1.0
    gain = np.abs(np.fft.rfft(apply(impulse)[0]))
    return np.argmax(gain < gain[0] * 0.5**0.5) / 8


def estimate(signal, rate, peaks):
    """Cut-off (Hz) that is found after the signal has been stored in digits of 1 uV."""
    found = estimated_lowpass(np.round(signal / 1e-3) * 1e-3, rate, peaks)
    return None if found is None else found.frequency


def test_steep_filters_on_real_recordings_are_found_and_gentle_ones_not(data_folder):
    for number, (name, recording) in enumerate(real(data_folder).items()):
        rate, cutoff = round(recording.sampling_rate), (40.0, 100.0)[number % 2]
        signal = np.nan_to_num(recording.signal[:, : 10 * rate])
        peaks = r_peaks(signal, rate)
        assert estimated_lowpass(signal, rate, peaks) is None, name
        found = {
            shape: (estimate(apply(signal), rate, peaks), cut_off(apply, rate))
            for shape, apply in steep(cutoff, rate).items()
        }
        # one may be missed, and none may be wrong
        assert sum(value is not None for value, _ in found.values()) >= 2, (name, found)
        for shape, (value, truth) in found.items():
            assert value is None or value == pytest.approx(truth, abs=6.0), (name, shape)
        for shape, apply in gentle(cutoff, rate).items():
            assert estimate(apply(signal), rate, peaks) is None, (name, shape)


@pytest.mark.parametrize("rhythm", RHYTHMS)
def test_nothing_is_found_in_synthetic_recordings(rhythm):
    """Their QRS are sums of Gaussians, whose spectra fall faster and faster."""
    for seed, rate, noise_db in ((0, 500, 10.0), (1, 1000, 30.0), (0, 500, None)):
        recording, truth = synthetic(seed, rhythm=rhythm, rate=rate, noise_db=noise_db)
        peaks = np.round(truth.r_times * rate).astype(int)
        assert estimate(recording.signal, rate, peaks) is None


def test_one_averaged_beat_of_a_subject(data_folder):
    """Its spectrum falls by 40 dB from 35 to 43 Hz."""
    beat = read_recording(data_folder / "hearts" / "dti004" / "ecg_beat.csv", unit="uV")
    found = estimated_lowpass(beat.signal, 1000.0, np.array([142]))
    assert found is not None
    assert found.frequency == pytest.approx(35.0, abs=1.0)
    assert found.shape == pytest.approx(20.0, abs=4.0)
    assert estimated_lowpass(np.zeros((12, 200)), 1000.0, np.array([100])) is None  # too short
