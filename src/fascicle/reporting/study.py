"""The figures of a finished study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from fascicle.build.check import check_heart
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import check_population
from fascicle.recording.target import Target
from fascicle.reporting.activation import SINCE_FIRST, SPREAD, ActivationRow, activation_figure
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.heart import check_figure
from fascicle.reporting.names import MEASURES
from fascicle.reporting.parameters import convergence_figure, pair_figure, prior_figure
from fascicle.reporting.scenarios import index_figure
from fascicle.reporting.style import Colour, mark, save
from fascicle.reporting.target import target_figure
from fascicle.study.activation_maps import activation_maps
from fascicle.study.agreement import Agreement, agreement
from fascicle.study.fitted import FittedStudy
from fascicle.study.target_comparison import Network


class Drawing(NamedTuple):
    """A figure, what it shows in words, and the numbers in it, if there are."""

    figure: Figure
    text: str
    agreement: Agreement | None = None


def drawings(
    fitted: FittedStudy,
    networks: Sequence[Network],
    predicted: Mapping[str, Predicted] = MappingProxyType({}),
) -> dict[str, Drawing]:
    """Draw a study: its recordings, networks and predictions, and the heart they rest on.

    What shows networks which may not be relied on says so. The networks are the simulated
    population; the intrinsic beat is the first of the predictions.
    """
    check_population(fitted)
    model, space, population = fitted.simulator.model, fitted.simulator.space, fitted.population
    heart = model.heart
    best = ActivationRow.of("best network", fitted.best_network.simulation).since_first()
    activations = np.array([network.simulation.activation for network in networks])
    spread = ActivationRow("all networks", activation_maps(activations)["activation_sd"])
    found = _of_recordings(fitted, networks)
    found["activation"] = Drawing(
        activation_figure(heart, [best], SINCE_FIRST),
        "Activation by the network with the least mismatch.",
    )
    found["activation-spread"] = Drawing(
        activation_figure(heart, [spread], SPREAD),
        f"Standard deviation of the activation over {len(networks)} networks.",
    )
    if predicted:
        text = "Medians, and what half (thick) and 90 % (thin) of the networks span."
        found["indices"] = Drawing(index_figure(predicted), text)
    found["priors"] = Drawing(
        prior_figure(space, population.values),
        "Prior densities (grey lines) and the networks (orange).",
    )
    title = fitted.statements.networks_called
    found["pairs"] = Drawing(
        pair_figure(space, population.values, population.best, title=title),
        "Pairs of parameters on the whole ranges of their priors.",
    )
    for drawing in found.values():
        mark(drawing.figure, fitted.statements.caution_text)
    for number, recording in enumerate(fitted.recordings):
        found[f"recording{_suffix(number)}"] = Drawing(
            target_figure(recording.target),
            f"Recording{_numbered(fitted, number)}: its beats, and the QRS window of the fit.",
        )
    found["convergence"] = Drawing(
        loss_figure(fitted),
        "Mismatch of every evaluation, in the order they were made. Along the broken line lie "
        "networks whose ECG is no closer to the recording than a flat line.",
    )
    found["heart"] = Drawing(
        check_figure(heart, check_heart(heart, model.prepared.charts)),
        "The heart: walls, fibres, where the bundles start, and the torso with its electrodes.",
    )
    return found


def write_figures(drawn: Mapping[str, Drawing], folder: Path, kinds: Sequence[str]) -> list[Path]:
    """Write figures into a folder, as each of the kinds of files; returns what was written."""
    return [
        save(drawing.figure, folder / f"{name}.{kind}")
        for name, drawing in drawn.items()
        for kind in kinds
    ]


def loss_figure(fitted: FittedStudy) -> Figure:
    """Draw the mismatch of every evaluation of a study."""
    records = fitted.study.records()
    losses = np.array([record.evaluation.loss for record in records])
    return convergence_figure(losses, [record.stage for record in records], fitted.null_loss)


def recorded_ecg_figure(fitted: FittedStudy, recording: int, networks: Sequence[Network]) -> Figure:
    """Draw recorded and predicted QRS of one recording, counted from 0.

    The networks are the population in that recording's scenario.
    """
    check_population(fitted)
    target = fitted.recordings[recording].target
    return _ecg(target, networks, agreement(target, networks))


def _suffix(number: int) -> str:
    return f"-{number + 1}" if number else ""


def _numbered(fitted: FittedStudy, number: int) -> str:
    return f" {number + 1}" if len(fitted.recordings) > 1 else ""


def _of_recordings(fitted: FittedStudy, networks: Sequence[Network]) -> dict[str, Drawing]:
    """Recorded and predicted QRS of every recording."""
    found: dict[str, Drawing] = {}
    for number, recording in enumerate(fitted.recordings):
        its = fitted.networks(recording=number) if number else networks
        agreed = agreement(recording.target, its)
        found[f"ecg{_suffix(number)}"] = Drawing(
            _ecg(recording.target, its, agreed),
            f"Recorded beats{_numbered(fitted, number)} and what the networks predict: means, and "
            "what 90 % of beats and of networks span. Time counts from the R peak.",
            agreed,
        )
    return found


def _ecg(target: Target, networks: Sequence[Network], found: Agreement) -> Figure:
    """Bands hold 90 % of each: ranges of unequal numbers cannot be compared."""
    window = target.qrs_samples
    time = target.time[window]
    predicted = np.stack([network.predicted for network in networks])[:, :, window]
    groups = [
        EcgGroup("recorded", "beat", time, target.qrs_beats, Colour.BLUE, 0.9),
        EcgGroup("predicted", "network", time, predicted, Colour.VERMILION, 0.9),
    ]
    notes = [f"r {r:.2f}" if np.isfinite(r) else "" for r in found.correlation]
    title = f"Recorded QRS and {len(networks)} networks"
    return ecg_figure(groups, title, notes, "R peak", _caption(found))


def _caption(found: Agreement) -> str:
    """What the mean of the networks explains, and durations and axis, recorded and predicted."""
    said = [
        f"mean explains {found.explained_over_all:.0%} of the variance, "
        f"r {found.correlation_over_all:.2f}"
    ]
    for key, measure in MEASURES.items():
        if key in found.recorded:
            low, middle, high = found.percentiles(key)
            said.append(
                f"{measure.name} {found.recorded[key]:.0f} {measure.unit}, "
                f"predicted {middle:.0f} ({low:.0f} to {high:.0f})"
            )
    return "; ".join(said)
