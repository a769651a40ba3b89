"""The figures of a finished study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fascicle.forward.simulation import Simulation
from fascicle.report.convergence import convergence_figure
from fascicle.report.ecg import match_figure
from fascicle.report.figures import save
from fascicle.report.hearts import ActivationRow, activation_figure
from fascicle.report.pairs import pair_figure
from fascicle.study.problem import Network
from fascicle.study.results import FittedStudy


def activation_row(label: str, simulation: Simulation) -> ActivationRow:
    """A simulation as `activation_figure` draws it: tissue and trees."""
    trees = tuple(zip(simulation.trees, simulation.coupled.trees, strict=True))
    return ActivationRow(label, simulation.activation, trees)


def write_figures(fitted: FittedStudy, networks: Sequence[Network]) -> list[Path]:
    """Draw recorded against predicted ECG, pair plot, activation map and convergence.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    networks : sequence of Network
        Its population, simulated.

    Returns
    -------
    list of Path
        The figures, in the study's folder ``figures``.
    """
    folder = fitted.folder / "figures"
    target = fitted.problem.target
    window = target.qrs_samples
    records = fitted.study.records()
    count = f"{len(fitted.population)} networks"
    ecgs = match_figure(
        target.time[window],
        target.qrs_beats,
        np.stack([network.predicted for network in networks])[:, :, window],
        title=f"Recorded QRS and {count}",
    )
    pairs = pair_figure(
        fitted.problem.space, fitted.population.values, fitted.population.best, title=count
    )
    activation = activation_figure(
        fitted.problem.model.heart,
        [activation_row("best network", fitted.best_network.simulation)],
    )
    convergence = convergence_figure(
        [record.evaluation.loss for record in records], [record.stage for record in records]
    )
    return [
        save(ecgs, folder / "ecg.png"),
        save(pairs, folder / "pairs.png"),
        save(activation, folder / "activation.png"),
        save(convergence, folder / "convergence.png"),
    ]
