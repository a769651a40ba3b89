"""A patient of a cohort: from the row of the table to a study with its report."""

from __future__ import annotations

import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fascicle.core.errors import FileError, InputError, one_line
from fascicle.core.files import write_text
from fascicle.core.progress import Progress
from fascicle.heart.folder import DEFAULT_HEART, MANIFEST
from fascicle.patients.outcome import Outcome, Status
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import existing_file, read_recording
from fascicle.recording.target_files import read_target
from fascicle.reporting.page.page import report
from fascicle.study.fit import Inputs, fit_inputs, read_inputs
from fascicle.study.lock import HeldError, study_lock
from fascicle.study.pool import Pool
from fascicle.study.settings import FitSettings, checked_settings
from fascicle.study.space import PARAMETERS, read_settings
from fascicle.study.study import is_finished

PATIENTS, STUDIES = "patients", "studies"  # folders of a cohort


@dataclass(frozen=True)
class Patient:
    """A row of the table, and the folder of its cohort."""

    name: str  # also of the study
    cohort: Path
    heart: Path | str  # folder, or "default"
    recording: Path  # target (.nc), or in any format of `fascicle.read_recording`
    scenario: Path | None = None  # in which it was recorded, if that was not the intrinsic beat
    settings_file: Path | None = None  # TOML file of settings and parameters
    settings: Mapping[str, Any] = field(default_factory=dict)  # override those of the file

    @property
    def study(self) -> Path:
        """Folder of the study."""
        return self.cohort / STUDIES / self.name

    @property
    def report(self) -> Path:
        """Report of the study."""
        return self.study / "report.html"

    @property
    def folder(self) -> Path:
        """Folder of the patient's outcome, which one process at a time writes."""
        return self.cohort / PATIENTS / self.name

    @property
    def outcome_file(self) -> Path:
        """File of the patient's outcome."""
        return self.folder / "outcome.json"

    @property
    def outcome(self) -> Outcome:
        """Stored outcome; `NOT_DONE` if there is none, or one of another version."""
        try:
            return Outcome.model_validate_json(self.outcome_file.read_text(encoding="utf-8"))
        except (FileNotFoundError, ValidationError):
            return Outcome(patient=self.name, status=Status.NOT_DONE)

    def ended(self, outcome: Outcome) -> Outcome:
        """Store the patient's outcome."""
        write_text(self.outcome_file, outcome.model_dump_json(indent=2) + "\n")
        return outcome

    def failed(self, reason: str, error_file: Path | None = None) -> Outcome:
        """Store the reason why the patient cannot be fitted."""
        return self.ended(
            Outcome(patient=self.name, status=Status.FAILED, reason=reason, error_file=error_file)
        )

    def bug(self, error: BaseException) -> Outcome:
        """Store an unexpected error, with its traceback."""
        path = self.folder / "error.txt"
        write_text(path, "".join(traceback.format_exception(error)))
        what = f"{type(error).__name__}: {one_line(error)}"
        return self.failed(f"bug: {what} (traceback in {path})", path)

    def given(self) -> tuple[FitSettings, Mapping[str, Any]]:
        """Settings, and the parameters to learn; the row overrides its settings file."""
        given = read_settings(self.settings_file) if self.settings_file is not None else {}
        parameters = given.pop(PARAMETERS, {})
        return checked_settings(given | {**self.settings}), parameters

    def check(self) -> Outcome | None:
        """Outcome of a patient whose files are missing or settings invalid; else None."""
        try:
            if self.heart != DEFAULT_HEART and not (Path(self.heart) / MANIFEST).is_file():
                raise FileError(
                    f"{self.heart}: not a heart folder (no {MANIFEST}); make one with "
                    "'fascicle heart build'"
                )
            existing_file(self.recording)
            if self.scenario is not None and not self.scenario.is_file():
                raise FileError(f"{self.scenario}: no such file (scenario); check the path")
            self.given()
        except InputError as error:
            return self.failed(str(error))
        return None


def fit_patient(patient: Patient, pool: Pool, progress: Progress | None = None) -> Outcome:
    """Fit a patient and write the report, or the reason of the failure.

    A finished study of the same row is not changed.

    Raises
    ------
    HeldError
        If another process is fitting the patient.
    """
    with study_lock(patient.folder):
        began = time.monotonic()
        try:
            inputs = _inputs(patient)
            if _is_done(patient, inputs):
                return patient.outcome
            for old in ("outcome.json", "error.txt"):
                (patient.folder / old).unlink(missing_ok=True)
            fitted = fit_inputs(inputs, patient.study, progress, pool)
            report(fitted, out=patient.report, progress=progress)
            return patient.ended(Outcome.of(patient.name, fitted, time.monotonic() - began))
        except HeldError:  # the study itself, by 'fascicle fit'
            raise
        except InputError as error:
            return patient.failed(str(error))
        except Exception as error:  # noqa: BLE001 - a bug in one must not stop the others; it is shown
            return patient.bug(error)


def _is_done(patient: Patient, inputs: Inputs) -> bool:
    """Whether the study of these inputs and its report are finished."""
    finished = is_finished(patient.study, inputs.config) and patient.report.is_file()
    return finished and patient.outcome.status is Status.FITTED


def _inputs(patient: Patient) -> Inputs:
    """Read the files of the row; a recording becomes a target by default options."""
    settings, parameters = patient.given()
    path, scenario = patient.recording, patient.scenario
    is_target = path.suffix.lower() == ".nc"
    target = read_target(path) if is_target else make_target(read_recording(path))
    recording = target if scenario is None else (target, scenario)
    return read_inputs(patient.heart, recording, parameters, settings)
