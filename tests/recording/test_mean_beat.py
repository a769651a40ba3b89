"""Chest cables exchanged or inverted and T waves alone are found; nothing is in good recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from quality_recordings import RATE, REAL, beating

from fascicle.core.arrays import Floats
from fascicle.core.leads import CHEST_LEADS
from fascicle.recording.detection import r_peaks
from fascicle.recording.pipeline import analyse, make_target
from fascicle.recording.quality import (
    CHEST,
    FASTEST_QRS,
    CheckResult,
    Severity,
    check_chest_leads,
    check_mean_beat,
)
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording


def checks(recording: Recording) -> list[CheckResult]:
    """Both checks of the mean beat."""
    return [one for one in analyse(recording).findings if one.check in (FASTEST_QRS, CHEST)]


@pytest.fixture(scope="module")
def good() -> Recording:
    return beating()


@pytest.fixture(scope="module")
def qrs(good: Recording) -> Floats:
    return analyse(good).target.qrs


@pytest.mark.parametrize("name", [*REAL, "Philips"])
def test_nothing_against_real_recordings(data_folder: Path, name: str) -> None:
    file = REAL.get(name, "philips/129DYPRG.XML")
    speed, chest = checks(read_recording(data_folder / "ecg" / file))
    assert speed.severity is chest.severity is Severity.FINE
    assert speed.value > 2 * FASTEST_QRS.limit
    assert chest.value < 0.8 * CHEST.limit


def test_exchanged_and_inverted_chest_leads(qrs: Floats) -> None:
    assert check_chest_leads(qrs).severity is Severity.FINE
    for k, lead in enumerate(CHEST_LEADS):
        wrong = qrs.copy()
        wrong[6 + k] *= -1
        assert check_chest_leads(wrong).message.endswith(f"to undo it: --invert {lead}")
        assert check_chest_leads(3 * wrong).value == pytest.approx(check_chest_leads(wrong).value)
    for k in range(3):
        wrong = qrs.copy()
        wrong[[6 + k, 7 + k]] = qrs[[7 + k, 6 + k]]
        assert check_chest_leads(wrong).message.endswith(f"--swap V{k + 1}-V{k + 2}")


def test_the_remedy_removes_the_warning_of_a_patient(data_folder: Path) -> None:
    """As recorded there is none: see the test of all real recordings."""
    file = data_folder / "ecg" / REAL["infarct"]
    recording = read_recording(file)
    for fault, remedy in (
        ({"swap": ["V1-V2"]}, "--swap V1-V2"),
        ({"invert": ["V3"]}, "--invert V3"),
    ):
        (warning,) = make_target(read_recording(file, **fault)).warnings
        assert warning.endswith(f"to undo it: {remedy}")
        undone = read_recording(file, **{name: 2 * twice for name, twice in fault.items()})
        assert (undone.signal == recording.signal).all()


def test_limb_leads_and_absent_leads_raise_no_alarm(qrs: Floats) -> None:
    changed = qrs.copy()
    changed[:6] *= -1
    assert check_chest_leads(changed).value == check_chest_leads(qrs).value
    changed[8] = np.nan
    assert check_chest_leads(changed).severity is Severity.FINE
    assert np.isnan(check_chest_leads(changed).value)


def test_t_waves_alone(good: Recording, qrs: Floats) -> None:
    signal = good.signal.copy()
    for peak in r_peaks(signal, RATE):
        beat = slice(peak - 150, peak + 40)  # P wave and QRS
        signal[:, beat] = np.linspace(signal[:, beat.start], signal[:, beat.stop], 190, axis=1)
    speed, chest = checks(replace(good, signal=signal))
    assert speed.value < 0.5 * FASTEST_QRS.limit
    assert "a T or P wave was probably taken for the beat" in speed.message
    assert chest.message == "not checked: no QRS"
    slow = np.repeat(qrs, 3, axis=1)  # as slow as the slowest QRS
    assert check_mean_beat(slow)[0].severity is Severity.FINE
