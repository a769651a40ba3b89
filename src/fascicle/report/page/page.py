"""The report: one HTML file that opens offline."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fascicle.core.files import write_text
from fascicle.core.progress import Progress
from fascicle.forward.scenario import Scenario
from fascicle.heart.segments import SEGMENTS
from fascicle.predict.indices import INDICES
from fascicle.predict.scenarios import OWN_BEAT, Predicted, predict, with_own_beat
from fascicle.report.convergence import convergence_figure
from fascicle.report.indices import SHOWN, index_figure, index_name
from fascicle.report.page.answers import answers
from fascicle.report.page.scene import scene
from fascicle.report.pairs import pair_figure
from fascicle.report.priors import prior_figure
from fascicle.report.study import check_population, recorded_ecg_figure
from fascicle.study.population import Posterior
from fascicle.study.results import FittedStudy

RESOLUTION = 110  # dots per inch of pictures in the page
PACINGS = ("his-pacing", "left-bundle-pacing", "biventricular-pacing")


@dataclass(frozen=True)
class Picture:
    """A figure in the page.

    Attributes
    ----------
    source : str
        The picture itself, as a data URL.
    text : str
        What it shows.
    """

    source: str
    text: str

    @classmethod
    def of(cls, figure: Figure, text: str) -> Picture:
        """Draw a figure into a page."""
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=RESOLUTION)
        encoded = base64.b64encode(content.getvalue()).decode("ascii")
        return cls(f"data:image/png;base64,{encoded}", text)


def write_report(
    fitted: FittedStudy,
    scenarios: Mapping[str, Scenario],
    out: Path,
    progress: Progress | None = None,
) -> Path:
    """Write a study and what scenarios do in its networks as one HTML file.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    scenarios : mapping of name to Scenario
        What to predict; the own beat is always among them.
    out : Path
        File to write.
    progress : Progress, optional
        Called after each network that is simulated.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the study has no network, or a scenario does not fit its heart.
    """
    check_population(fitted)
    networks = fitted.networks(progress)
    predicted = predict(fitted.problem, networks, with_own_beat(scenarios), progress)
    content = {
        **_words(fitted, predicted),
        **_pictures(fitted, predicted, networks),
        "scene": _safe(scene(fitted.problem.model.heart, predicted)),
        "style": _file("style.css"),
        "viewer": _file("viewer.js"),
    }
    write_text(out, _template().render(content))
    return out


def _words(fitted: FittedStudy, predicted: Mapping[str, Predicted]) -> dict[str, Any]:
    from fascicle import __version__

    said = answers(fitted, predicted)
    sources = [p.target.provenance.get("source", "a target") for p in fitted.problem.recordings]
    names = [Path(source).name for source in sources]
    return {
        "version": __version__,
        "title": f"What the ECG tells of the Purkinje network: {fitted.folder.resolve().name}",
        "heart": fitted.problem.model.heart.name,
        "recordings": ", ".join(names),
        "answers": said,
        "predictions": list(zip(predicted, said.predicted, strict=True)),
        "columns": [f"{index_name(index)} ({INDICES[index]})" for index in SHOWN],
        "rows": [_row(name, found) for name, found in predicted.items()],
        "convergence": _convergence(fitted),
        "inputs": _inputs(fitted),
        "command": _command(fitted, predicted),
    }


def _row(name: str, found: Predicted) -> dict[str, Any]:
    cells = []
    for index in SHOWN:
        low, middle, high = np.nanpercentile(found.indices[index], [5, 50, 95])
        cells.append(f"{middle:.0f} ({low:.0f} to {high:.0f})")
    numbers, counts = np.unique(found.indices["latest_segment"].astype(int), return_counts=True)
    most = int(np.argmax(counts))
    share = counts[most] / counts.sum()
    return {"name": name, "cells": cells, "latest": f"{SEGMENTS[numbers[most] - 1]} ({share:.0%})"}


def _convergence(fitted: FittedStudy) -> list[str]:
    population, count = fitted.population, len(fitted.study.records())
    if not isinstance(population, Posterior):
        return [f"{count} evaluations; the least mismatch is {population.best_loss:.3f} mV²."]
    one, other = population.log_evidences
    name, apart = max(population.means_apart.items(), key=lambda item: item[1])
    bank, effective = fitted.study.config.bank, population.effective.sum()
    return [
        f"{count} evaluations in two runs, {bank} of them of the prior; effective sample "
        f"{effective:.0f}.",
        f"Log evidence {one:.1f} and {other:.1f}. The means of {name.replace('_', ' ')} are "
        f"furthest apart: {apart:.2f} standard deviations, where 0.5 is allowed.",
    ]


def _inputs(fitted: FittedStudy) -> list[tuple[str, str]]:
    config = fitted.study.config
    settings = config.model_dump(exclude={"space", "fixed", "growth", "conduction", "scenarios"})
    learnt = "; ".join(
        f"{p.name} {p.lower:g} to {p.upper:g}" + ("" if p.unit == "1" else f" {p.unit}")
        for p in config.space
    )
    rows = [("learnt, with the ranges of the priors", learnt)]
    rows += [
        (p.target.provenance.get("source", "recording"), _of_target(p.target.provenance))
        for p in fitted.problem.recordings
    ]
    rows += [(name.replace("_", " "), str(value)) for name, value in settings.items()]
    for group in ("fixed", "growth", "conduction"):
        held = getattr(config, group)
        rows.append((group, ", ".join(f"{name} {value}" for name, value in held.items())))
    return [(name, value) for name, value in rows if value not in ("", "None", "()")]


def _of_target(provenance: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in provenance.items() if name != "source")


def _command(fitted: FittedStudy, predicted: Mapping[str, Predicted]) -> str:
    asked = "".join(f" --scenario {name}" for name in predicted if name != OWN_BEAT)
    return f"fascicle report {fitted.folder.name}{asked}"


def _pictures(
    fitted: FittedStudy, predicted: Mapping[str, Predicted], networks: list[Any]
) -> dict[str, Any]:
    population, problem = fitted.population, fitted.problem
    records = fitted.study.records()
    ecgs = [
        Picture.of(
            recorded_ecg_figure(fitted, number, networks if number == 0 else None),
            "Recorded beats and what the networks predict: means and bands. Time counts from the "
            "R peak; a fine square is 40 ms."
            + (f" Recording {number + 1}." if len(problem.recordings) > 1 else ""),
        )
        for number in range(len(problem.recordings))
    ]
    losses = convergence_figure(
        np.array([record.evaluation.loss for record in records]),
        [record.stage for record in records],
    )
    return {
        "ecgs": ecgs,
        "indices": Picture.of(
            index_figure({name: found.indices for name, found in predicted.items()}),
            "Medians, and what half (thick) and 90 % (thin) of the networks span.",
        ),
        "priors": Picture.of(
            prior_figure(problem.space, population.values),
            "What was thought before (grey lines) and the networks (orange).",
        ),
        "pairs": Picture.of(
            pair_figure(problem.space, population.values, population.best),
            "Pairs of parameters on the whole ranges of their priors.",
        ),
        "losses": Picture.of(losses, "Mismatch of every evaluation, in the order they were made."),
    }


def _template() -> Any:
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["words"] = lambda name: name.replace("_", " ")
    return environment.from_string(str(_file("page.html")))


def _file(name: str) -> Any:
    """A file of the page, which is inserted as it is."""
    from markupsafe import Markup

    return Markup((files("fascicle") / "report" / "page" / name).read_text(encoding="utf-8"))


def _safe(content: Mapping[str, Any]) -> Any:
    """JSON that no browser takes for the end of its script."""
    from markupsafe import Markup

    return Markup(json.dumps(content, allow_nan=False).replace("</", "<\\/"))
