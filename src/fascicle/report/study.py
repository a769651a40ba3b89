"""The figures of a finished study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fascicle.core.errors import InputError
from fascicle.forward.simulation import Simulation
from fascicle.report.convergence import convergence_figure
from fascicle.report.ecg import EcgGroup, ecg_figure
from fascicle.report.figures import save
from fascicle.report.hearts import ActivationRow, activation_figure
from fascicle.report.pairs import pair_figure
from fascicle.report.style import BLUE, VERMILION
from fascicle.study.population import Posterior
from fascicle.study.problem import Network
from fascicle.study.results import FittedStudy


def activation_row(label: str, simulation: Simulation) -> ActivationRow:
    """A simulation as `activation_figure` draws it: tissue and trees."""
    trees = tuple(zip(simulation.trees, simulation.coupled.trees, strict=True))
    return ActivationRow(label, simulation.activation, trees)


def check_population(fitted: FittedStudy) -> None:
    """Refuse a study without networks."""
    if not len(fitted.population):
        raise InputError(
            f"{fitted.folder}: no network was found, so there is nothing to draw or to predict "
            "with; fit with more steps or more initial points"
        )


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
    check_population(fitted)
    problem, population, records = fitted.problem, fitted.population, fitted.study.records()
    best = activation_row("best network", fitted.best_network.simulation)
    figures = {
        "ecg": recorded_ecg_figure(fitted, 0, networks),
        "pairs": pair_figure(
            problem.space, population.values, population.best, title=fitted.networks_called
        ),
        "activation": activation_figure(problem.model.heart, [best]),
        "convergence": convergence_figure(
            np.array([record.evaluation.loss for record in records]),
            [record.stage for record in records],
        ),
    }
    for number in range(1, len(problem.recordings)):
        figures[f"ecg-{number + 1}"] = recorded_ecg_figure(fitted, number)
    folder = fitted.folder / "figures"
    return [save(figure, folder / f"{name}.png") for name, figure in figures.items()]


def recorded_ecg_figure(
    fitted: FittedStudy, recording: int, networks: Sequence[Network] | None = None
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
    problem = fitted.problem.recordings[recording]
    if networks is None:
        networks = fitted.networks(recording=recording)
    # the paper shows the range of its 30
    share = 0.9 if isinstance(fitted.population, Posterior) else 1.0
    window = problem.target.qrs_samples
    time = problem.target.time[window]
    predicted = np.stack([network.predicted for network in networks])[:, :, window]
    recorded = EcgGroup("recorded", "beat", time, problem.target.qrs_beats, BLUE)
    groups = [recorded, EcgGroup("predicted", "network", time, predicted, VERMILION, share)]
    return ecg_figure(groups, f"Recorded QRS and {len(networks)} networks")
