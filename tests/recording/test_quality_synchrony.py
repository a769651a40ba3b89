"""Leads of two recordings in one file are found, odd leads of one are not."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from quality_recordings import REAL, beating, fatal, real, row, warned, with_lead
from scipy.signal import resample_poly

from fascicle.core.leads import LEADS
from fascicle.recording.quality.check_result import CheckResult
from fascicle.recording.quality.synchrony import check_synchrony
from fascicle.recording.recording import Recording


@pytest.fixture(scope="module")
def patients(data_folder: Path) -> dict[str, Recording]:
    return {name: at_500_hz(recording) for name, recording in real(data_folder).items()}


def check(recording: Recording) -> list[CheckResult]:
    return check_synchrony(recording)


def irregular(seed: int, mean: float = 0.8, spread: float = 0.03) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    times = np.cumsum(mean + spread * rng.standard_normal(30))
    return times[times < 9.5]


def joined(limb: Recording, chest: Recording) -> Recording:
    n = min(limb.signal.shape[1], chest.signal.shape[1])
    return replace(limb, signal=np.vstack([limb.signal[:6, :n], chest.signal[6:, :n]]))


def at_500_hz(recording: Recording) -> Recording:
    factor = round(recording.sampling_rate / 500)
    signal = resample_poly(recording.signal, 1, factor, axis=1, padtype="line")
    return replace(recording, signal=signal, sampling_rate=500.0)


def test_one_heart() -> None:
    for times in (irregular(0), irregular(1, 0.7, 0.2)):
        agreement, jitter = check(beating(times))
        assert fatal([agreement, jitter]) == []
        assert agreement.value > 0.85
        assert jitter.value == pytest.approx(0.0, abs=4.0)


def test_chest_leads_of_another_heart() -> None:
    two = joined(beating(irregular(0)), beating(irregular(1, 0.95)))
    (message,) = fatal(check(two))
    rates = 60 / np.median(np.diff(irregular(1, 0.95))), 60 / np.median(np.diff(irregular(0)))
    assert f"leads V1 to V6 are not those of leads I to aVF ({rates[0]:.0f} against" in message
    assert f"against {rates[1]:.0f} per minute): two recordings in one file?" in message


def test_hearts_that_beat_nearly_together() -> None:
    times = irregular(0)
    late = times + 0.06 * np.random.default_rng(2).uniform(-1, 1, len(times))
    agreement, jitter = check(joined(beating(times), beating(late)))
    assert agreement.value > 0.75
    assert jitter.value > 12.0
    assert "do not beat in step" in jitter.message


@pytest.mark.parametrize("lead", ["aVR", "V2", "V6"])
def test_single_lead_of_another_heart(lead: str) -> None:
    other = row(beating(irregular(3, 0.95)), lead)
    (message,) = fatal(check(with_lead(beating(irregular(0)), lead, other)))
    kept = ",".join(name for name in LEADS if name != lead)
    assert message.startswith(f"the beats of lead {lead} are not those of leads")
    assert message.endswith(f"--leads {kept}")


@pytest.mark.parametrize("lead", ["I", "V3"])
def test_noisy_low_and_disturbed_leads_are_no_other_heart(lead: str) -> None:
    good, rng = beating(irregular(0)), np.random.default_rng(4)
    n = good.signal.shape[1]
    bursts = np.sin(np.arange(n) / 200) ** 8 * rng.standard_normal(n)
    for values in (
        row(good, lead) + 0.5 * rng.standard_normal(n),
        0.02 * row(good, lead) + 0.03 * rng.standard_normal(n),
        row(good, lead) + bursts,
        rng.standard_normal(n),
    ):
        assert fatal(check(with_lead(good, lead, values))) == []


def test_lead_that_shows_the_t_wave_only() -> None:
    good = beating(irregular(0))
    t_wave = np.roll(row(good, "V2"), 140)  # 280 ms
    found = check(with_lead(good, "V2", t_wave))
    assert fatal(found) + warned(found) == []


def test_absent_leads_and_lead_groups() -> None:
    good = beating(irregular(0))
    signal, quarter = good.signal.copy(), good.signal.shape[1] // 4
    for group in range(4):
        rows = slice(3 * group, 3 * group + 3)
        signal[rows, : group * quarter] = np.nan
        signal[rows, (group + 1) * quarter :] = np.nan
    assert fatal(check(replace(good, signal=signal))) == []
    signal = good.signal.copy()
    signal[6:] = np.nan
    agreement, jitter = check(replace(good, signal=signal))
    assert agreement.value > 0.85
    assert np.isnan(jitter.value)


def test_real_hearts_are_one(patients: dict[str, Recording]) -> None:
    for recording in patients.values():
        agreement, jitter = check(recording)
        assert agreement.value > 0.85
        assert jitter.value <= 4.0
        assert fatal([agreement, jitter]) == []


@pytest.mark.parametrize(("limb", "chest"), list(permutations(REAL, 2)))
def test_real_hearts_joined(patients: dict[str, Recording], limb: str, chest: str) -> None:
    messages = fatal(check(joined(patients[limb], patients[chest])))
    assert len(messages) == 1
    assert "Give leads of one recording" in messages[0]
    assert "V1 to V6" in messages[0] or "limb and chest" in messages[0]
