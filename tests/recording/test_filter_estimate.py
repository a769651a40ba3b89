"""The low-pass that is found in a spectrum, and those that are not invented."""

from __future__ import annotations

import numpy as np
import pytest
from quality_recordings import real
from scipy.signal import bessel, butter, ellip, filtfilt, firwin, sosfilt, sosfiltfilt

from benchmarks.synthetic_recordings.rhythms import RHYTHMS, Synthesis, synthetic_recording
from fascicle.core.parameters import EXAMPLE_PARAMETERS
from fascicle.recording.detection import r_peaks
from fascicle.recording.filter_estimate import estimated_lowpass
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording

DIGIT = 1e-3  # mV


def steep(cutoff, rate):
    """Steep low-passes, run once or forward and backward."""
    twice = butter(10, cutoff, fs=rate, output="sos")
    elliptic = ellip(6, 0.5, 60, cutoff, fs=rate, output="sos")
    taps = firwin(round(0.2 * rate) | 1, cutoff, fs=rate)
    return {
        "Butterworth": lambda signal: sosfiltfilt(twice, signal),
        "elliptic": lambda signal: sosfilt(elliptic, signal),
        "FIR": lambda signal: filtfilt(taps, [1.0], signal, padlen=round(0.5 * rate)),
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
    """Cut-off (Hz) that is found after the signal has been stored in digits."""
    found = estimated_lowpass(np.round(signal / DIGIT) * DIGIT, rate, peaks)
    return None if found is None else found.frequency


@pytest.mark.parametrize("cutoff", [40.0, 100.0])
def test_steep_filters_on_real_recordings_are_found(data_folder, cutoff):
    for name, recording in real(data_folder).items():
        rate = round(recording.sampling_rate)
        signal = np.nan_to_num(recording.signal)
        peaks = r_peaks(recording.signal, rate)
        found = {
            shape: (estimate(apply(signal), rate, peaks), cut_off(apply, rate))
            for shape, apply in steep(cutoff, rate).items()
        }
        # one may be missed, and none may be wrong
        assert sum(value is not None for value, _ in found.values()) >= 2, (name, found)
        for shape, (value, truth) in found.items():
            assert value is None or value == pytest.approx(truth, abs=6.0), (name, shape)


def test_nothing_is_found_where_no_filter_was(data_folder):
    for name, recording in real(data_folder).items():
        peaks = r_peaks(recording.signal, recording.sampling_rate)
        assert estimated_lowpass(recording.signal, recording.sampling_rate, peaks) is None, name


@pytest.mark.parametrize("cutoff", [40.0, 100.0])
def test_gentle_filters_are_not_guessed(data_folder, cutoff):
    for name, recording in real(data_folder).items():
        rate = round(recording.sampling_rate)
        signal, peaks = np.nan_to_num(recording.signal), r_peaks(recording.signal, rate)
        for shape, apply in gentle(cutoff, rate).items():
            assert estimate(apply(signal), rate, peaks) is None, (name, shape)


@pytest.mark.parametrize("noise_db", [10.0, 30.0, 60.0, None])
@pytest.mark.parametrize("rhythm", RHYTHMS)
def test_nothing_is_found_in_synthetic_recordings(rhythm, noise_db):
    """Their QRS are sums of Gaussians, whose spectra fall faster and faster."""
    for seed, rate in ((0, 500), (1, 1000)):
        options = Synthesis(rhythm=rhythm, rate=rate, noise_db=noise_db)
        recording, truth = synthetic_recording(np.random.default_rng(seed), options)
        peaks = np.round(truth.r_times * rate).astype(int)
        assert estimate(recording.signal, rate, peaks) is None


@pytest.fixture(scope="module")
def simulated(default_model):
    """Ten beats of a simulated QRS, each 0.8 s, with noise of 3 uV, and their R peaks."""
    leads = default_model.simulate(EXAMPLE_PARAMETERS).leads
    beat = np.pad(leads, ((0, 0), (300, 500 - leads.shape[1])))
    signal = np.tile(beat, 10)
    signal = signal + 3e-3 * np.random.default_rng(0).standard_normal(signal.shape)
    peak = int(np.argmax((beat**2).sum(axis=0)))
    return Recording(signal, 1000.0, "simulated"), peak + 800 * np.arange(10)


@pytest.mark.parametrize("cutoff", [40.0, 100.0])
def test_filters_on_simulated_recordings_are_found(simulated, cutoff):
    recording, peaks = simulated
    assert estimate(recording.signal, 1000, peaks) is None
    for shape, apply in steep(cutoff, 1000).items():
        found = estimate(apply(recording.signal), 1000, peaks)
        assert found == pytest.approx(cut_off(apply, 1000), abs=5.0), shape


def test_one_averaged_beat_of_a_subject(data_folder):
    """Its spectrum falls by 40 dB from 35 to 43 Hz."""
    beat = read_recording(data_folder / "hearts" / "dti004" / "ecg_beat.csv", unit="uV")
    found = estimated_lowpass(beat.signal, 1000.0, np.array([142]))
    assert found is not None
    assert found.frequency == pytest.approx(35.0, abs=1.0)
    assert found.shape == pytest.approx(20.0, abs=4.0)


def test_too_little_says_nothing():
    assert estimated_lowpass(np.zeros((12, 200)), 1000.0, np.array([100])) is None
    assert estimated_lowpass(np.zeros((12, 2000)), 1000.0, np.array([1000])) is None
    assert estimated_lowpass(np.zeros((12, 2000)), 1000.0, np.array([], dtype=int)) is None
