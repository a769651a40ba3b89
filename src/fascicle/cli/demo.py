"""The whole job on the packaged heart and a real recording, small enough for two minutes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import fascicle
from fascicle import FittedStudy, His, Predicted
from fascicle.core.progress import Progress
from fascicle.recording.pipeline import Analysis
from fascicle.recording.target_files import write_target
from fascicle.reporting.page.page import PACINGS, write_report
from fascicle.reporting.prediction import write_prediction
from fascicle.reporting.recording import recording_figure
from fascicle.reporting.style import save

# The paper's method with a fraction of its budget: every stage works, the numbers are not to be
# trusted.
SETTINGS: dict[str, Any] = {
    "method": "paper", "initial": 60, "steps": 60, "samples": 10, "draws": 500_000, "rounds": 4,
}  # fmt: skip
BLOCK = "left-bundle-branch-block"  # what the pacing of the demonstration treats


def demo_recording() -> Path:
    """The 10 s, 1000 Hz, 12-lead DICOM ECG that comes inside the pydicom package."""
    from pydicom.data import get_testdata_file

    return Path(str(get_testdata_file("waveform_ecg.dcm", download=False)))


def run_demo(
    out: Path, progress: Progress, *, free_gain: bool
) -> tuple[Analysis, FittedStudy, dict[str, Predicted]]:
    """Make the target, fit, draw the figures, compare three pacings for a left bundle branch block.

    The folder `out` gets ``target.nc`` and ``target.png``, ``study``, ``pacings`` and
    ``report.html``; run again, the study resumes. With `free_gain` simulations are scaled: the
    heart and torso are not the patient's.
    """
    analysis = fascicle.analyse(fascicle.read_recording(demo_recording()))
    write_target(analysis.target, out / "target.nc")
    save(recording_figure(analysis), out / "target.png")
    settings = SETTINGS | {"free_gain": free_gain}
    fitted = fascicle.fit("default", analysis.target, out / "study", progress=progress, **settings)
    networks = fitted.networks(progress)
    # His bundle pacing captures both branches below the block; the other pacings do not.
    scenarios = fascicle.read_scenarios([BLOCK, *PACINGS])
    for name, scenario in scenarios.items():
        if name != "his-pacing":
            scenarios[name] = scenario.mapped(
                lambda p: replace(p, left=0.0) if isinstance(p, His) else p
            )
    predicted = fascicle.predict(fitted, scenarios, progress, networks)
    write_prediction(fitted, predicted, out / "pacings", progress=progress)
    write_report(fitted, networks, predicted, out / "report.html", ["png"], BLOCK)
    return analysis, fitted, predicted
