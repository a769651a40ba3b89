"""The figures of a finished study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from fascicle.build.check import check_heart
from fascicle.core.errors import InputError
from fascicle.core.ranges import check_items
from fascicle.forward.simulation import Simulation
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import check_population
from fascicle.recording.target import Target
from fascicle.reporting.check import check_figure
from fascicle.reporting.convergence import convergence_figure
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.figures import FORMATS, save
from fascicle.reporting.fitted_text import KEPT
from fascicle.reporting.hearts import SINCE_FIRST, SPREAD, ActivationRow, activation_figure
from fascicle.reporting.indices import index_figure
from fascicle.reporting.names import MEASURES
from fascicle.reporting.pairs import pair_figure
from fascicle.reporting.priors import prior_figure
from fascicle.reporting.style import BLUE, VERMILION
from fascicle.reporting.target import target_figure
from fascicle.study.activation_maps import activation_maps
from fascicle.study.agreement import Agreement, agreement
from fascicle.study.fitted import FittedStudy
from fascicle.study.target_comparison import Network

SHARE = 0.9  # of beats and of networks, in bands: ranges of unequal numbers cannot be compared


class Drawing(NamedTuple):
    """A figure.

    Attributes
    ----------
    figure : Figure
    text : str
        What it shows.
    agreement : Agreement, optional
        The numbers in it, if there are.
    of_networks : bool
        Whether it shows what the networks say, which may not be relied on; not inputs, nor how the
        fit went.
    """

    figure: Figure
    text: str
    agreement: Agreement | None = None
    of_networks: bool = True


def activation_row(label: str, simulation: Simulation) -> ActivationRow:
    """A simulation as `activation_figure` draws it: tissue and trees."""
    trees = tuple(zip(simulation.trees, simulation.coupled.trees, strict=True))
    return ActivationRow(label, simulation.activation, trees)


def drawings(
    fitted: FittedStudy,
    networks: Sequence[Network],
    predicted: Mapping[str, Predicted] = MappingProxyType({}),
) -> dict[str, Drawing]:
    """Draw a study: its recordings, networks and predictions, and the heart they rest on.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    networks : sequence of Network
        Its population, simulated.
    predicted : mapping of name to Predicted, optional
        Scenarios over it, the intrinsic beat first.
    """
    check_population(fitted)
    model, space, population = fitted.simulator.model, fitted.simulator.space, fitted.population
    heart = model.heart
    best = activation_row("best network", fitted.best_network.simulation).since_first()
    activations = np.array([network.simulation.activation for network in networks])
    spread = ActivationRow("all networks", activation_maps(activations)["activation_sd"])
    return {
        **_of_recordings(fitted, networks),
        "activation": Drawing(
            activation_figure(heart, [best], SINCE_FIRST),
            "Activation by the network with the least mismatch.",
        ),
        "activation-spread": Drawing(
            activation_figure(heart, [spread], SPREAD),
            f"How far the activations of {len(networks)} networks are apart: standard deviation.",
        ),
        **_of_scenarios(predicted),
        "priors": Drawing(
            prior_figure(space, population.values),
            "What was thought before (grey lines) and the networks (orange).",
        ),
        "pairs": Drawing(
            pair_figure(
                space, population.values, population.best, title=fitted.statements.networks_called
            ),
            "Pairs of parameters on the whole ranges of their priors.",
        ),
        "convergence": Drawing(
            loss_figure(fitted),
            "Mismatch of every evaluation, in the order they were made. Along the broken line lie "
            "networks whose ECG is no closer to the recording than a flat line.",
            of_networks=False,
        ),
        "heart": Drawing(
            check_figure(heart, check_heart(heart, model.prepared.charts)),
            "The heart: walls, fibres, where the bundles start, and the body with its electrodes.",
            of_networks=False,
        ),
    }


def write_figures(
    drawn: Mapping[str, Drawing], folder: Path, kinds: Sequence[str], caution: str | None = None
) -> list[Path]:
    """Write figures into a folder.

    Parameters
    ----------
    drawn : mapping of name to Drawing
        What to write.
    folder : Path
        Where to; it is made if it is not there.
    kinds : sequence of str
        Of files: ``"png"``, ``"svg"``, ``"pdf"``.
    caution : str, optional
        What stands above those that show networks.

    Returns
    -------
    list of Path
        What was written.
    """
    return [
        save(drawing.figure, folder / f"{name}.{kind}", caution if drawing.of_networks else None)
        for name, drawing in drawn.items()
        for kind in kinds
    ]


def check_kinds(kinds: Sequence[str]) -> None:
    """Refuse kinds of files that no figure can be written as."""
    known = [suffix.removeprefix(".") for suffix in FORMATS]
    check_items(kinds, str, "figures", f"kinds of files: {', '.join(known)}")
    for kind in kinds:
        if kind not in known:
            raise InputError(f"figures cannot be drawn as '{kind}'; use {', '.join(known)}")


def loss_figure(fitted: FittedStudy) -> Figure:
    """Draw the mismatch of every evaluation of a study."""
    records = fitted.study.records()
    losses = np.array([record.evaluation.loss for record in records])
    stages = [record.stage for record in records]
    return convergence_figure(losses, stages, fitted.null_loss)


def recorded_ecg_figure(
    fitted: FittedStudy, recording: int = 0, networks: Sequence[Network] | None = None
) -> Figure:
    """Draw recorded and predicted QRS of one recording.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    recording : int
        Which of its recordings, counted from 0.
    networks : sequence of Network, optional
        Its population in that recording's scenario, if simulated before.
    """
    check_population(fitted)
    if networks is None:
        networks = fitted.networks(recording=recording)
    target = fitted.recordings[recording].target
    return _ecg(target, networks, agreement(target, networks))


def _ecg(target: Target, networks: Sequence[Network], found: Agreement) -> Figure:
    window = target.qrs_samples
    time = target.time[window]
    predicted = np.stack([network.predicted for network in networks])[:, :, window]
    recorded = EcgGroup("recorded", "beat", time, target.qrs_beats, BLUE, SHARE)
    groups = [recorded, EcgGroup("predicted", "network", time, predicted, VERMILION, SHARE)]
    notes = [f"r {r:.2f}" if np.isfinite(r) else "" for r in found.correlation]
    title = f"Recorded QRS and {len(networks)} networks"
    return ecg_figure(groups, title, notes, "R peak", _caption(found))


def _caption(found: Agreement) -> str:
    """What the mean of the networks explains, and durations and axis, recorded and predicted."""
    said = [
        f"mean explains {found.explained_over_all:.0%}, r{KEPT}{found.correlation_over_all:.2f}"
    ]
    for key, measure in MEASURES.items():
        if key in found.recorded:
            low, middle, high = found.percentiles(key)
            said.append(
                f"{measure.name} {found.recorded[key]:.0f}{KEPT}{measure.unit}, "
                f"predicted {middle:.0f} ({low:.0f}{KEPT}to{KEPT}{high:.0f})"
            )
    return "; ".join(said)


def _of_scenarios(predicted: Mapping[str, Predicted]) -> dict[str, Drawing]:
    if not predicted:
        return {}
    figure = index_figure({name: found.indices for name, found in predicted.items()})
    text = "Medians, and what half (thick) and 90 % (thin) of the networks span."
    return {"indices": Drawing(figure, text)}


def _of_recordings(fitted: FittedStudy, networks: Sequence[Network]) -> dict[str, Drawing]:
    """Recorded and predicted QRS, and the beats of every recording."""
    recordings = fitted.recordings
    names = [""] if len(recordings) == 1 else [f" {n + 1}" for n in range(len(recordings))]
    found: dict[str, Drawing] = {}
    for number, name in enumerate(names):
        suffix = f"-{number + 1}" if number else ""
        its = fitted.networks(recording=number) if number else networks
        agreed = agreement(recordings[number].target, its)
        found[f"ecg{suffix}"] = Drawing(
            _ecg(recordings[number].target, its, agreed),
            f"Recorded beats{name} and what the networks predict: means, and what 90 % of beats "
            "and of networks span. Time counts from the R peak.",
            agreed,
        )
        found[f"recording{suffix}"] = Drawing(
            target_figure(recordings[number].target),
            f"Recording{name}: its beats, and the QRS window that the fit saw.",
            of_networks=False,
        )
    return found
