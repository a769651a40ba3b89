"""The report: one HTML file that opens offline."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from fascicle.core.errors import InputError
from fascicle.core.files import as_path, check_writable, write_text
from fascicle.core.leads import LEADS
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_text
from fascicle.forward.scenario import Scenario
from fascicle.heart.sites import SEGMENTS
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import (
    INTRINSIC,
    as_scenarios,
    check_population,
    predict,
    with_intrinsic_beat,
)
from fascicle.reporting.indices import SHOWN
from fascicle.reporting.names import MEASURES, index_label, parameter_name
from fascicle.reporting.page.answers import answers
from fascicle.reporting.page.commands import commands
from fascicle.reporting.page.inputs import digests, held, learnt, recordings, settings
from fascicle.reporting.page.scene import scene
from fascicle.reporting.study import Drawing, check_kinds, drawings, write_figures
from fascicle.study.agreement import Agreement
from fascicle.study.fit import GivenStudy, as_study
from fascicle.study.fitted import FittedStudy
from fascicle.study.population import Posterior
from fascicle.study.target_comparison import Network

RESOLUTION, COLOURS = 110, 256  # of pictures in the page; dots per inch
PACINGS = ("his-pacing", "left-bundle-branch-pacing", "biventricular-pacing")


@dataclass(frozen=True)
class Picture:
    """A figure in the page.

    Attributes
    ----------
    source : str
        The picture itself, as a data URL.
    text : str
        What it shows.
    leads : list of (lead, explained power, correlation)
        Of an ECG, in words.
    measured : list of (name, recorded, of the networks)
        Durations and axis of an ECG, in words.
    of_networks : bool
        As of `Drawing`.
    """

    source: str
    text: str
    leads: list[tuple[str, str, str]] = field(default_factory=list)
    measured: list[tuple[str, str, str]] = field(default_factory=list)
    of_networks: bool = True

    @classmethod
    def of(cls, drawing: Drawing) -> Picture:
        """Draw a figure into a page, in so many colours that it takes a third of the room."""
        drawn, content = io.BytesIO(), io.BytesIO()
        drawing.figure.savefig(drawn, format="png", dpi=RESOLUTION)
        colours = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        colours.save(content, format="PNG", optimize=True)
        encoded = base64.b64encode(content.getvalue()).decode("ascii")
        leads, measured = ([], []) if drawing.agreement is None else _agreed(drawing.agreement)
        source = f"data:image/png;base64,{encoded}"
        return cls(source, drawing.text, leads, measured, drawing.of_networks)


def _agreed(found: Agreement) -> tuple[list[tuple[str, str, str]], list[tuple[str, str, str]]]:
    """Rows of the two tables below an ECG."""
    pairs = [*zip(LEADS, found.explained, found.correlation, strict=True)]
    pairs.append(("all together", found.explained_over_all, found.correlation_over_all))
    leads = [(name, f"{e:.0%}", f"{r:.2f}") for name, e, r in pairs if np.isfinite(r)]
    measured = []
    for key, measure in MEASURES.items():
        if key in found.recorded:
            low, middle, high = found.percentiles(key)
            recorded = f"{found.recorded[key]:.0f} {measure.unit}"
            networks = f"{middle:.0f} ({low:.0f} to {high:.0f}) {measure.unit}"
            measured.append((str(measure), recorded, networks))
    return leads, measured


def report(
    fitted: GivenStudy,
    scenarios: Mapping[str, Scenario] | Sequence[str | Path] | str | Path = PACINGS,
    out: Path | str | None = None,
    progress: Progress | Lines | None = "lines",
    figures: Sequence[str] = (),
    against: str = INTRINSIC,
) -> list[Path]:
    """Write a study and what scenarios do in its networks as one HTML file.

    Parameters
    ----------
    fitted : FittedStudy or path
        The study, or its folder.
    scenarios : mapping of name to Scenario, or one or several of str or Path
        What to predict, as `fascicle.predict` takes it; the intrinsic beat is always among them.
    out : Path or str, optional
        File to write; ``report.html`` in the study.
    progress : Progress, "lines" or None
        Called with how many networks are simulated; by default lines on standard error say so.
    figures : sequence of str
        Also write the figures, as ``"png"``, ``"svg"`` or ``"pdf"``, into the folder ``figures``
        beside it.
    against : str
        The scenario that the others are compared with, if not the intrinsic beat.

    Returns
    -------
    list of Path
        The report, and then the figures.

    Raises
    ------
    InputError
        If the study has no network, a scenario is not there or does not fit its heart, or `against`
        is none of them.
    """
    fitted = as_study(fitted, progress)
    check_population(fitted)
    check_kinds(figures)
    scenarios = with_intrinsic_beat(as_scenarios(scenarios))
    check_text(against, "against")
    if against not in scenarios:
        raise InputError(
            f"'{against}', which others are to be compared with, is none of the scenarios "
            f"{', '.join(scenarios)}; add it to them (--scenario {against})"
        )
    out = as_path(out, "out") if out is not None else fitted.folder / "report.html"
    check_writable(out)
    with shown_progress(progress) as shown:
        networks = fitted.networks(shown)
        predicted = predict(fitted, scenarios, shown, networks)
    return write_report(fitted, networks, predicted, out, figures, against)


def write_report(
    fitted: FittedStudy,
    networks: Sequence[Network],
    predicted: Mapping[str, Predicted],
    out: Path,
    figures: Sequence[str] = (),
    against: str = INTRINSIC,
) -> list[Path]:
    """Write the report of what is simulated already.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    networks : sequence of Network
        Its population, simulated.
    predicted : mapping of name to Predicted
        Scenarios over it, the intrinsic beat first.
    out : Path
        File to write.
    figures : sequence of str
        As of `report`, which says what is returned, too.
    against : str
        The scenario that the others are compared with, if not the intrinsic beat.
    """
    drawn = drawings(fitted, networks, predicted)
    content = {
        **_words(fitted, predicted, against),
        "pictures": {name: Picture.of(drawing) for name, drawing in drawn.items()},
        "scene": _safe(scene(fitted.simulator.model.heart, predicted)),
        "style": _file("style.css"),
        "viewer": _file("viewer.js"),
    }
    write_text(out, _template().render(content))
    return [
        out,
        *write_figures(drawn, out.parent / "figures", figures, fitted.statements.caution_text),
    ]


def _words(fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str) -> dict[str, Any]:
    from fascicle import __version__

    said, config = answers(fitted, predicted, against), fitted.study.config
    sources = [p.target.provenance.get("source", "a target") for p in fitted.recordings]
    names = [Path(source).name for source in sources]
    return {
        "version": __version__,
        "title": f"What the ECG tells of the Purkinje network: {fitted.folder.resolve().name}",
        "heart": fitted.simulator.model.heart.name,
        "recordings": ", ".join(names),
        "answers": said,
        "predictions": list(zip(predicted, said.predicted, strict=True)),
        "measures": [each for each in MEASURES.values() if each.meaning],
        "columns": [index_label(index) for index in SHOWN],
        "rows": [_row(name, found) for name, found in predicted.items()],
        "convergence": _convergence(fitted),
        "learnt": learnt(config),
        "held": held(fitted),
        "inputs": [*settings(config).items(), *recordings(fitted), *digests(config)],
        "commands": "\n".join(commands(fitted, predicted, against)),
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
    prior, effective = fitted.study.config.prior_simulations, population.effective.sum()
    return [
        f"{count} evaluations in two runs, {prior} of them of the prior; effective sample "
        f"{effective:.0f}.",
        f"Log evidence {one:.1f} and {other:.1f}. The means of {parameter_name(name)} are "
        f"furthest apart: {apart:.2f} standard deviations, where 0.5 is allowed.",
    ]


def _template() -> Any:
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["named"] = parameter_name
    return environment.from_string(str(_file("page.html")))


def _file(name: str) -> Any:
    """A file of the page, which is inserted as it is."""
    from markupsafe import Markup

    return Markup((files("fascicle") / "reporting" / "page" / name).read_text(encoding="utf-8"))


def _safe(content: Mapping[str, Any]) -> Any:
    """JSON that no browser takes for the end of its script."""
    from markupsafe import Markup

    return Markup(json.dumps(content, allow_nan=False).replace("<", "\\u003c"))
