"""The report: one HTML file that opens offline."""

from __future__ import annotations

import base64
import io
import json
import textwrap
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment
from markupsafe import Markup
from matplotlib.figure import Figure
from PIL import Image

from fascicle.core import VERSION
from fascicle.core.errors import InputError
from fascicle.core.files import as_path, check_replaceable, write_text
from fascicle.core.progress import Lines, Progress, shown_progress, stage_progress
from fascicle.core.quantities import parameter_name
from fascicle.core.ranges import check_kind, check_text
from fascicle.forward.scenario import Scenario
from fascicle.networks.agreement import Agreement
from fascicle.networks.target_comparison import Network
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import (
    INTRINSIC,
    as_scenarios,
    check_population,
    predict,
    with_intrinsic_beat,
)
from fascicle.reporting.names import MEASURES, index_label, scenario_name
from fascicle.reporting.page import content as words
from fascicle.reporting.page.scene import scene
from fascicle.reporting.prediction import SHOWN, latest_segments
from fascicle.reporting.study import Drawing, drawings, write_figures
from fascicle.reporting.style import check_kinds, new_figure, save
from fascicle.study.fitted import FittedStudy, StudyLike, as_study
from fascicle.study.population import Posterior

PACINGS = ("his-pacing", "left-bundle-branch-pacing", "biventricular-pacing")


def report(
    fitted: StudyLike,
    scenarios: Mapping[str, Scenario] | Sequence[str | Path] | str | Path = PACINGS,
    out: Path | str | None = None,
    progress: Progress | Lines | None = "lines",
    figures: Sequence[str] = (),
    against: str = INTRINSIC,
    pdf: bool = False,
) -> list[Path]:
    """Write a study and its predicted scenarios as one HTML file.

    Parameters
    ----------
    fitted : FittedStudy or path
        The study, or its folder.
    scenarios : mapping of name to Scenario, or one or several of str or Path
        Scenarios to predict, as `fascicle.predict` takes them; the intrinsic beat is always added.
    out : Path or str, optional
        File to write; ``report.html`` in the study.
    progress : Progress, "lines" or None
        Progress callback with the number of simulated networks; by default lines on stderr.
    figures : sequence of str
        Also write the figures, as ``"png"``, ``"svg"`` or ``"pdf"``, into the folder ``figures``
        next to it.
    against : str
        The scenario that the others are compared with, if not the intrinsic beat.
    pdf : bool
        Also write the answer, the ECG and the activation on one page next to it, as PDF.

    Returns
    -------
    list of Path
        The report, its page as PDF, and then the figures.

    Raises
    ------
    InputError
        If the study has no network, a scenario does not exist or does not fit the heart, or
        `against` is not one of the scenarios.
    """
    check_kinds(figures)
    check_kind(pdf, bool, "pdf", "True or False")
    fitted = as_study(fitted, progress)
    check_population(fitted)
    scenarios = with_intrinsic_beat(as_scenarios(scenarios))
    check_text(against, "against")
    if against not in scenarios:
        raise InputError(
            f"'{against}', with which the others are to be compared, is not one of the scenarios "
            f"{', '.join(scenarios)}; add it to them (--scenario {against})"
        )
    out = as_path(out, "out") if out is not None else fitted.folder / "report.html"
    if out.suffix.lower() != ".html":
        raise InputError(f"{out}: the report is a page; give a name such as report.html (--out)")
    for path in (out, out.with_suffix(".pdf"))[: 1 + pdf]:
        check_replaceable(path)
    with shown_progress(progress) as shown:
        networks = fitted.networks(shown)
        predicted = predict(fitted, scenarios, shown, networks)
        return write_report(fitted, networks, predicted, out, figures, against, shown, pdf)


def write_report(
    fitted: FittedStudy,
    networks: Sequence[Network],
    predicted: Mapping[str, Predicted],
    out: Path,
    figures: Sequence[str] = (),
    against: str = INTRINSIC,
    progress: Progress | None = None,
    pdf: bool = False,
) -> list[Path]:
    """Write the `report` of a population and of scenarios over it, the intrinsic beat first."""
    drawn, model = drawings(fitted, networks, predicted), fitted.simulator.model
    shown, pictures = stage_progress(progress, "report"), dict[str, dict[str, Any]]()
    for name, drawing in drawn.items():
        shown(len(pictures), len(drawn))
        pictures[name] = picture(drawing)
    shown(len(drawn), len(drawn))
    content = {
        **_content(fitted, predicted, against),
        "criteria": [recording.target.conventional_criteria for recording in fitted.recordings],
        "pictures": pictures,
        "scene": _safe(scene(model.heart, predicted, networks, fitted.recordings[0], model)),
        "style": _file("style.css"),
        "viewer": _file("viewer.js"),
    }
    files = write_figures(drawn, out.parent / "figures", figures)
    write_text(out, _template().render(content))
    if pdf:
        files.insert(0, save(one_page(content), out.with_suffix(".pdf")))
    return [out, *files]


def one_page(content: Mapping[str, Any]) -> Figure:
    """A4 page with the beginning of the report: answer, warnings, ECG and activation."""
    figure = new_figure(8.27, 11.69)
    parts: Any = figure.subfigures(3, 1, height_ratios=(4, 4, 3))
    predictions = (f"{name}: {sentence}" for name, sentence in content["predictions"])
    paragraphs = [
        f"Purkinje network of the heart “{content['heart']}”, learnt from "
        f"{', '.join(content['recordings'])}. Research software: not for clinical decisions.",
        content["verdict"], *map(str, content["warnings"]), *predictions,
        f"Medians, with the range of 90 % of the networks in brackets. fascicle "
        f"{content['version']}, study {content['study']}.",
    ]  # fmt: skip
    height = 0.95
    for number, paragraph in enumerate(paragraphs):
        weight, width = ("bold", 90) if number == 1 else ("normal", 105)
        text = textwrap.fill(paragraph, width)
        parts[0].text(0.05, height, text, va="top", fontsize=9.5, weight=weight, parse_math=False)
        height -= (text.count("\n") + 1.6) / 26
    for part, name in zip(parts[1:], ("ecg", "activation"), strict=True):
        source = content["pictures"][name]["source"].partition(",")[2]
        axes = part.subplots()
        axes.imshow(Image.open(io.BytesIO(base64.b64decode(source))).convert("RGB"))
        axes.axis("off")
    return figure


def picture(drawing: Drawing) -> dict[str, Any]:
    """A figure for the page, with its numbers: a data URL of 256 colours, a third of the size."""
    drawn, content = io.BytesIO(), io.BytesIO()
    drawing.figure.savefig(drawn, format="png", dpi=110)
    colours = Image.open(drawn).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    colours.save(content, format="PNG", optimize=True)
    encoded = base64.b64encode(content.getvalue()).decode("ascii")
    numbers = {} if drawing.agreement is None else _numbers(drawing.agreement)
    return {"source": f"data:image/png;base64,{encoded}", "text": drawing.text, **numbers}


def _numbers(agreement: Agreement) -> dict[str, Any]:
    """Variance explained and correlation of each lead; durations and axis with percentiles."""
    leads = [*zip(agreement.leads, agreement.explained, agreement.correlation, strict=True)]
    leads.append(("all together", agreement.explained_over_all, agreement.correlation_over_all))
    return {
        "leads": [lead for lead in leads if np.isfinite(lead[2])],
        "measured": [
            (measure, agreement.recorded[key], agreement.percentiles(key))
            for key, measure in MEASURES.items()
            if key in agreement.recorded
        ],
    }


def _content(
    fitted: FittedStudy, predicted: Mapping[str, Predicted], against: str
) -> dict[str, Any]:
    config, statements, population = fitted.study.config, fitted.statements, fitted.population
    apart = population.means_apart if isinstance(population, Posterior) else {}
    furthest = max(apart.items(), key=lambda item: item[1], default=None)
    sources = [p.target.provenance.get("source", "a target") for p in fitted.recordings]
    return {
        "version": VERSION,
        "study": fitted.folder.resolve().name,
        "heart": fitted.simulator.model.heart.name,
        "recordings": [Path(source).name for source in sources],
        "verdict": statements.verdict,
        "trustworthy": statements.converged and statements.acceptable and not statements.unmapped,
        "caution": statements.caution,
        "in_torsos": fitted.torsos is not None,
        "meaning": words.meaning(fitted),
        "sequence": statements.sequence,
        "warnings": statements.warnings,
        "constrained": [p for p in statements.parameters if p.constrained],
        "unidentifiable": [p for p in statements.parameters if not p.constrained],
        "correlated": statements.correlated,
        "predictions": [
            (scenario_name(name), words.prediction(name, predicted, against, statements.caution))
            for name in predicted
        ],
        "columns": [index_label(index) for index in SHOWN],
        # percentiles of the indices, and the segment most often activated last
        "rows": [
            (
                scenario_name(name),
                [np.nanpercentile(prediction.indices[index], [5, 50, 95]) for index in SHOWN],
                next(iter(latest_segments(prediction).items())),
            )
            for name, prediction in predicted.items()
        ],
        "evaluations": len(fitted.study.records()),
        "population": population,
        "furthest": furthest,  # parameter by which the two runs differ most, and how many SD
        "prior_simulations": fitted.prior_simulations,
        "learnt": words.learnt(config),
        "held": words.held(fitted),
        "inputs": [
            *words.settings(config).items(),
            *words.recordings(fitted),
            *words.hearts(fitted),
            ("heart (SHA-256)", config.heart),
            ("target (SHA-256)", ", ".join((config.target, *config.other_targets))),
        ],
        "commands": words.commands(fitted, predicted, against),
    }


def _template() -> Any:
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["named"] = parameter_name
    return environment.from_string(str(_file("page.html")))


def _file(name: str) -> Any:
    """A file of the page, inserted unescaped."""
    return Markup((files("fascicle") / "reporting" / "page" / name).read_text(encoding="utf-8"))


def _safe(content: Mapping[str, Any]) -> Any:
    """JSON that cannot end the script that holds it."""
    return Markup(json.dumps(content, allow_nan=False).replace("<", "\\u003c"))
