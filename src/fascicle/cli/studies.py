"""`fascicle study …`: what finished studies found, one or several side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fascicle.cli.arguments import StudyArgument
from fascicle.cli.output import Result, every_command
from fascicle.cli.printing import print_fit
from fascicle.core.errors import InputError

if TYPE_CHECKING:
    from fascicle.core.arrays import Floats
    from fascicle.study.fitted import FittedStudy

study_app = typer.Typer(
    no_args_is_help=True, help="Say again what finished studies found, and compare them."
)


def written_summary(folder: Path) -> dict[str, object]:
    """The summary.json that a command has written into its folder."""
    content: dict[str, object] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return content


@study_app.command("show")
@every_command
def study_show(study: StudyArgument) -> Result:
    """Print what a study is of and what it found, as 'fascicle fit' did at its end."""
    from fascicle.cli.output import TerminalProgress
    from fascicle.study.fit import load_study

    with TerminalProgress() as progress:
        fitted = load_study(study, progress)
    print(f"study                  {study}")
    print(f"heart                  {fitted.simulator.model.heart.name}")
    for number, recording in enumerate(fitted.recordings, 1):
        name = "recording" if len(fitted.recordings) == 1 else f"recording {number}"
        print(f"{name:<22} {Path(recording.target.provenance.get('source', 'in memory')).name}")
    print(f"method                 {fitted.study.config.method}, seed {fitted.study.config.seed}")
    summary = written_summary(study)
    print_fit(fitted, summary)
    return summary


@study_app.command("compare")
@every_command
def study_compare(
    studies: Annotated[
        list[Path], typer.Argument(metavar="STUDY STUDY...", help="Finished study folders.")
    ],
) -> Result:
    """Set the parameters of several studies side by side, and say where they disagree.

    Medians and 90 % of the networks. Of two studies, such as of one patient before and after a
    therapy, or by two methods, the distance of the medians is given, too, in standard deviations of
    both together.
    """
    import numpy as np

    from fascicle.cli.output import TerminalProgress
    from fascicle.study.fit import load_study

    if len(studies) < 2:
        raise InputError("give two studies or more, to be compared")
    with TerminalProgress() as progress:
        fitted = [load_study(study, progress) for study in studies]
    for number, (folder, each) in enumerate(zip(studies, fitted, strict=True), 1):
        print(f"{number}  {folder}: {each.verdict}")
    values = [_parameters(each) for each in fitted]
    names = list(dict.fromkeys(name for each in values for name in each))
    two = len(studies) == 2
    headings = [f"{number}" for number in range(1, len(studies) + 1)]
    print(f"{'':<24}" + "".join(f"{h:<26}" for h in headings) + ("apart (sd)" if two else ""))
    rows: dict[str, list[list[float] | None]] = {}
    apart: dict[str, float] = {}
    for name in names:
        rows[name] = [
            np.percentile(each[name], [50, 5, 95]).tolist() if name in each else None
            for each in values
        ]
        text = "".join(f"{_cell(row):<26}" for row in rows[name])
        if two and all(row is not None for row in rows[name]):
            apart[name] = _apart(values[0][name], values[1][name])
            text += f"{apart[name]:.1f}"
        print(f"{name:<24}{text}".rstrip())
    print("medians (90 % of the networks)")
    return {
        "studies": [
            {"folder": folder, "verdict": each.verdict, "best_loss_mV2": each.population.best_loss}
            for folder, each in zip(studies, fitted, strict=True)
        ],
        "median_5_95_%": rows,
        "standard_deviations_apart": apart,
    }


def _parameters(fitted: FittedStudy) -> Mapping[str, Floats]:
    """What the networks say of each parameter; nothing where that is not to be trusted."""
    from fascicle.study.population import Posterior

    population = fitted.population
    if not len(population) or (isinstance(population, Posterior) and not population.converged):
        return {}
    return population.values


def _cell(row: list[float] | None) -> str:
    if row is None:
        return "-"
    middle, low, high = (f"{value:.3g}" for value in row)
    return f"{middle} ({low} to {high})"


def _apart(one: Floats, other: Floats) -> float:
    """Distance of the medians in standard deviations of both."""
    import numpy as np

    spread = float(np.hypot(one.std(), other.std()))
    distance = abs(float(np.median(one) - np.median(other)))
    return distance / spread if spread else float("inf") if distance else 0.0
