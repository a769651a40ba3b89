"""All checks together, on recordings with and without a fault."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from quality_recordings import beating, fatal, real, warned

from fascicle.core.leads import LEADS
from fascicle.recording.detection import r_peaks
from fascicle.recording.quality.check import check_leads, check_recording


def every(recording):
    """All findings, with the R peaks that the detector gives."""
    peaks = r_peaks(recording.signal, recording.sampling_rate)
    return [*check_leads(recording), *check_recording(recording, peaks, ())]


def test_nothing_against_a_good_recording() -> None:
    findings = every(beating())
    assert fatal(findings) + warned(findings) == []
    assert len({finding.check for finding in findings}) == len(findings) == 20
    assert all("\n" not in finding.message for finding in findings)


def test_nothing_against_real_recordings(data_folder: Path) -> None:
    for recording in real(data_folder).values():
        findings = every(recording)
        assert fatal(findings) + warned(findings) == []


def test_any_lead_may_be_absent() -> None:
    made = beating()
    for row in range(len(LEADS)):
        signal = made.signal.copy()
        signal[row] = np.nan
        findings = every(replace(made, signal=signal))
        assert fatal(findings) + warned(findings) == []


def test_one_lead_alone() -> None:
    made = beating()
    signal = np.full_like(made.signal, np.nan)
    signal[7] = made.signal[7]
    findings = every(replace(made, signal=signal))
    assert fatal(findings) + warned(findings) == []
    assert sum(finding.message.startswith("not checked") for finding in findings) == 2


def test_the_most_basic_fault_comes_first() -> None:
    made = beating()
    signal = made.signal.copy()
    signal[8] = 0
    signal[1] *= -1
    flat, inverted = fatal(every(replace(made, signal=signal)))[:2]
    assert "no signal in lead V3" in flat
    assert "--invert II" in inverted
