"""A patient of a cohort: from the row of the table to a study with its report."""

from __future__ import annotations

import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fascicle.core.errors import InputError, one_line
from fascicle.core.files import write_text
from fascicle.core.progress import Progress
from fascicle.heart.folder import DEFAULT_HEART, MANIFEST
from fascicle.patients.outcome import Outcome, Status, read_outcome, write_outcome
from fascicle.patients.table import Row
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import existing_file, read_recording
from fascicle.recording.target import Target
from fascicle.recording.target_files import read_target
from fascicle.reporting.page.page import report
from fascicle.study.fit import Inputs, fit_inputs, read_inputs
from fascicle.study.lock import HeldError, study_lock
from fascicle.study.pool import Pool
from fascicle.study.settings import FitSettings, checked_settings
from fascicle.study.space import PARAMETERS, read_settings
from fascicle.study.study import is_finished

PATIENTS, STUDIES = "patients", "studies"  # folders of a cohort
REPORT = "report.html"


@dataclass(frozen=True)
class Patient:
    """A row, and where its files are.

    Attributes
    ----------
    row : Row
    cohort : Path
        Folder of the cohort.
    """

    row: Row
    cohort: Path

    @property
    def name(self) -> str:
        """As in the table."""
        return self.row.patient

    @property
    def study(self) -> Path:
        """Folder of the study."""
        return self.cohort / STUDIES / self.name

    @property
    def folder(self) -> Path:
        """Folder of what has become of the patient, which one process at a time writes."""
        return self.cohort / PATIENTS / self.name

    @property
    def outcome_file(self) -> Path:
        """What has become of the patient."""
        return self.folder / "outcome.json"

    @property
    def error_file(self) -> Path:
        """Traceback of a bug."""
        return self.folder / "error.txt"

    @property
    def outcome(self) -> Outcome:
        """What has become of the patient so far."""
        return read_outcome(self.outcome_file) or Outcome(patient=self.name, status=Status.NOT_DONE)


def check(patient: Patient) -> Outcome | None:
    """Refuse a patient whose files are missing or whose settings are impossible, at once.

    The rest of what is wrong with the files is found when they are read.
    """
    row = patient.row
    try:
        if row.heart != DEFAULT_HEART and not (Path(row.heart) / MANIFEST).is_file():
            raise InputError(
                f"{row.heart}: not a heart folder (no {MANIFEST}); make one with "
                "'fascicle heart build'"
            )
        existing_file(row.recording)
        if row.scenario is not None and not row.scenario.is_file():
            raise InputError(f"{row.scenario}: no such file (scenario); check the path")
        _settings(row)
    except InputError as error:
        return failed(patient, str(error))
    return None


def fit_patient(patient: Patient, pool: Pool, progress: Progress | None = None) -> Outcome:
    """Fit a patient and write the report, or what keeps it from being fitted.

    A finished study is left as it is, if it is that of the row.

    Parameters
    ----------
    patient : Patient
        The row.
    pool : Pool
        Where networks are simulated.
    progress : Progress, optional
        Called with the stage of the fit, and how far it is.

    Raises
    ------
    HeldError
        If another process works on the patient.
    """
    with study_lock(patient.folder):
        began = time.monotonic()
        try:
            inputs = _inputs(patient.row)
            if _is_done(patient, inputs):
                return patient.outcome
            for old in (patient.outcome_file, patient.error_file):
                old.unlink(missing_ok=True)
            fitted = fit_inputs(inputs, patient.study, progress, pool)
            report(fitted, out=patient.study / REPORT, progress=progress)
            outcome = Outcome.of(patient.name, fitted)
        except HeldError:  # the study itself, by 'fascicle fit'
            raise
        except InputError as error:
            return failed(patient, str(error))
        except Exception as error:  # noqa: BLE001 - a bug in one must not stop the others; it is shown
            return bug(patient, error)
        outcome = outcome.model_copy(update={"seconds": round(time.monotonic() - began, 1)})
        write_outcome(outcome, patient.outcome_file)
        return outcome


def failed(patient: Patient, reason: str, error_file: Path | None = None) -> Outcome:
    """Write down why a patient cannot be fitted."""
    outcome = Outcome(
        patient=patient.name, status=Status.FAILED, reason=reason, error_file=error_file
    )
    write_outcome(outcome, patient.outcome_file)
    return outcome


def bug(patient: Patient, error: BaseException) -> Outcome:
    """Write down an error that nobody has foreseen, with its traceback."""
    path = patient.error_file
    write_text(path, "".join(traceback.format_exception(error)))
    what = f"{type(error).__name__}: {one_line(error)}"
    return failed(patient, f"bug: {what} (traceback in {path})", path)


def _is_done(patient: Patient, inputs: Inputs) -> bool:
    """Whether the study of these inputs is finished, with its report."""
    study = is_finished(patient.study, inputs.config)
    reported = patient.outcome.status is Status.FITTED and (patient.study / REPORT).is_file()
    return study and reported


def _inputs(row: Row) -> Inputs:
    """Read all that a row names."""
    settings, parameters = _settings(row)
    target = _target(row.recording)
    recording = target if row.scenario is None else (target, row.scenario)
    return read_inputs(row.heart, recording, parameters, settings)


def _settings(row: Row) -> tuple[FitSettings, Mapping[str, Any]]:
    """Settings, and what is learnt; the row counts more than its file."""
    given = read_settings(row.settings_file) if row.settings_file is not None else {}
    parameters = given.pop(PARAMETERS, {})
    return checked_settings(given | {**row.settings}), parameters


def _target(path: Path) -> Target:
    """A target, or that of a recording which needs no choices."""
    if path.suffix.lower() == ".nc":
        return read_target(path)
    return make_target(read_recording(path))
