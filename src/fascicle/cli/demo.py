"""Demonstration on one heart: a fit to its intrinsic beat, and a simulated block as the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import fascicle
from fascicle import Beat, FittedStudy, Predicted
from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.progress import Progress
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation_files import write_ecg
from fascicle.prediction.scenarios import INTRINSIC
from fascicle.recording.pipeline import Analysis
from fascicle.recording.target_files import write_target
from fascicle.reporting.page.page import PACINGS, write_report
from fascicle.reporting.prediction import write_prediction
from fascicle.reporting.recording import recording_figure
from fascicle.reporting.style import save

NETWORKS = 100  # in a population; a third of the default, to take a third of the time


def fit_own_beat(heart: str, out: Path, progress: Progress) -> FittedStudy:
    """Fit the beat that was recorded from the subject of a heart; `out` gets target and study.

    The subject is healthy: nothing is blocked. The study is read if it is finished.
    """
    analysis, fixed = _analysed(heart, out), {"conduction": 0.0}
    return fascicle.fit(
        heart, analysis.target, out / "study", parameters=fixed, effective=NETWORKS,
        progress=progress,
    )  # fmt: skip


def treat_block(
    heart: str, block: str, out: Path, progress: Progress
) -> tuple[FittedStudy, dict[str, Predicted], dict[str, float]]:
    """Simulate a block on a heart, fit, and compare three pacings.

    The folder `out` gets ``ecg.csv``, ``target.nc`` and ``target.png``, ``study``, ``pacings``
    without pictures, and ``report.html`` with them; run again, the study is read. The last of what
    is returned is by how much each pacing shortens the total activation time (ms) in truth.
    """
    model = fascicle.ForwardModel(heart, progress=progress)
    state = {"conduction": CONDUCTION_STATES[block].number}
    truth = fascicle.example_parameters(model) | state
    scenarios = fascicle.read_scenarios(PACINGS)
    beat, *paced = (_simulated(model, truth, case) for case in (None, *scenarios.values()))
    reductions = [
        beat.total_activation_time - simulation.total_activation_time for simulation in paced
    ]
    out.mkdir(parents=True, exist_ok=True)
    write_ecg(out / "ecg.csv", beat.ecg)
    analysis = _analysed(out / "ecg.csv", out)
    fitted = fascicle.fit(
        heart, analysis.target, out / "study", effective=NETWORKS, progress=progress
    )
    networks = fitted.networks(progress)
    predicted = fascicle.predict(fitted, scenarios, progress, networks)
    write_prediction(fitted, predicted, out / "pacings", None, progress)
    write_report(fitted, networks, predicted, out / "report.html", [], INTRINSIC, progress)
    return fitted, predicted, dict(zip(PACINGS, reductions, strict=True))


def _analysed(source: Path | str, out: Path) -> Analysis:
    """Analyse a recording of one beat; write and draw its target."""
    options = fascicle.TargetOptions(noise=0.03)  # mV
    analysis = fascicle.analyse(fascicle.read_recording(source), options)
    out.mkdir(parents=True, exist_ok=True)
    write_target(analysis.target, out / "target.nc")
    save(recording_figure(analysis), out / "target.png")
    return analysis


def _simulated(
    model: fascicle.ForwardModel, truth: Mapping[str, float], scenario: Scenario | None
) -> Beat:
    outcome = model.simulate(truth, scenario)
    assert isinstance(outcome, Beat)  # the example network fits the packaged heart
    return outcome
