"""What has become of a patient, in a file of its own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from fascicle.core.files import write_text
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Posterior
from fascicle.study.statements import INTERVAL


class Status(StrEnum):
    """How far a patient is."""

    FITTED = "fitted"
    FAILED = "failed"
    NOT_DONE = "not done"


class Said(BaseModel):
    """What the networks say of a parameter.

    Attributes
    ----------
    unit : str
    median, lower, upper : float
        `lower` and `upper` are the 5th and 95th percentiles.
    determined : bool, optional
        Whether the ECG determines it; None where there is no posterior.
    """

    model_config = ConfigDict(frozen=True)

    unit: str
    median: float
    lower: float
    upper: float
    determined: bool | None = None


class Outcome(BaseModel):
    """What has become of a patient.

    Attributes
    ----------
    patient : str
    status : Status
    reason : str
        Why it is not fitted, in one line.
    error_file : Path, optional
        With the traceback, if that is a bug.
    seconds : float
        That it took, in the run that ended it.
    verdict : str
        First line of the result.
    converged, explained : bool, optional
        What the verdict says; None where there is no posterior.
    explained_power, explained_by_a_network : float, optional
        Share of the recorded QRS that the mean of the networks explains, over all leads, and that
        each of them does (median).
    best_loss_mV2 : float, optional
        Mismatch of the best network.
    qrs_duration_ms, predicted_qrs_duration_ms : float, optional
        Of the QRS window: recorded, and the median of the networks.
    warnings : tuple of str
        What must be known first.
    parameters : mapping of name to Said
        Of a population whose parameters may be relied on.
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
    explained_by_a_network: float | None = None
    best_loss_mV2: float | None = None  # noqa: N815 - as in the summary of a study
    qrs_duration_ms: float | None = None
    predicted_qrs_duration_ms: float | None = None
    warnings: tuple[str, ...] = ()
    parameters: Mapping[str, Said] = {}

    @property
    def trustworthy(self) -> bool:
        """Whether it is a posterior that has converged and explains its recording."""
        return bool(self.converged and self.explained)

    @classmethod
    def of(cls, patient: str, fitted: FittedStudy) -> Outcome:
        """Sum up a study that has just been written.

        Parameters
        ----------
        patient : str
            The name.
        fitted : FittedStudy
            The study.
        """
        summary = json.loads((fitted.folder / "summary.json").read_text(encoding="utf-8"))
        qrs = summary.get("qrs_duration_ms", {"recorded": None, "networks": {"median": None}})
        noticed = fitted.recordings[0].target.provenance.get("warnings", "").splitlines()
        return cls(
            patient=patient,
            status=Status.FITTED,
            verdict=fitted.verdict,
            converged=summary.get("converged"),
            explained=fitted.statements.acceptable,
            explained_power=summary["explained_power"]["all"],
            explained_by_a_network=summary.get("explained_by_a_network"),
            best_loss_mV2=fitted.population.best_loss,
            qrs_duration_ms=qrs["recorded"],
            predicted_qrs_duration_ms=qrs["networks"]["median"],
            warnings=(*fitted.warnings, *noticed),
            parameters=_said(fitted),
        )


def _said(fitted: FittedStudy) -> dict[str, Said]:
    """Of every parameter; of none where the runs do not agree."""
    population, space = fitted.population, fitted.simulator.space
    if not isinstance(population, Posterior):
        units = {parameter.name: parameter.unit for parameter in space.parameters}
        found = {}
        for name, values in population.values.items():
            lower, median, upper = np.percentile(values, [INTERVAL[0], 50, INTERVAL[1]])
            found[name] = Said(unit=units[name], median=median, lower=lower, upper=upper)
        return found
    return {
        s.name: Said(
            unit=s.unit, median=s.median, lower=s.lower, upper=s.upper, determined=s.constrained
        )
        for s in fitted.statements.parameters
    }


def write_outcome(outcome: Outcome, path: Path) -> None:
    """Write it whole or not at all."""
    write_text(path, outcome.model_dump_json(indent=2) + "\n")


def read_outcome(path: Path) -> Outcome | None:
    """Read it; None if there is none yet, or one of another version, which is made again."""
    try:
        return Outcome.model_validate_json(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValidationError):
        return None


def as_row(outcome: Outcome) -> dict[str, Any]:
    """It in the columns of a table, with three for each parameter."""
    row = outcome.model_dump(exclude={"error_file", "parameters", "warnings"})
    row["warnings"] = "; ".join(outcome.warnings)
    for name, said in outcome.parameters.items():
        row |= {name: said.median, f"{name}_5": said.lower, f"{name}_95": said.upper}
    return row
