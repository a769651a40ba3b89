"""A patient of a cohort: from the table to a study with its report, and the outcome of that."""

from __future__ import annotations

import csv
import json
import re
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from fascicle.atlas.population import KNOWN
from fascicle.core.errors import FileError, InputError, ValueRefusedError, given_in, one_line
from fascicle.core.files import PACKAGED, as_path, check_file, write_text
from fascicle.core.progress import Progress
from fascicle.core.ranges import shown
from fascicle.heart.folder import HEART_FILES, load_heart
from fascicle.networks.prior import read_settings
from fascicle.networks.settings import FitSettings, checked_settings
from fascicle.pools.pool import Pool
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import existing_file, read_recording
from fascicle.recording.target_files import read_target
from fascicle.reporting.page.page import report
from fascicle.study.fit import fit_inputs
from fascicle.study.fitted import FittedStudy
from fascicle.study.inputs import Inputs, read_inputs
from fascicle.study.population import Posterior
from fascicle.study.study import HeldError, is_finished, study_lock


class Status(StrEnum):
    """True if a patient has been fitted."""

    FITTED = "fitted"
    FAILED = "failed"
    NOT_DONE = "not done"


class Estimate(BaseModel):
    """Median, 5th and 95th percentile of a parameter; whether the ECG constrains it."""

    model_config = ConfigDict(frozen=True)

    unit: str
    median: float
    lower: float
    upper: float
    determined: bool | None = None

    def __str__(self) -> str:
        return f"{self.median:.3g} ({self.lower:.3g} to {self.upper:.3g})"


class Outcome(BaseModel):
    """Outcome of a patient; docs/files.md describes the fields.

    `converged` and `explained` are None without a posterior; `explained_power` is the share of the
    recorded QRS that the mean of the networks explains, over all leads, and
    `explained_by_the_best` the share that each of the best networks explains. `states` says how
    probable each conduction state is, if one can be named; `parameters` is empty if the fit has not
    converged; `error_file` is the file with the traceback of a bug.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    patient: str
    status: Status
    reason: str = ""
    error_file: Path | None = None
    seconds: float = 0.0
    verdict: str = ""
    converged: bool | None = None
    explained: bool | None = None
    explained_power: float | None = None
    explained_by_the_best: float | None = None
    best_loss_mV2: float | None = None  # noqa: N815 - as in the summary of a study
    qrs_duration_ms: float | None = None
    predicted_qrs_duration_ms: float | None = None
    warnings: tuple[str, ...] = ()
    states: Mapping[str, float] = {}
    parameters: Mapping[str, Estimate] = {}

    @property
    def trustworthy(self) -> bool:
        """True if the patient has a posterior that converged and explains the recording."""
        return bool(self.converged and self.explained)

    @classmethod
    def of(cls, patient: str, fitted: FittedStudy, seconds: float) -> Outcome:
        """Summarise a study that has just been written."""
        summary = json.loads((fitted.folder / "summary.json").read_text(encoding="utf-8"))
        qrs = summary.get("qrs_duration_ms", {"recorded": None, "networks": {"median": None}})
        noticed = fitted.recordings[0].target.warnings
        return cls(
            patient=patient,
            status=Status.FITTED,
            seconds=round(seconds, 1),
            verdict=fitted.verdict,
            converged=summary.get("converged"),
            explained=fitted.statements.acceptable,
            explained_power=summary["explained_power"]["all"],
            explained_by_the_best=summary.get("explained_by_the_best"),
            best_loss_mV2=fitted.population.best_loss,
            qrs_duration_ms=qrs["recorded"],
            predicted_qrs_duration_ms=qrs["networks"]["median"],
            warnings=(*fitted.warnings, *noticed),
            states=getattr(fitted.population, "states", {}) if fitted.statements.states else {},
            parameters=_estimates(fitted),
        )

    def row(self) -> dict[str, Any]:
        """Row of the results table: three columns for each parameter and one for each state."""
        row = self.model_dump(exclude={"error_file", "parameters", "states", "warnings"})
        row["warnings"] = "; ".join(self.warnings)
        row |= {f"P({name})": probability for name, probability in self.states.items()}
        for name, estimate in self.parameters.items():
            row |= {
                name: estimate.median,
                f"{name}_5": estimate.lower,
                f"{name}_95": estimate.upper,
            }
        return row


def _estimates(fitted: FittedStudy) -> dict[str, Estimate]:
    """Estimates of all parameters; empty if the runs of a posterior do not agree."""
    population, space = fitted.population, fitted.simulator.prior.learnt
    determined: dict[str, bool] = {}
    if isinstance(population, Posterior):
        if not population.converged:
            return {}
        determined = {
            parameter.name: parameter.constrained for parameter in fitted.statements.parameters
        }
    estimates = {}
    for parameter in space.parameters:
        lower, median, upper = np.percentile(population.values[parameter.name], [5, 50, 95])
        estimates[parameter.name] = Estimate(
            unit=parameter.unit, median=median, lower=lower, upper=upper,
            determined=determined.get(parameter.name),
        )  # fmt: skip
    return estimates


class CohortPart(StrEnum):
    """Files and folders in the folder of a cohort."""

    PATIENTS = "patients"  # outcomes
    STUDIES = "studies"
    PAGE = "index.html"
    RESULTS = "results.csv"


@dataclass(frozen=True)
class Patient:
    """A row of the table, and the folder of its cohort."""

    needed_columns: ClassVar = ("patient", "heart", "recording")
    outcome_file: ClassVar = "outcome.json"  # in the patient's folder

    name: str  # also of the study
    cohort: Path
    heart: Path | str  # folder, or the name of a packaged heart
    recording: Path  # target (.nc), or in any format of `fascicle.read_recording`
    scenario: Path | None = None  # scenario of the recording; None: intrinsic beat
    settings_file: Path | None = None  # TOML file of settings and parameters
    settings: Mapping[str, Any] = field(default_factory=dict)  # these override those of the file
    person: Mapping[str, Any] = field(default_factory=dict)  # what is known, for the heart 'atlas'

    @property
    def study(self) -> Path:
        """Folder of the study."""
        return self.cohort / CohortPart.STUDIES / self.name

    @property
    def report(self) -> Path:
        """Report of the study."""
        return self.study / "report.html"

    @property
    def folder(self) -> Path:
        """Folder of the patient's outcome, which one process at a time writes."""
        return self.cohort / CohortPart.PATIENTS / self.name

    @property
    def outcome(self) -> Outcome:
        """Stored outcome; `NOT_DONE` if there is none, or one of another version."""
        try:
            stored = (self.folder / self.outcome_file).read_text(encoding="utf-8")
            return Outcome.model_validate_json(stored)
        except (FileNotFoundError, ValidationError):
            return Outcome(patient=self.name, status=Status.NOT_DONE)

    def ended(self, outcome: Outcome) -> Outcome:
        """Store the patient's outcome."""
        write_text(self.folder / self.outcome_file, outcome.model_dump_json(indent=2) + "\n")
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
        summary = f"{type(error).__name__}: {one_line(error)}"
        return self.failed(f"bug: {summary} (traceback in {path})", path)

    def given(self) -> tuple[FitSettings, Mapping[str, Any]]:
        """Settings, and the parameters to learn; the row overrides its settings file."""
        settings = read_settings(self.settings_file) if self.settings_file is not None else {}
        parameters = settings.pop("parameters", {})
        return checked_settings(settings | {**self.settings}), parameters

    def check(self) -> Outcome | None:
        """Outcome of a patient whose files are missing or settings invalid; else None."""
        try:
            manifest = HEART_FILES["manifest"]
            if self.heart not in PACKAGED and not (Path(self.heart) / manifest).is_file():
                raise FileError(
                    f"{self.heart}: not a heart folder (no {manifest}); make one with 'fascicle "
                    f"heart build', or give one of the package ({', '.join(PACKAGED)})"
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

    A finished study of the same row is not changed. HeldError means that another process is fitting
    the patient.
    """
    with study_lock(patient.folder):
        began = time.monotonic()
        try:
            inputs = _inputs(patient)
            if _is_done(patient, inputs):
                return patient.outcome
            for old in (patient.outcome_file, "error.txt"):
                (patient.folder / old).unlink(missing_ok=True)
            fitted = fit_inputs(inputs, patient.study, progress, pool)
            report(fitted, out=patient.report, progress=progress)
            return patient.ended(Outcome.of(patient.name, fitted, time.monotonic() - began))
        except HeldError:  # 'fascicle fit' is fitting the study
            raise
        except InputError as error:
            return patient.failed(str(error))
        except Exception as error:  # noqa: BLE001 - a patient's bug must not stop the others; it is shown
            return patient.bug(error)


def _is_done(patient: Patient, inputs: Inputs) -> bool:
    finished = is_finished(patient.study, inputs.config) and patient.report.is_file()
    return finished and patient.outcome.status is Status.FITTED


def _inputs(patient: Patient) -> Inputs:
    """Read the files of the row; a recording becomes a target by default options."""
    settings, parameters = patient.given()
    path, scenario = patient.recording, patient.scenario
    is_target = path.suffix.lower() == ".nc"
    target = read_target(path) if is_target else make_target(read_recording(path))
    recording = target if scenario is None else (target, scenario)
    heart = load_heart(patient.heart, **patient.person)
    return read_inputs(heart, recording, parameters, settings)


def read_table(path: Path | str, cohort: Path) -> list[Patient]:
    """Read the table of a cohort; paths are relative to the table's folder.

    The first line names the columns, separated by commas, semicolons or tabs; each further line
    describes a patient. Error messages name the line.
    """
    path = as_path(path, "table")
    check_file(path, (".csv", ".tsv"), "table of patients")
    patients: dict[str, Patient] = {}
    for number, cells in _lines(path):
        with given_in(f"{path}, line {number}"):
            patient = _patient(path.parent.absolute(), cells, cohort)
            # some file systems ignore case
            if patients.setdefault(patient.name.lower(), patient) is not patient:
                raise FileError(f"patient '{patient.name}' is there twice; give another name")
    if not patients:
        raise FileError(f"{path}: has no patient; write a line for each below the columns")
    return list(patients.values())


def _lines(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Numbers of the lines that are not empty, with their non-empty cells by column."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        # spreadsheets write semicolons where the comma is a decimal point
        separator = max(",;\t", key=text.partition("\n")[0].count)
        reader = csv.DictReader(text.splitlines(keepends=True), delimiter=separator, strict=True)
        columns = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = columns
        lines = [(reader.line_num, cells) for cells in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(
            f"{path}: is not a table in text ({one_line(error)}); save it as CSV (UTF-8)"
        ) from None
    needed = Patient.needed_columns
    allowed = (*needed, "scenario", "settings", *KNOWN, *FitSettings.model_fields)
    wrong = [name for name in columns if name not in allowed or columns.count(name) > 1]
    wrong += [name for name in needed if name not in columns]
    if wrong:
        raise FileError(
            f"{path}, line 1: column {shown(wrong[0])} is unknown, missing or there twice; name "
            f"each column there, such as {','.join(needed)}; known are {', '.join(allowed)}"
        )
    for number, cells in lines:
        if None in cells or None in cells.values():  # a row has too many or too few cells
            raise FileError(
                f"{path}, line {number}: has other columns than the {len(columns)} of the first "
                "line; put a text that holds the separator between double quotes"
            )
    rows = [(k, {n: c.strip() for n, c in cells.items() if c.strip()}) for k, cells in lines]
    return [(number, cells) for number, cells in rows if cells]


def _patient(folder: Path, cells: Mapping[str, str], cohort: Path) -> Patient:
    for name in Patient.needed_columns:
        if name not in cells:
            raise FileError(f"no {name} is given; fill the cell")
    # valid as a folder name on every system, and unescaped in a link
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", cells["patient"]):
        raise FileError(
            f"{shown(cells['patient'])} cannot be the name of a folder; use letters from a to z, "
            "digits, '-', '_' and '.', the first a letter or a digit"
        )
    files = [name for name in ("heart", "recording", "scenario", "settings") if name in cells]
    paths = {name: folder / as_path(cells[name], name) for name in files}
    fields = {name: cell for name, cell in cells.items() if name in FitSettings.model_fields}
    settings = FitSettings(**fields)
    try:
        person = {n: cells[n] if n == "sex" else float(cells[n]) for n in KNOWN if n in cells}
    except ValueError as error:
        raise FileError(
            f"{one_line(error)}; give age, height and weight (years, cm, kg) as numbers"
        ) from None
    return Patient(
        cells["patient"],
        cohort,
        cells["heart"] if cells["heart"] in PACKAGED else paths["heart"],
        paths["recording"],
        paths.get("scenario"),
        paths.get("settings"),
        {name: getattr(settings, name) for name in fields},
        person,
    )


def part_of(patients: Sequence[Patient], only: str | None) -> list[Patient]:
    """Patients i, i + n, i + 2n, ... of ``"i/n"``, counted from 1; all patients without `only`."""
    if only is None:
        return list(patients)
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", only) if isinstance(only, str) else None
    first, step = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= first <= step:
        raise ValueRefusedError(
            f"--only is {shown(only)}; give i/n with i from 1 to n, such as 1/20"
        )
    return list(patients[first - 1 :: step])
