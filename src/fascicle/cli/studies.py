"""`fascicle study …`: results of finished studies; `fascicle cohort`: many patients at once."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

import fascicle
from fascicle.cli import resumable
from fascicle.cli.options import OutOption, SchedulerOption, StudyArgument, pool_at
from fascicle.cli.output import (
    NotAllDoneError,
    Result,
    TerminalProgress,
    every_command,
    print_row,
    print_table,
)
from fascicle.core.errors import InputError

if TYPE_CHECKING:
    from fascicle.core.arrays import Floats
    from fascicle.patients.patient import Outcome

study_app = typer.Typer(
    no_args_is_help=True, help="Show the results of finished studies, compare and export them."
)


def written_summary(folder: Path) -> dict[str, object]:
    """The summary.json that a command has written into its folder."""
    content: dict[str, object] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return content


@study_app.command("show")
@every_command
def study_show(study: StudyArgument) -> Result:
    """Print the inputs and the results of a study, as 'fascicle fit' did at its end."""
    from fascicle.cli.printing import print_fit

    with TerminalProgress() as progress:
        fitted = fascicle.load_study(study, progress)
    print_row("study", study)
    print_row("heart", fitted.simulator.model.heart.name)
    for number, recording in enumerate(fitted.recordings, 1):
        name = "recording" if len(fitted.recordings) == 1 else f"recording {number}"
        print_row(name, Path(recording.target.provenance.get("source", "in memory")).name)
    print_row("method", f"{fitted.study.config.method}, seed {fitted.study.config.seed}")
    summary = written_summary(study)
    print_fit(fitted, summary)
    return summary


@study_app.command("compare")
@every_command
def study_compare(
    studies: Annotated[
        list[Path], Argument(metavar="STUDY STUDY...", help="Finished study folders.")
    ],
) -> Result:
    """Compare the parameters of several studies, and show where they disagree.

    Medians and 90 % of the networks. For two studies, such as of one patient before and after a
    therapy, or by two methods, also the distance of the medians, in standard deviations of both
    together.
    """
    import numpy as np

    from fascicle.cli.printing import interval
    from fascicle.core.quantities import quantity
    from fascicle.reporting.names import parameter_label
    from fascicle.study.population import Posterior

    if len(studies) < 2:
        raise InputError("give two or more studies to compare")
    with TerminalProgress() as progress:
        fitted = [fascicle.load_study(study, progress) for study in studies]
    for number, (folder, study) in enumerate(zip(studies, fitted, strict=True), 1):
        print(f"{number}  {folder}: {study.verdict}")
    values: list[Mapping[str, Floats]] = []
    for study in fitted:
        posterior = study.population if isinstance(study.population, Posterior) else None
        reliable = len(study.population) and (posterior is None or posterior.converged)
        values.append(study.population.values if reliable else {})
    lines = [["", *map(str, range(1, len(studies) + 1)), ""]]
    rows: dict[str, list[Any]] = {}
    apart: dict[str, float] = {}
    for name in dict.fromkeys(name for parameters in values for name in parameters):
        samples = [parameters.get(name) for parameters in values]
        rows[name] = [s if s is None else np.percentile(s, [50, 5, 95]) for s in samples]
        label = parameter_label(name, quantity(name).unit)
        line = [label, *("-" if s is None else interval(s, ".3g") for s in samples), ""]
        first, second, *further = samples
        if first is not None and second is not None and not further:
            distance, both = abs(np.median(first) - np.median(second)), (first.std(), second.std())
            with np.errstate(divide="ignore"):
                apart[name] = float(distance / np.hypot(*both)) if distance else 0.0
            line[-1] = f"{apart[name]:.1f}"
            lines[0][-1] = "apart (SD)"
        lines.append(line)
    print_table(lines)
    print("medians (90 % of the networks)")
    of_each = [
        {"folder": folder, "verdict": study.verdict, "best_loss_mV2": study.population.best_loss}
        for folder, study in zip(studies, fitted, strict=True)
    ]
    return {"studies": of_each, "median_5_95_%": rows, "standard_deviations_apart": apart}


@study_app.command("export")
@every_command
def study_export(
    study: StudyArgument,
    out: OutOption,
    kind: Annotated[
        Literal["opencarp", "vtu", "csv"],
        Option("--format", help="openCARP in µm, VTU and CSV in mm ('fascicle docs exchange')."),
    ] = "opencarp",
    networks: Annotated[
        int | None,
        Option(
            min=1,
            help="Networks to write, evenly spread over the population; by default the one whose "
            "activation map is nearest to the median map.",
        ),
    ] = None,
) -> Result:
    """Write networks, junctions, stimuli and activation times for openCARP, ParaView or tables.

    For openCARP each network has parameter files: 'cd OUT/NUMBER; openCARP +F eikonal.par'. The
    tables give simulators of mechanics the activation time of each node.
    """
    with TerminalProgress() as progress:
        summary = fascicle.load_study(study, progress).export(out, kind, networks, progress)
    if summary["caution"] is not None:
        print_row("caution", summary["caution"])
    count = len(summary["networks"])
    print_row("networks", f"{count} of {summary['population']}, {summary['chosen']}")
    print(f"written to {out}")
    return {"folder": out, "format": kind} | summary


def cohort(
    table: Annotated[
        Path, Argument(metavar="TABLE", help="CSV file: a patient a row ('fascicle docs files').")
    ],
    out: OutOption,
    scheduler: SchedulerOption = None,
    only: Annotated[
        str | None,
        Option(
            metavar="I/N",
            help="Fit only rows I, I + N, I + 2N and so on: task I of N of a job array.",
        ),
    ] = None,
) -> Result:
    """Fit every patient of a table, and write a report for each and a page for all.

    The table names a heart and a recording for each, and optionally settings:

    ```
    patient,heart,recording,effective
    anna,hearts/anna,ecg/anna.hea,
    bert,hearts/bert,targets/bert.nc,500
    ```

    An error in one patient does not stop the others. The command may be interrupted at any time;
    run again, it continues where it stopped and retries those that failed. The exit status is 0
    if all are fitted, 1 if some are not, 2 if the table is wrong.

    Without a scheduler patients are fitted here, one after the other, on all cores; with one, each
    by a worker of a Dask cluster ('fascicle docs cluster').
    """
    from fascicle.patients.cohort import outcomes
    from fascicle.patients.patient import CohortPart, Status

    patient_outcomes: list[Outcome] = []
    with resumable(out), TerminalProgress() as progress:
        cluster = pool_at(scheduler, progress)
        for outcome in outcomes(table, out, only=only, cluster=cluster, progress=progress):
            patient_outcomes.append(outcome)
            fitted = outcome.status is Status.FITTED
            text = outcome.verdict if fitted else f"{outcome.status.upper()}: {outcome.reason}"
            print(f"{outcome.patient:<16} {text}")
            if outcome.error_file is not None:
                print(outcome.error_file.read_text(encoding="utf-8"), file=sys.stderr)
    missing = sum(outcome.status is not Status.FITTED for outcome in patient_outcomes)
    page = (out / CohortPart.PAGE).resolve()
    print(f"{len(patient_outcomes) - missing} of {len(patient_outcomes)} patients fitted")
    if missing:
        print(f"{missing} not fitted: the reasons are in {out / CohortPart.RESULTS}")
    print(page.as_uri())
    patients = [outcome.model_dump(mode="json") for outcome in patient_outcomes]
    result = {"folder": out, "page": page, "patients": patients}
    if missing:
        raise NotAllDoneError(result)
    return result
