"""Flat, copied, clipped, coarse, noisy, humming and wandering leads; rate, length, filters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from quality_recordings import beating, fatal, row, warned, with_lead

from fascicle.recording.filters import Filter, FilterKind, FilterOrigin
from fascicle.recording.quality.acquisition import (
    check_clipping,
    check_extent_in_time,
    check_filters,
    check_resolution,
)
from fascicle.recording.quality.check_result import Severity
from fascicle.recording.quality.disturbances import (
    check_duplicates,
    check_flatness,
    check_mains,
    check_noise,
    check_wander,
)
from fascicle.recording.recording import Filters, Recording

PEAKS = np.array([500, 1500])  # looked about only for a low-pass that the user states


@pytest.fixture(scope="module")
def good() -> Recording:
    return beating()


@pytest.fixture(scope="module")
def time(good: Recording) -> np.ndarray:
    return np.arange(good.signal.shape[1]) / good.sampling_rate


def test_flat_lead(good: Recording) -> None:
    assert check_flatness(good)[0].value == pytest.approx(1e3 * good.signal.std(axis=1).min())
    flat = with_lead(good, "V2", np.full(good.signal.shape[1], 0.3))
    (message,) = fatal(check_flatness(flat))
    assert message == (
        "no signal in lead V2; go on without: --leads I,II,III,aVR,aVL,aVF,V1,V3,V4,V5,V6"
    )


def test_lead_that_falls_off(good: Recording) -> None:
    values = row(good, "V2").copy()
    values[1000:2501] = values[1000]
    (message,) = warned(check_flatness(with_lead(good, "V2", values)))
    assert message.startswith("no signal in lead V2 for up to 3.0 s")
    signal = good.signal.copy()
    signal[:, 3000:] = 0
    assert (
        "no signal in any lead for up to 4.0 s"
        in fatal(check_flatness(replace(good, signal=signal)))[0]
    )


@pytest.mark.parametrize(("sign", "words"), [(1, "the same;"), (-1, "the same but for the sign;")])
def test_copied_lead(good: Recording, sign: int, words: str) -> None:
    assert fatal(check_duplicates(good)) == []
    copied = with_lead(good, "V5", sign * row(good, "V1") + 0.2)
    (message,) = fatal(check_duplicates(copied))
    assert message.startswith(f"leads V1 and V5 are {words}")
    noisy = row(good, "V1") + 0.02 * np.random.default_rng(0).standard_normal(len(row(good, "V1")))
    assert fatal(check_duplicates(with_lead(good, "V5", noisy))) == []


def test_limb_leads_that_are_the_same_by_law(good: Recording) -> None:
    signal = good.signal.copy()
    signal[0] = 0
    signal[2], signal[3], signal[4], signal[5] = signal[1], -signal[1], -signal[1] / 2, signal[1]
    assert fatal(check_duplicates(replace(good, signal=signal))) == []


def test_clipped_peaks(good: Recording) -> None:
    assert check_clipping(good)[0].value == 0
    values = row(good, "V4")
    cut = np.minimum(values, 0.8 * values.max())
    (finding,) = check_clipping(with_lead(good, "V4", cut))
    assert finding.value == pytest.approx(np.mean(cut == cut.max()), rel=0.2)
    assert finding.message.startswith("peaks of lead V4 are cut off")


def test_rounded_tops_of_coarse_digits_are_not_clipped(good: Recording) -> None:
    smooth = beating(noise=0.0)
    coarse = replace(good, signal=0.01 * np.round(smooth.signal / 0.01))
    assert check_clipping(coarse)[0].value == 0


def test_coarse_digits(good: Recording) -> None:
    for step, severity in ((0.005, Severity.FINE), (0.04, Severity.WARNING)):
        rounded = step * np.round(good.signal / step)
        (finding,) = check_resolution(replace(good, signal=rounded))
        assert finding.value == pytest.approx(1e3 * step)
        assert finding.severity is severity


def test_noise_is_measured_between_the_beats() -> None:
    clean = beating(noise=0.0)
    assert check_noise(clean)[0].value < 1.0
    white = np.random.default_rng(0).standard_normal(clean.signal.shape[1])
    for size in (0.02, 0.1, 0.5):
        (finding,) = check_noise(with_lead(clean, "V3", row(clean, "V3") + size * white))
        # a moving average of 6 samples leaves 5/6 of the variance
        assert finding.value == pytest.approx(1e3 * size * np.sqrt(5 / 6), rel=0.1)
        expected = {0.02: Severity.FINE, 0.1: Severity.WARNING, 0.5: Severity.FATAL}[size]
        assert finding.severity is expected
        assert ("lead V3" in finding.message) == (size > 0.02)


@pytest.mark.parametrize("frequency", [50.0, 49.8, 60.0])
def test_hum(good: Recording, time: np.ndarray, frequency: float) -> None:
    assert check_mains(good)[0].value < 5
    hum = 0.06 * np.sin(2 * np.pi * frequency * time) + 0.02 * np.sin(4 * np.pi * frequency * time)
    (finding,) = check_mains(with_lead(good, "aVL", row(good, "aVL") + hum))
    assert finding.value == pytest.approx(1e3 * np.hypot(0.06, 0.02), rel=0.05)
    assert f"hum at {round(frequency, -1):g} Hz in lead aVL" in finding.message


def test_wander(good: Recording, time: np.ndarray) -> None:
    assert check_wander(good)[0].value < 0.15
    slow = 0.6 * np.sin(2 * np.pi * 0.2 * time)
    (finding,) = check_wander(with_lead(good, "V1", row(good, "V1") + slow))
    assert finding.value == pytest.approx(1.2, rel=0.1)
    assert "baseline of lead V1 wanders" in finding.message


def test_rate_and_length() -> None:
    short = Recording(np.random.default_rng(0).standard_normal((12, 900)), 300.0, "made")
    rate, duration = check_extent_in_time(short, 3)
    assert (rate.value, duration.value) == (300.0, 3.0)
    assert len(warned([rate, duration])) == 2
    assert warned(check_extent_in_time(beating(), 9)) == []


def test_a_single_beat_is_not_too_short() -> None:
    beat = Recording(np.random.default_rng(0).standard_normal((12, 700)), 1000.0, "made")
    _, duration = check_extent_in_time(beat, 1)
    assert np.isnan(duration.value)
    assert warned([duration]) == []


def test_filters_of_the_recorder(good: Recording) -> None:
    assert np.isnan([finding.value for finding in check_filters(good, PEAKS, ())]).all()
    fine = replace(good, filters=Filters(highpass=0.05, notch=50.0))
    passed = (Filter(FilterKind.LOW_PASS, 150.0, FilterOrigin.FILE, 2.0),)
    assert warned(check_filters(fine, PEAKS, passed)) == []
    assert (
        check_filters(fine, PEAKS, passed)[2].message
        == "note: the recorder's mains filter at 50 Hz was on"
    )
    bad = replace(good, filters=Filters(highpass=1.0))
    estimated = (Filter(FilterKind.LOW_PASS, 40.0, FilterOrigin.ESTIMATED, 10.0),)
    low, high = warned(check_filters(bad, PEAKS, estimated))
    assert "low-pass at 40 Hz, estimated from the spectrum, strongly smooths the QRS" in low
    assert "high-pass at 1 Hz bends the QRS" in high
    own = (Filter(FilterKind.LOW_PASS, 40.0, FilterOrigin.APPLIED, 2.0, 1000.0),)
    assert warned(check_filters(good, PEAKS, own)) == []
