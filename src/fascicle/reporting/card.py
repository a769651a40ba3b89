"""Cards by which notebooks show objects: facts with units, and a picture."""

from __future__ import annotations

import base64
import io
from functools import singledispatch
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats
from fascicle.core.quantities import quantity
from fascicle.forward.beat import Beat
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.predicted import Predicted
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.recording.target import Target
from fascicle.reporting.activation import draw_tree
from fascicle.reporting.ecg import target_figure
from fascicle.reporting.heart import draw_heart
from fascicle.reporting.names import index_label, parameter_label
from fascicle.reporting.parameters import prior_figure
from fascicle.reporting.prediction import prediction_ecg_figure, simulated_ecg_figure
from fascicle.reporting.style import one_axes
from fascicle.study.fitted import FittedStudy

Facts = tuple[dict[str, object], Figure]


def card(shown: object) -> str:
    """HTML view of an object: a table of facts with a picture."""
    facts, figure = _facts(shown)
    rows = "".join(
        f'<tr><th scope="row" style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left;overflow-wrap:anywhere">{escape(str(fact))}</td></tr>'
        for name, fact in facts.items()
    )
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=80)
    content = base64.b64encode(picture.getvalue()).decode()
    return (
        f"<b>fascicle.{type(shown).__name__}</b>"
        f'<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:start">'
        f'<table style="max-width:36em">{rows}</table>'
        f'<img style="max-width:30em;height:auto" src="data:image/png;base64,{content}"></div>'
    )


@singledispatch
def _facts(heart: Any) -> Facts:
    """Facts about an object, with units, and a picture; here, about a heart."""
    torso = heart.torso
    return {
        "name": heart.name,
        "vertices": len(heart.vertices),
        "tetrahedra": len(heart.tetrahedra),
        "mean edge length": f"{heart.edge_length:.2f} mm",
        "volume of the myocardium": f"{heart.volumes.sum() / 1000:.0f} ml",
        "electrodes": ", ".join(heart.electrode_names),
        "torso": "none in the folder" if torso is None else f"{len(torso.vertices)} vertices",
        **{parameter_label(n, quantity(n).unit): f"{v:.4g}" for n, v in heart.values.items()},
    }, one_axes(draw_heart, heart, "anterior")


@_facts.register
def _(tree: PurkinjeTree) -> Facts:
    facts = {"side": tree.side, "nodes": len(tree.nodes), "junctions": len(tree.junctions)}
    lengths = {"length": tree.lengths.sum()}
    lengths |= {f"length of {name}": tree.lengths[part].sum() for name, part in tree.parts.items()}
    facts |= {name: f"{length:.1f} mm" for name, length in lengths.items()}
    return facts, one_axes(draw_tree, tree, projection="3d")


@_facts.register
def _(simulation: Beat) -> Facts:
    facts: dict[str, object] = {
        "QRS duration": f"{simulation.qrs_duration:.0f} ms",
        "total activation time": f"{simulation.total_activation_time:.1f} ms",
        "unreached vertices": f"{simulation.unreached.sum()} of {len(simulation.activation)}",
    }
    coupled = simulation.coupled
    for tree, times, back in zip(simulation.trees, coupled.trees, coupled.retrograde, strict=True):
        fired = np.isfinite(times[tree.junctions])
        facts[f"{tree.side.upper()} junctions"] = (
            f"{(fired & ~back).sum()} anterogradely, {(fired & back).sum()} retrogradely, "
            f"{(~fired).sum()} not activated"
        )
    return facts, simulated_ecg_figure(simulation)


@_facts.register
def _(target: Target) -> Facts:
    rate = target.heart_rate
    return {
        "source": target.provenance.get("source", "unknown"),
        "beats": len(target.beats),
        "leads used": ", ".join(np.array(target.leads)[target.used]),
        "heart rate": "unknown" if rate is None else f"{rate:.0f} beats/min",
        "QRS window": f"{target.qrs_onset:.0f} to {target.qrs_offset:.0f} ms from the R peak",
        "QRS duration": f"{target.qrs_duration:.0f} ms",
    }, target_figure(target)


@_facts.register
def _(fitted: FittedStudy) -> Facts:
    space, population = fitted.simulator.prior.learnt, fitted.population
    values = (
        population.values
        if len(population)
        else {n: np.array([v]) for n, v in population.best.items()}
    )
    facts: dict[str, object] = {"verdict": fitted.verdict, "folder": fitted.folder}
    facts |= {f"warning {k}": text for k, text in enumerate(fitted.warnings, 1)}
    facts |= {"networks": len(fitted.population)}
    facts |= {parameter_label(p.name, "1"): p for p in fitted.statements.parameters}
    if not fitted.statements.parameters:
        labels = {parameter_label(p.name, p.unit): p.name for p in space.parameters}
        facts |= {label: _median(values[name]) for label, name in labels.items()}
    return facts, prior_figure(space, values)


@_facts.register
def _(predicted: Predicted) -> Facts:
    facts = {"scenario": predicted.scenario.description, "networks": len(predicted.beats)}
    with_unit = {k: v for k, v in predicted.indices.items() if INDICES[k] != "1"}
    facts |= {index_label(index): _median(values) for index, values in with_unit.items()}
    return facts, prediction_ecg_figure({"predicted": predicted})


def _median(values: Floats) -> str:
    finite = values[np.isfinite(values)]
    low, middle, high = np.percentile(finite, (5, 50, 95)) if len(finite) else [np.nan] * 3
    return f"{middle:.4g} (90 % of the networks: {low:.4g} to {high:.4g})"
