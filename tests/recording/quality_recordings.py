"""Recordings of which the beats, or the faults, are known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.synthetic_recordings.rhythms import Synthesis, Truth, synthetic_recording
from fascicle.core.leads import LEADS, lead_matrix
from fascicle.recording.pipeline import Analysis, analyse
from fascicle.recording.quality import CheckResult, Severity
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Recording

RATE = 500.0  # Hz
REAL = {
    "LBBB": "ludb/24_common.hea",
    "RBBB": "ludb/23_common.hea",
    "normal": "ludb/119_common.hea",
    "infarct": "ptb-s0010/s0010_re.hea",
    "DICOM": "dicom/waveform_ecg.dcm",
    "aECG": "aecg/Example_aECG.xml",
}
# Potential (mV) of the electrodes at the top of each wave: it moves to the left, then back.
_P = (-0.08, 0.03, 0.08, 0.02, 0.03, 0.04, 0.04, 0.05, 0.05)
_Q = (0.05, 0.0, -0.05, 0.2, 0.25, 0.1, 0.0, -0.1, -0.1)
_R = (-0.5, 0.35, 0.95, -0.6, -0.4, 0.4, 1.2, 1.3, 1.1)
_S = (-0.05, 0.0, 0.0, -0.5, -0.9, -0.6, -0.3, -0.1, 0.0)
_T = (-0.15, 0.1, 0.2, -0.05, 0.2, 0.3, 0.3, 0.25, 0.2)
_WAVES = (
    (_P, -0.16, 0.02),
    (_Q, -0.025, 0.008),
    (_R, 0.0, 0.01),
    (_S, 0.025, 0.01),
    (_T, 0.28, 0.05),
)


def beating(
    times: NDArray[np.float64] | None = None, seconds: float = 10.0, noise: float = 0.005
) -> Recording:
    """Sinus rhythm with R at some times (s), and independent noise (mV) at each electrode."""
    if times is None:
        times = np.arange(0.6, seconds - 0.5, 0.83)
    t = np.arange(round(seconds * RATE)) / RATE
    electrodes = noise * np.random.default_rng(0).standard_normal((9, len(t)))
    for potential, delay, width in _WAVES:
        pulses = np.exp(-0.5 * ((t - times[:, None] - delay) / width) ** 2).sum(axis=0)
        electrodes += np.array(potential)[:, None] * pulses
    return Recording(lead_matrix() @ electrodes, RATE, "made")


def with_lead(recording: Recording, lead: str, values: NDArray[np.float64]) -> Recording:
    """The same with one lead replaced (mV)."""
    signal = recording.signal.copy()
    signal[LEADS.index(lead)] = values
    return replace(recording, signal=signal)


def row(recording: Recording, lead: str) -> NDArray[np.float64]:
    """One lead (mV)."""
    return recording.signal[LEADS.index(lead)]


@cache
def real(data_folder: Path) -> dict[str, Recording]:
    """Recordings of patients without a known fault."""
    return {name: read_recording(data_folder / "ecg" / file) for name, file in REAL.items()}


@cache
def analysed(data_folder: Path) -> dict[str, Analysis]:
    """Their analyses, which several modules look at."""
    return {name: analyse(recording) for name, recording in real(data_folder).items()}


def fatal(findings: list[CheckResult] | tuple[CheckResult, ...]) -> list[str]:
    """Messages of what is refused."""
    return [finding.message for finding in findings if finding.severity is Severity.FATAL]


def warned(findings: list[CheckResult] | tuple[CheckResult, ...]) -> list[str]:
    """Messages of what is suspicious."""
    return [finding.message for finding in findings if finding.severity is Severity.WARNING]


def synthetic(seed: int | list[int], **options: Any) -> tuple[Recording, Truth]:
    """A synthetic recording (`Synthesis` tells the options), and what it was made of."""
    return synthetic_recording(np.random.default_rng(seed), Synthesis(**options))


def on_paper(recording: Recording, rhythm_strip: str | None = None) -> Recording:
    """The recording as on paper: four groups in turn, perhaps one lead all along."""
    n = recording.signal.shape[1]
    signal = np.full_like(recording.signal, np.nan)
    for k in range(4):
        group, part = slice(3 * k, 3 * k + 3), slice(k * n // 4, (k + 1) * n // 4)
        signal[group, part] = recording.signal[group, part]
    if rhythm_strip is not None:
        signal[LEADS.index(rhythm_strip)] = row(recording, rhythm_strip)
    return replace(recording, signal=signal)
