"""Outcome of one patient of a cohort, stored as a JSON file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Posterior


class Status(StrEnum):
    """Whether a patient has been fitted."""

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
        """Whether the patient has a posterior that converged and explains the recording."""
        return bool(self.converged and self.explained)

    @classmethod
    def of(cls, patient: str, fitted: FittedStudy, seconds: float) -> Outcome:
        """Summarise a study that has just been written."""
        summary = json.loads((fitted.folder / "summary.json").read_text(encoding="utf-8"))
        qrs = summary.get("qrs_duration_ms", {"recorded": None, "networks": {"median": None}})
        noticed = fitted.recordings[0].target.provenance.get("warnings", "").splitlines()
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
