"""The whole job on the packaged heart and an ECG that is simulated, so that the truth is known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import fascicle
from fascicle import FittedStudy, Predicted, Simulation
from fascicle.core.progress import Progress
from fascicle.core.quantities import CONDUCTION
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation_files import write_ecg
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.recording.pipeline import Analysis
from fascicle.recording.target_files import write_target
from fascicle.reporting.page.page import PACINGS, write_report
from fascicle.reporting.prediction import write_prediction
from fascicle.reporting.recording import recording_figure
from fascicle.reporting.style import save

BLOCK = "left bundle branch block"  # what the pacing of the demonstration treats


def run_demo(
    out: Path, progress: Progress
) -> tuple[Analysis, FittedStudy, dict[str, Predicted], dict[str, float]]:
    """Simulate a block, make the target of its ECG, fit, and compare three pacings.

    The folder `out` gets ``ecg.csv``, ``target.nc`` and ``target.png``, ``study``, ``pacings`` and
    ``report.html``; run again, the study resumes. The last of what is returned is by how much each
    pacing shortens the total activation time (ms) in truth.
    """
    model = fascicle.ForwardModel("default", progress=progress)
    truth = {**fascicle.example_parameters(model), "conduction": float(CONDUCTION.index(BLOCK))}
    scenarios = fascicle.read_scenarios(PACINGS)
    beat, *paced = (_simulated(model, truth, case) for case in (None, *scenarios.values()))
    reductions = [beat.total_activation_time - each.total_activation_time for each in paced]
    out.mkdir(parents=True, exist_ok=True)
    write_ecg(out / "ecg.csv", beat.ecg)
    recording = fascicle.read_recording(out / "ecg.csv")
    analysis = fascicle.analyse(recording, fascicle.TargetOptions(noise=0.03))  # mV
    write_target(analysis.target, out / "target.nc")
    save(recording_figure(analysis), out / "target.png")
    fitted = fascicle.fit("default", analysis.target, out / "study", progress=progress)
    networks = fitted.networks(progress)
    predicted = fascicle.predict(fitted, scenarios, progress, networks)
    write_prediction(fitted, predicted, out / "pacings", progress=progress)
    write_report(fitted, networks, predicted, out / "report.html", ["png"], INTRINSIC)
    return analysis, fitted, predicted, dict(zip(PACINGS, reductions, strict=True))


def _simulated(
    model: fascicle.ForwardModel, truth: Mapping[str, float], scenario: Scenario | None
) -> Simulation:
    found = model.simulate(truth, scenario)
    assert isinstance(found, Simulation)  # the example network fits the packaged heart
    return found
