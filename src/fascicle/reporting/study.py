"""Figures of a finished study: ECGs, activation, predictions, parameters and heart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.build.check import check_heart
from fascicle.core.files import check_replaceable
from fascicle.core.leads import INDEPENDENT_LEADS
from fascicle.forward.activation_sequence import activation_maps
from fascicle.networks.agreement import Agreement, agreement
from fascicle.networks.target_comparison import Network
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import check_population
from fascicle.recording.target import Target
from fascicle.reporting.activation import ActivationRow, activation_figure, spread_figure
from fascicle.reporting.ecg import EcgGroup, ecg_figure, target_figure
from fascicle.reporting.heart import check_figure
from fascicle.reporting.names import MEASURES, on_template
from fascicle.reporting.parameters import draw_convergence, pair_figure, prior_figure
from fascicle.reporting.prediction import index_figure
from fascicle.reporting.style import Colour, mark, new_figure, one_axes, save
from fascicle.study.fitted import FittedStudy


class Drawing(NamedTuple):
    """A figure, its caption, and for an ECG how well recording and networks agree."""

    figure: Figure
    text: str
    agreement: Agreement | None = None


def drawings(
    fitted: FittedStudy,
    networks: Sequence[Network],
    predicted: Mapping[str, Predicted] = MappingProxyType({}),
) -> dict[str, Drawing]:
    """Figures of a study's recordings, networks, predictions and heart, by name.

    Figures of networks are marked with the study's caution text, if it has one. `networks` is the
    simulated population; the first of the predictions is the intrinsic beat.
    """
    check_population(fitted)
    model, population = fitted.simulator.model, fitted.population
    space, heart = fitted.simulator.prior.learnt, model.heart
    best = fitted.best_model
    row = ActivationRow.of("best network", fitted.best_network.beat, best.heart)
    maps = activation_maps([network.beat.activation for network in networks])
    # how file names and captions number the recordings
    numbers = range(1, len(fitted.recordings) + 1)
    suffixes = ["", *(f"-{count}" for count in numbers[1:])]
    names = [f"Recording {count}" if len(numbers) > 1 else "Recording" for count in numbers]
    drawn: dict[str, Drawing] = {}
    torso = ", each with the gain and in the torso that were drawn with it" if fitted.ecgs else ""
    for number, recording in enumerate(fitted.recordings):
        simulated = fitted.networks(recording=number) if number else networks
        qrs_agreement = agreement(recording.target, simulated)
        drawn[f"ecg{suffixes[number]}"] = Drawing(
            _ecg(recording.target, simulated, qrs_agreement),
            f"{names[number]}: QRS of its beats and of the networks{torso}. Lines are means, "
            "bands hold 90 % of the beats or networks. Time is counted from the R peak.",
            qrs_agreement,
        )
    if fitted.statements.states:
        drawn["states"] = Drawing(
            states_figure(getattr(population, "states", {}), fitted.study.config.states),
            "How probable each conduction state is: before the ECG is seen (grey) and given it. "
            "Fascicular blocks are not among the states that are simulated.",
        )
    drawn["activation"] = Drawing(
        activation_figure(heart, [row.since_first()]),
        "Activation of the best network, which has the lowest mismatch.",
    )
    drawn["activation-spread"] = Drawing(
        spread_figure(heart, {"all networks": maps["activation_sd"]}),
        f"Standard deviation of the activation over {len(networks)} networks{on_template(heart)}.",
    )
    if predicted:
        text = "Medians, with the range of half (thick) and of 90 % (thin) of the networks."
        drawn["indices"] = Drawing(index_figure(predicted), text)
    drawn["priors"] = Drawing(
        prior_figure(space, population.values),
        "Prior densities (grey lines) and histograms of the networks (orange).",
    )
    title = fitted.statements.networks_called
    drawn["pairs"] = Drawing(
        pair_figure(space, population.values, population.best, title=title),
        "Pairs of parameters over their whole prior ranges.",
    )
    for drawing in drawn.values():
        mark(drawing.figure, fitted.statements.caution_text)
    for number, recording in enumerate(fitted.recordings):
        text = f"{names[number]}: its beats and the QRS window of the fit."
        drawn[f"recording{suffixes[number]}"] = Drawing(target_figure(recording.target), text)
    for suffix, name, report in zip(suffixes, names, fitted.emulator_reports, strict=False):
        refined = "error_of_posterior" in report
        text = (
            f"{name}: error of the emulator for held-out networks of the prior"
            + ", and for those of a first posterior, each left out once" * refined
            + " (root mean square over that of the QRS)."
        )
        drawn[f"emulator{suffix}"] = Drawing(emulator_figure(report), text)
    drawn["convergence"] = Drawing(
        one_axes(draw_losses, fitted, size=(7.0, 3.8)),
        "Mismatch of every evaluation, in order. A network on the broken line matches the "
        "recording no better than a flat line.",
    )
    whose = "The heart" if heart.atlas is None else "The heart of the best network"
    drawn["heart"] = Drawing(
        check_figure(best.heart, check_heart(best.heart, best.prepared.charts)),
        f"{whose}: walls, fibres, roots of the bundles, and the torso with its electrodes.",
    )
    return drawn


def write_figures(drawn: Mapping[str, Drawing], folder: Path, kinds: Sequence[str]) -> list[Path]:
    """Write figures into a folder, in each of the file formats; returns the files."""
    paths = {folder / f"{name}.{kind}": name for name in drawn for kind in kinds}
    for path in paths:
        check_replaceable(path)
    return [save(drawn[name].figure, path) for path, name in paths.items()]


def draw_losses(axes: Axes, fitted: FittedStudy) -> None:
    """Draw the mismatch of every evaluation of a study."""
    records = fitted.study.records()
    losses = np.array([record.evaluation.loss for record in records])
    draw_convergence(axes, losses, [record.stage for record in records], fitted.null_loss)


def states_figure(states: Mapping[str, float], priors: Mapping[str, float]) -> Figure:
    """Draw posterior and prior probabilities of conduction states, the most probable on top."""
    ranked = sorted(states, key=lambda name: states[name])
    figure = new_figure(6.0, 0.6 + 0.24 * len(ranked))
    axes = figure.subplots()
    axes.barh(ranked, [states[name] for name in ranked], color=Colour.ORANGE, label="given the ECG")
    prior = [priors.get(name, np.nan) for name in ranked]  # none of fascicular blocks
    axes.plot(prior, ranked, "|", color=Colour.GREY, markersize=10, label="before the ECG")
    axes.set_xlim(0, 1)
    axes.set_xlabel("probability")
    axes.legend(loc="lower right")
    return figure


def emulator_figure(report: Mapping[str, float]) -> Figure:
    """Draw the errors of an emulator, over all leads and for each lead."""
    figure = new_figure(6.0, 2.6)
    axes = figure.subplots()
    kinds = {"error": ("prior", Colour.GREY), "error_of_posterior": ("posterior", Colour.ORANGE)}
    shown = {kind: looks for kind, looks in kinds.items() if kind in report}
    for k, (kind, (label, colour)) in enumerate(shown.items()):
        leads = {"all": kind} | {lead: f"{kind}_{lead}" for lead in INDEPENDENT_LEADS}
        heights = [100 * report[key] for key in leads.values() if key in report]
        places = np.arange(len(heights)) + 0.4 * (k - (len(shown) - 1) / 2)
        axes.bar(places, heights, 0.4, color=colour, label=label)
    axes.set_xticks(range(len(leads)), list(leads))
    axes.set_xlabel("lead")
    axes.set_ylabel("error of the emulator (%)")
    axes.margins(y=0.25)
    axes.legend(title="networks of the", loc="upper left", ncols=2)
    return figure


def recorded_ecg_figure(
    fitted: FittedStudy, recording: int, networks: Sequence[Network], caption: bool
) -> Figure:
    """Draw recorded and simulated QRS of one recording of a study (its index, from 0).

    The networks are the population in that recording's scenario. `caption` adds figures of their
    agreement below.
    """
    check_population(fitted)
    target = fitted.recordings[recording].target
    return _ecg(target, networks, agreement(target, networks), caption)


def _ecg(
    target: Target, networks: Sequence[Network], qrs_agreement: Agreement, caption: bool = True
) -> Figure:
    """Draw recorded and simulated QRS; bands hold 90 %, as ranges grow with their number."""
    window = target.qrs_samples
    time = target.time[window]
    simulated = np.stack([network.predicted for network in networks])[:, :, window]
    groups = [
        EcgGroup("recorded", "beat", time, target.qrs_beats, Colour.BLUE, 0.9),
        EcgGroup("simulated", "network", time, simulated, Colour.VERMILION, 0.9),
    ]
    notes = [f"r {r:.2f}" if np.isfinite(r) else "" for r in qrs_agreement.correlation]
    title = f"Recorded QRS and {len(networks)} networks"
    # variance explained by the networks' mean; durations and axis, recorded and simulated
    parts = [
        f"mean explains {qrs_agreement.explained_over_all:.0%} of the variance, "
        f"r {qrs_agreement.correlation_over_all:.2f}"
    ]
    for key, measure in MEASURES.items():
        if key in qrs_agreement.recorded:
            low, middle, high = qrs_agreement.percentiles(key)
            parts.append(
                f"{measure.name} {qrs_agreement.recorded[key]:.0f} {measure.unit}, "
                f"simulated {middle:.0f} ({low:.0f} to {high:.0f})"
            )
    caption_text = "; ".join(parts) if caption else ""
    return ecg_figure(groups, title, notes, "R peak", caption_text, target.leads)
