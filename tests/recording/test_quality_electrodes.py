"""Exchanged electrodes are suspected, hearts as they are are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from quality_recordings import REAL, beating, real, warned

from fascicle.recording.detection import r_peaks
from fascicle.recording.quality.check_result import CheckResult
from fascicle.recording.quality.electrodes import check_limb_electrodes, median_beat
from fascicle.recording.recording import Recording

# What the six limb leads become when two electrodes are exchanged.
RA_LA = ([0, 2, 1, 4, 3, 5], [-1, 1, 1, 1, 1, 1])
RA_LL = ([2, 1, 0, 5, 4, 3], [-1, -1, -1, 1, 1, 1])


@pytest.fixture(scope="module")
def patients(data_folder: Path) -> dict[str, Recording]:
    return real(data_folder)


def limb(recording: Recording, exchange: tuple[list[int], list[int]] | None = None) -> CheckResult:
    peaks = r_peaks(recording.signal, recording.sampling_rate)
    signal = recording.signal.copy()
    if exchange is not None:
        order, sign = exchange
        signal[:6] = np.array(sign)[:, None] * signal[order]
    changed = replace(recording, signal=signal)
    (finding,) = check_limb_electrodes(changed, median_beat(changed, peaks))
    return finding


def test_made_heart() -> None:
    made = beating()
    assert limb(made).value > 0.8
    assert limb(made, RA_LA).message.endswith("to undo it: --swap RA-LA")
    assert limb(made, RA_LL).message.endswith("to undo it: --swap RA-LL")


@pytest.mark.parametrize("name", REAL)
def test_real_hearts(patients: dict[str, Recording], name: str) -> None:
    assert limb(patients[name]).value > 0.3
    assert warned([limb(patients[name])]) == []


@pytest.mark.parametrize("name", REAL)
def test_real_hearts_with_exchanged_right_arm(patients: dict[str, Recording], name: str) -> None:
    arms = limb(patients[name], RA_LA)
    assert arms.value <= -0.4
    assert arms.message.endswith("--swap RA-LA")
    assert "the heart lies on the right" in arms.message
    assert limb(patients[name], RA_LL).message.endswith("--swap RA-LL")


def test_an_axis_to_the_right_is_no_exchange() -> None:
    # lead I is negative in the QRS, but not in the P wave
    made = beating()
    peaks = r_peaks(made.signal, made.sampling_rate)
    median = median_beat(made, peaks)
    qrs = slice(round((0.26 - 0.06) * 500), round((0.26 + 0.08) * 500))
    turned = median.copy()
    turned[0, qrs] = 2 * median[0, qrs.start] - median[0, qrs]
    (finding,) = check_limb_electrodes(made, turned)
    assert -0.2 < finding.value < 0.2
    assert warned([finding]) == []


def test_absent_leads() -> None:
    made = beating()
    signal = made.signal.copy()
    signal[11] = np.nan
    without_v6 = replace(made, signal=signal)
    median = median_beat(without_v6, r_peaks(made.signal, made.sampling_rate))
    (finding,) = check_limb_electrodes(without_v6, median)
    assert finding.value > 0.8  # V5 serves
