"""Fit every patient of a table, here or on the workers of a Dask cluster; the page of all."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from fascicle.core.errors import OutputError
from fascicle.core.files import as_path, check_writable, write_text
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.threads import cores
from fascicle.patients.outcome import Outcome, Status
from fascicle.patients.patient import PATIENTS, STUDIES, Patient, fit_patient
from fascicle.patients.table import part_of, read_table
from fascicle.study.lock import HeldError
from fascicle.study.pool import Threads, check_pool

if TYPE_CHECKING:
    from fascicle.study.cluster import Cluster

PAGE, RESULTS = "index.html", "results.csv"  # of a cohort


def cohort(
    table: Path | str,
    out: Path | str,
    *,
    only: str | None = None,
    cluster: Cluster | None = None,
    progress: Progress | Lines | None = "lines",
) -> list[Outcome]:
    """Fit every patient of a table, and write a report of each and a page of all.

    Started again it goes on: finished patients are left as they are, those that failed are tried
    again. What is wrong with one patient does not stop the others.

    Parameters
    ----------
    table : path
        CSV file with the columns ``patient``, ``heart``, ``recording``, perhaps ``scenario``,
        ``settings`` and fields of `fascicle.FitSettings`; paths count from its folder.
    out : path
        Folder to write: ``studies/NAME``, ``results.csv``, ``index.html``.
    only : str, optional
        ``"i/n"``: of the rows only i, i + n, i + 2n and so on, for jobs of an array. They may run
        at the same time.
    cluster : Cluster, optional
        Whose workers fit a patient each (`fascicle.Cluster`); else patients are fitted here, one
        after the other.
    progress : Progress, optional
        Called with how many patients are done, and with the stages of the one who is fitted here.

    Returns
    -------
    list of Outcome
        Of the rows that were asked for, as they ended: `patient`, `status`, `reason`, `verdict`,
        `converged`, `explained`, `parameters` and more.

    Raises
    ------
    InputError
        If the table is not one, the folder cannot be used, or workers do not see it.

    Examples
    --------
    >>> import fascicle
    >>> outcomes = fascicle.cohort("patients.csv", "COHORT")  # doctest: +SKIP
    >>> [each.patient for each in outcomes if not each.trustworthy]  # doctest: +SKIP
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
    """Give the outcomes of `cohort` as soon as they are there; the page is that of all so far."""
    table, folder = as_path(table, "table"), as_path(out, "folder").absolute()
    patients = read_table(table, folder)
    mine = part_of(patients, only)
    _check_folder(folder)
    try:
        refused = {patient.name: patient.check() for patient in mine}
        yield from (outcome for outcome in refused.values() if outcome is not None)
        for outcome in _fitted([p for p in mine if refused[p.name] is None], cluster, progress):
            write_overview(folder, table, patients)
            yield outcome
    finally:
        write_overview(folder, table, patients)


def _check_folder(folder: Path) -> None:
    """Refuse a folder that is no cohort and cannot become one."""
    check_writable(folder / PAGE)
    own = (PATIENTS, STUDIES, PAGE, RESULTS)
    foreign = [path.name for path in folder.iterdir() if path.name not in own]
    if foreign and not (folder / PATIENTS).is_dir():
        raise OutputError(
            f"{folder}: holds '{foreign[0]}' and is no cohort; give another folder (--out)"
        )


def _fitted(
    patients: Sequence[Patient], cluster: Cluster | None, progress: Progress | None
) -> Iterator[Outcome]:
    """Fit patients, those first that are done already, and say how many are done."""
    ordered = sorted(patients, key=lambda patient: patient.outcome.status is not Status.FITTED)
    finished = sum(patient.outcome.status is Status.FITTED for patient in patients)
    done = 0

    def report(message: str) -> None:
        # not before: the time that finished ones take says nothing of the time that is left
        if progress is not None and done >= finished:
            progress("patients", done, len(patients), message)

    if cluster is None:
        found = _fitted_here(ordered, report, progress)
    else:
        from fascicle.patients.workers import fit_on_workers

        found = fit_on_workers(cluster, ordered, report)
    for outcome in found:
        done += 1
        report("")
        yield outcome


def _fitted_here(
    patients: Sequence[Patient], report: Callable[[str], None], progress: Progress | None
) -> Iterator[Outcome]:
    """Fit patients one after the other."""
    pool = Threads(cores())
    for patient in patients:
        report(patient.name)
        try:
            yield fit_patient(patient, pool, progress)
        except HeldError as error:
            yield Outcome(patient=patient.name, status=Status.NOT_DONE, reason=str(error))


def write_overview(folder: Path, table: Path, patients: Sequence[Patient]) -> None:
    """Write table and page of what has become of all patients of a cohort so far.

    Others may do so at the same time: where a patient was done meanwhile it is written again, so
    that whoever writes last leaves the whole.
    """
    outcomes: list[Outcome] = []
    while (found := [patient.outcome for patient in patients]) != outcomes:
        outcomes = found
        rows = [
            outcome.row() | {"heart": patient.heart, "recording": patient.recording}
            for patient, outcome in zip(patients, outcomes, strict=True)
        ]
        text = io.StringIO()
        columns = dict.fromkeys(name for row in rows for name in row)  # empty where one has none
        writer = csv.DictWriter(text, [*columns], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(folder / RESULTS, text.getvalue())
        write_text(folder / PAGE, _page(table, outcomes))


def _page(table: Path, outcomes: Sequence[Outcome]) -> str:
    from jinja2 import Environment
    from markupsafe import Markup

    from fascicle import __version__

    own = files("fascicle")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = (own / "patients" / "overview.html").read_text(encoding="utf-8")
    style = (own / "reporting" / "page" / "style.css").read_text(encoding="utf-8")
    fitted = [outcome for outcome in outcomes if outcome.status is Status.FITTED]
    return environment.from_string(template).render(
        version=__version__,
        style=Markup(style),
        table=table.name,
        all=all(outcome.trustworthy for outcome in outcomes),
        answer=answer(outcomes),
        outcomes=outcomes,
        names=list(dict.fromkeys(name for each in fitted for name in each.parameters)),
        fitted=fitted,
    )


def answer(outcomes: Sequence[Outcome]) -> str:
    """What has become of all, in one line."""

    def counted(numbers: Mapping[str, int]) -> list[str]:
        return [f"{number} {what}" for what, number in numbers.items() if number]

    status = Counter(each.status for each in outcomes)
    posteriors = [each for each in outcomes if each.converged is not None]
    converged = [each for each in posteriors if each.converged]
    explained_too = sum(each.trustworthy for each in converged)
    results = counted(
        {
            "converged and explained": explained_too,
            "not converged": len(posteriors) - len(converged),
            "converged but not explained": len(converged) - explained_too,
        }
    )
    others = counted({"failed": status[Status.FAILED], "not done yet": status[Status.NOT_DONE]})
    fitted = f"{status[Status.FITTED]} of {len(outcomes)} patients fitted"
    return "; ".join([": ".join(filter(None, [fitted, ", ".join(results)])), *others])
