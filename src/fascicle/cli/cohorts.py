"""`fascicle cohort`: many patients from one table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fascicle.cli.arguments import OutOption, SchedulerOption, pool_at
from fascicle.cli.interruption import resumable
from fascicle.cli.output import NotAllDoneError, Result

if TYPE_CHECKING:
    from fascicle.patients.outcome import Outcome


def cohort(
    table: Annotated[
        Path, typer.Argument(metavar="TABLE", help="CSV file: a patient a row (docs/files.md).")
    ],
    out: OutOption,
    scheduler: SchedulerOption = None,
    only: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="Of the rows only I, I + N, I + 2N and so on: task I of N of a job array.",
        ),
    ] = None,
) -> Result:
    """Fit every patient of a table, and write a report of each and a page of all.

    The table names a heart and a recording for each, and perhaps settings:

    ```
    patient,heart,recording,effective
    anna,hearts/anna,ecg/anna.hea,
    bert,hearts/bert,targets/bert.nc,500
    ```

    What is wrong with one patient does not stop the others. Interrupt it whenever you like; the
    same command goes on where it stopped, and tries again those that failed. The exit status is 0
    if all are fitted, 1 if some are not, 2 if the table is wrong.

    Without a scheduler patients are fitted here, one after the other, on all cores; with one, each
    by a worker of a Dask cluster (docs/cluster.md).
    """
    from fascicle.cli.output import TerminalProgress
    from fascicle.patients.cohort import outcomes
    from fascicle.patients.outcome import Status
    from fascicle.patients.overview import PAGE, RESULTS

    found: list[Outcome] = []
    with resumable(out), TerminalProgress() as progress:
        cluster = pool_at(scheduler, progress)
        for outcome in outcomes(table, out, only=only, cluster=cluster, progress=progress):
            found.append(outcome)
            _print_outcome(outcome, out)
    missing = sum(outcome.status is not Status.FITTED for outcome in found)
    page = (out / PAGE).resolve()
    print(f"{len(found) - missing} of {len(found)} patients fitted")
    if missing:
        print(f"{missing} not fitted: the reasons are in {out / RESULTS}")
    print(page.as_uri())
    result = {
        "folder": out,
        "page": page,
        "patients": [outcome.model_dump(mode="json") for outcome in found],
    }
    if missing:
        raise NotAllDoneError(result)
    return result


def _print_outcome(outcome: Outcome, out: Path) -> None:
    """Print what has become of a patient; the traceback of a bug goes to the standard error."""
    from fascicle.patients.outcome import Status

    if outcome.status is Status.FITTED:
        print(f"{outcome.patient:<16} {outcome.verdict}")
        return
    print(f"{outcome.patient:<16} {outcome.status.upper()}: {outcome.reason}")
    if outcome.error_file is not None:
        print(outcome.error_file.read_text(encoding="utf-8"), file=sys.stderr)
