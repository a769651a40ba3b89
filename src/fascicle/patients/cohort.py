"""Fits of all patients of a table, here or on workers of a Dask cluster, with an overview page."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from fascicle.core import VERSION
from fascicle.core.files import as_path, check_folder, write_text
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.threads import cores
from fascicle.patients.patient import (
    CohortPart,
    Outcome,
    Patient,
    Status,
    fit_patient,
    part_of,
    read_table,
)
from fascicle.pools.pool import Threads, check_pool
from fascicle.study.study import HeldError

if TYPE_CHECKING:
    from fascicle.pools.cluster import Cluster


def cohort(
    table: Path | str,
    out: Path | str,
    *,
    only: str | None = None,
    cluster: Cluster | None = None,
    progress: Progress | Lines | None = "lines",
) -> list[Outcome]:
    """Fit every patient of a table; write a report of each and an overview page.

    A second call resumes: finished patients are skipped, those that failed are tried again. The
    failure of one patient does not stop the others.

    Parameters
    ----------
    table : path
        CSV file with the columns ``patient``, ``heart``, ``recording``, optionally ``scenario``,
        ``settings``, ``sex``, ``age``, ``height`` and ``weight`` of the person, and fields of
        `fascicle.FitSettings`; paths are relative to its folder.
    out : path
        Folder to write: ``studies/NAME``, ``results.csv``, ``index.html``.
    only : str, optional
        ``"i/n"``: only rows i, i + n, i + 2n and so on, for array jobs, which may run at the same
        time.
    cluster : Cluster, optional
        Cluster whose workers fit one patient each (`fascicle.Cluster`); without, patients are
        fitted here, one after the other.
    progress : Progress, optional
        Called with the number of finished patients, and with the stages of a fit made here.

    Returns
    -------
    list of Outcome
        Outcome of each chosen row, as they finish: `patient`, `status`, `reason`, `verdict`,
        `converged`, `explained`, `parameters` and more.

    Raises
    ------
    InputError
        If the table is invalid, the folder cannot be used, or workers do not see it.

    Examples
    --------
    >>> import fascicle
    >>> outcomes = fascicle.cohort("patients.csv", "COHORT")  # doctest: +SKIP
    >>> [outcome.patient for outcome in outcomes if not outcome.trustworthy]  # doctest: +SKIP
    """
    check_pool(cluster)
    with shown_progress(progress) as callback:
        return list(outcomes(table, out, only=only, cluster=cluster, progress=callback))


def outcomes(
    table: Path | str,
    out: Path | str,
    *,
    only: str | None = None,
    cluster: Cluster | None = None,
    progress: Progress | None = None,
) -> Iterator[Outcome]:
    """Yield the outcomes of `cohort` as patients finish, and update the overview each time."""
    table, folder = as_path(table, "table"), as_path(out, "folder").absolute()
    patients = read_table(table, folder)
    mine = part_of(patients, only)
    check_folder(folder)
    (folder / CohortPart.PATIENTS).mkdir(parents=True, exist_ok=True)
    try:
        refused = {patient.name: patient.check() for patient in mine}
        yield from (outcome for outcome in refused.values() if outcome is not None)
        for outcome in _fitted([p for p in mine if refused[p.name] is None], cluster, progress):
            write_overview(folder, table, patients)
            yield outcome
    finally:
        write_overview(folder, table, patients)


def _fitted(
    patients: Sequence[Patient], cluster: Cluster | None, progress: Progress | None
) -> Iterator[Outcome]:
    """Yield the outcomes of patients, those of earlier runs first, and report progress."""
    ordered = sorted(patients, key=lambda patient: patient.outcome.status is not Status.FITTED)
    finished = sum(patient.outcome.status is Status.FITTED for patient in patients)
    done = 0

    def report(message: str) -> None:
        # skipped patients take no time, and would spoil the estimate of the time left
        if progress is not None and done >= finished:
            progress("patients", done, len(patients), message)

    if cluster is None:
        ended = _fitted_here(ordered, report, progress)
    else:
        from fascicle.patients.workers import fit_on_workers

        ended = fit_on_workers(cluster, ordered, report)
    for outcome in ended:
        done += 1
        report("")
        yield outcome


def _fitted_here(
    patients: Sequence[Patient], report: Callable[[str], None], progress: Progress | None
) -> Iterator[Outcome]:
    pool = Threads(cores())
    for patient in patients:
        report(patient.name)
        try:
            yield fit_patient(patient, pool, progress)
        except HeldError as error:
            yield Outcome(patient=patient.name, status=Status.NOT_DONE, reason=str(error))


def write_overview(folder: Path, table: Path, patients: Sequence[Patient]) -> None:
    """Write the table and the page of all outcomes of a cohort so far.

    Other processes may write them at the same time: they are rewritten until no outcome has changed
    meanwhile, so the last writer leaves them complete.
    """
    outcomes: list[Outcome] = []
    while (current := [patient.outcome for patient in patients]) != outcomes:
        outcomes = current
        rows = [
            outcome.row() | {"heart": patient.heart, "recording": patient.recording}
            for patient, outcome in zip(patients, outcomes, strict=True)
        ]
        text = io.StringIO()
        # cells are empty where an outcome lacks a column
        columns = dict.fromkeys(name for row in rows for name in row)
        writer = csv.DictWriter(text, [*columns], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(folder / CohortPart.RESULTS, text.getvalue())
        write_text(folder / CohortPart.PAGE, _page(table, outcomes))


def _page(table: Path, outcomes: Sequence[Outcome]) -> str:
    from jinja2 import Environment
    from markupsafe import Markup

    package = files("fascicle")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = (package / "patients" / "overview.html").read_text(encoding="utf-8")
    style = (package / "reporting" / "page" / "style.css").read_text(encoding="utf-8")
    fitted = [outcome for outcome in outcomes if outcome.status is Status.FITTED]
    return environment.from_string(template).render(
        version=VERSION,
        style=Markup(style),
        table=table.name,
        all=all(outcome.trustworthy for outcome in outcomes),
        answer=answer(outcomes),
        outcomes=outcomes,
        names=list(dict.fromkeys(name for outcome in fitted for name in outcome.parameters)),
        fitted=fitted,
    )


def answer(outcomes: Sequence[Outcome]) -> str:
    """Summary of all outcomes in one line."""

    def counted(numbers: Mapping[str, int]) -> list[str]:
        return [f"{number} {label}" for label, number in numbers.items() if number]

    status = Counter(outcome.status for outcome in outcomes)
    posteriors = [outcome for outcome in outcomes if outcome.converged is not None]
    converged = [outcome for outcome in posteriors if outcome.converged]
    explained_too = sum(outcome.trustworthy for outcome in converged)
    results = counted(
        {
            "converged and explained": explained_too,
            "not converged": len(posteriors) - len(converged),
            "converged but not explained": len(converged) - explained_too,
        }
    )
    remaining = counted({"failed": status[Status.FAILED], "not done yet": status[Status.NOT_DONE]})
    fitted = f"{status[Status.FITTED]} of {len(outcomes)} patients fitted"
    return "; ".join([": ".join(filter(None, [fitted, ", ".join(results)])), *remaining])
