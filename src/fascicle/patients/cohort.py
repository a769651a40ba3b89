"""Fit every patient of a table, here or on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fascicle.core.errors import InputError
from fascicle.core.files import as_path, check_writable
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_text
from fascicle.core.threads import cores
from fascicle.patients.outcome import Outcome, Status
from fascicle.patients.overview import PAGE, RESULTS, write_overview
from fascicle.patients.patient import PATIENTS, STUDIES, Patient, check, fit_patient
from fascicle.patients.table import part_of, read_table
from fascicle.study.lock import HeldError
from fascicle.study.pool import Threads, check_pool

if TYPE_CHECKING:
    from fascicle.study.cluster import Cluster

STAGE = "patients"


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
    if only is not None:
        check_text(only, "only")
    with shown_progress(progress) as shown:
        return list(outcomes(table, out, only=only, cluster=cluster, progress=shown))


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
    patients = [Patient(row, folder) for row in read_table(table)]
    mine = part_of(patients, only)
    check_cohort_folder(folder)
    try:
        refused = {patient.name: check(patient) for patient in mine}
        yield from (outcome for outcome in refused.values() if outcome is not None)
        for outcome in _fitted([p for p in mine if refused[p.name] is None], cluster, progress):
            write_overview(folder, table, patients)
            yield outcome
    finally:
        write_overview(folder, table, patients)


def check_cohort_folder(folder: Path) -> None:
    """Refuse a folder that is no cohort and cannot become one.

    Raises
    ------
    InputError
        If it is a file, holds something else, or cannot be written.
    """
    check_writable(folder / PAGE)
    own = (PATIENTS, STUDIES, PAGE, RESULTS)
    foreign = [path.name for path in folder.iterdir() if path.name not in own]
    if foreign and not (folder / PATIENTS).is_dir():
        raise InputError(
            f"{folder}: holds '{foreign[0]}' and is no cohort; give another folder (--out)"
        )


def _fitted(
    patients: Sequence[Patient], cluster: Cluster | None, progress: Progress | None
) -> Iterator[Outcome]:
    """Fit patients, and say how many are done."""
    finished = [patient for patient in patients if patient.outcome.status is Status.FITTED]
    ordered = [*finished, *(patient for patient in patients if patient not in finished)]
    done = 0

    def report(message: str) -> None:
        # not before: the time that finished ones take says nothing of the time that is left
        if progress is not None and done >= len(finished):
            progress(STAGE, done, len(patients), message)

    for outcome in _outcomes(ordered, cluster, report, progress):
        done += 1
        report("")
        yield outcome


def _outcomes(
    patients: Sequence[Patient],
    cluster: Cluster | None,
    report: Callable[[str], None],
    progress: Progress | None,
) -> Iterator[Outcome]:
    """Fit patients on workers, or one after the other here."""
    if cluster is not None:
        from fascicle.patients.workers import fit_on_workers

        yield from fit_on_workers(cluster, patients, report)
        return
    pool = Threads(cores())
    for patient in patients:
        report(patient.name)
        try:
            yield fit_patient(patient, pool, progress)
        except HeldError as error:
            yield Outcome(patient=patient.name, status=Status.NOT_DONE, reason=str(error))
