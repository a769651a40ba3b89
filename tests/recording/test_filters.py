"""Gains of filters, and which of them a target has passed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from quality_recordings import beating
from scipy.signal import butter, sosfiltfilt

from fascicle.cli.demo import demo_recording
from fascicle.core.errors import InputError
from fascicle.recording.detection import r_peaks
from fascicle.recording.filters import (
    Filter,
    FilterKind,
    FilterOrigin,
    applied_filters,
    combined_gain,
)
from fascicle.recording.passed_filters import passed_filters
from fascicle.recording.pipeline import analyse
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Filters
from fascicle.recording.resampling import filtered
from fascicle.recording.target_options import TargetOptions
from fascicle.study.recordings import target_digest

RECORDER = FilterOrigin.FILE


@pytest.mark.parametrize(("lowpass", "mains"), [(40.0, None), (150.0, None), (None, 50.0)])
def test_gain_is_what_the_applied_filter_does(lowpass, mains):
    """Spectrum of what is left of an impulse."""
    impulse = np.zeros((1, 4000))
    impulse[0, 2000] = 1.0
    spectrum = np.abs(np.fft.rfft(filtered(impulse, lowpass, mains)[0]))
    frequency = np.fft.rfftfreq(4000, 1e-3)
    gain = combined_gain(applied_filters(lowpass, mains, 1000.0), frequency)
    # the notch rings for longer than the signal lasts on either side
    np.testing.assert_allclose(gain, spectrum, atol=1e-9 if mains is None else 1e-4)
    if lowpass is not None:
        assert np.interp(lowpass, frequency, gain) == pytest.approx(0.5)


@pytest.mark.parametrize("order", [1.0, 2.0, 6.5, 20.0])
def test_low_pass_is_3_db_down_at_its_cut_off_and_falls_by_its_order(order):
    lowpass = Filter(FilterKind.LOW_PASS, 40.0, RECORDER, order)
    zero, cutoff, far, farther = lowpass.gain(np.array([0.0, 40.0, 400.0, 800.0]))
    assert zero == 1.0
    assert cutoff == pytest.approx(0.5**0.5)
    assert far / farther == pytest.approx(2**order, rel=0.01)


def test_notch_takes_its_middle_away_and_little_else():
    notch = Filter(FilterKind.NOTCH, 50.0, RECORDER, 30.0)
    width = 50.0 / 30.0
    gain = notch.gain(np.array([0.0, 50.0, 50.0 + width / 2, 40.0, 100.0]))
    np.testing.assert_allclose(gain, [1.0, 0.0, 0.5**0.5, 1.0, 1.0], atol=0.01)


def test_gains_of_several_multiply():
    one = Filter(FilterKind.LOW_PASS, 40.0, RECORDER, 2.0)
    other = Filter(FilterKind.LOW_PASS, 100.0, RECORDER, 4.0)
    frequency = np.linspace(0, 200, 21)
    product = one.gain(frequency) * other.gain(frequency)
    np.testing.assert_array_equal(combined_gain((one, other), frequency), product)
    assert (combined_gain((), frequency) == 1.0).all()


@pytest.mark.parametrize(
    ("frequency", "shape", "rate"),
    [(0.0, 2.0, None), (np.nan, 2.0, None), (40.0, -1.0, None), (40.0, np.inf, None),
     (600.0, 2.0, 1000.0), (40.0, 2.5, 1000.0), (40.0, 1e9, 1000.0), (40.0, 2.0, np.nan)],
)  # fmt: skip
def test_filters_that_cannot_be(frequency, shape, rate):
    with pytest.raises(ValueError, match=r"\d|nan|inf"):
        Filter(FilterKind.LOW_PASS, frequency, RECORDER, shape, rate)


def passed(recording, **choices):
    peaks = r_peaks(recording.signal, recording.sampling_rate)
    filters = passed_filters(recording, peaks, TargetOptions(**choices))
    return [(one.kind.value, one.frequency, one.origin) for one in filters]


def test_the_file_counts_before_the_user():
    recording = beating()
    assert passed(recording) == []
    assert passed(recording, recorder_lowpass=100.0) == [("low-pass", 100.0, FilterOrigin.STATED)]
    named = replace(recording, filters=Filters(lowpass=150.0, notch=60.0, highpass=0.05))
    by_file = [("low-pass", 150.0, FilterOrigin.FILE), ("notch", 60.0, FilterOrigin.FILE)]
    assert passed(named) == by_file
    assert passed(named, recorder_lowpass=150.0) == by_file
    with pytest.raises(InputError, match=r"150 Hz in the file, not 40 Hz; leave --recorder-low"):
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
    assert stated.response is not None
    assert stated.response(np.array([0.05]))[0] == pytest.approx(0.5**0.5)  # cycles per sample
    assert "low-pass 50 Hz" in stated.provenance["filters"]
    assert target_digest(stated) != target_digest(plain)
    other = replace(stated, filters=(replace(stated.filters[0], origin=FilterOrigin.ESTIMATED),))
    assert target_digest(other) == target_digest(stated)


def test_a_stated_lowpass_is_set_against_the_spectrum():
    whole = replace(read_recording(demo_recording()), filters=Filters())
    rate = whole.sampling_rate
    steep = butter(10, 40.0, fs=rate, output="sos")
    smoothed = replace(whole, signal=sosfiltfilt(steep, np.nan_to_num(whole.signal)))

    def said(recording, **choices):
        return analyse(recording, TargetOptions(**choices)).target.provenance["warnings"]

    assert "the spectrum shows a low-pass at 3" in said(smoothed, recorder_lowpass=60.0)
    assert "the spectrum shows" not in said(smoothed)
    assert "the spectrum shows" not in said(whole, recorder_lowpass=60.0)
