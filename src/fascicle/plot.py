"""Figures of results for a notebook: every function returns the Matplotlib axes it has drawn on.

They belong to a figure of their own: `axes[0].figure` shows in a notebook, and
`axes[0].figure.savefig("ecg.svg")` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.progress import Progress
from fascicle.heart.heart import Heart
from fascicle.prediction.predicted import Predicted
from fascicle.recording.target import Target
from fascicle.reporting.indices import index_figure
from fascicle.reporting.pairs import pair_figure
from fascicle.reporting.priors import prior_figure
from fascicle.reporting.scenario import (
    scenario_activation_figure,
    scenario_ecg_figure,
    spread_figure,
)
from fascicle.reporting.study import loss_figure, recorded_ecg_figure
from fascicle.reporting.target import target_figure
from fascicle.study.results import FittedStudy


def ecg(fitted: FittedStudy, recording: int = 0, progress: Progress | None = None) -> list[Axes]:
    """Recorded and predicted QRS of a study, one axes a lead.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    recording : int
        Which of its recordings, counted from 0.
    progress : Progress, optional
        Called after each network that is simulated.
    """
    networks = fitted.networks(progress, recording)
    return _axes(recorded_ecg_figure(fitted, recording, networks))


def scenario_ecg(predicted: Mapping[str, Predicted], name: str) -> list[Axes]:
    """ECG of a scenario over that of the own beat: means, and what 90 % of the networks span.

    Parameters
    ----------
    predicted : mapping of name to Predicted
        What `fascicle.predict` returned.
    name : str
        The scenario.
    """
    return _axes(scenario_ecg_figure(predicted, name))


def activation(heart: Heart, predicted: Mapping[str, Predicted], name: str) -> list[Axes]:
    """Activation and trees of the networks with the least, median and largest activation time.

    Parameters
    ----------
    heart : Heart
        That of the study (`fitted.problem.model.heart`).
    predicted : mapping of name to Predicted
        What `fascicle.predict` returned; the own beat's median network stands above, in the same
        colours.
    name : str
        The scenario.
    """
    return _axes(scenario_activation_figure(heart, predicted, name))


def activation_spread(heart: Heart, predicted: Mapping[str, Predicted]) -> list[Axes]:
    """Standard deviation of the activation over the networks, a row a scenario.

    Parameters
    ----------
    heart : Heart
        That of the study (`fitted.problem.model.heart`).
    predicted : mapping of name to Predicted
        What `fascicle.predict` returned.
    """
    return _axes(spread_figure(heart, predicted))


def indices(predicted: Mapping[str, Predicted]) -> list[Axes]:
    """Indices of scenarios, one axes an index: medians, and what half and 90 % of networks span.

    Parameters
    ----------
    predicted : mapping of name to Predicted
        What `fascicle.predict` returned.
    """
    return _axes(index_figure({name: found.indices for name, found in predicted.items()}))


def pairs(fitted: FittedStudy) -> list[Axes]:
    """Pairs of the parameters that were learnt, on the whole ranges of their priors."""
    population = fitted.population
    return _axes(pair_figure(fitted.problem.space, population.values, population.best))


def priors(fitted: FittedStudy) -> list[Axes]:
    """Each parameter before (lines) and after the recording (histograms)."""
    return _axes(prior_figure(fitted.problem.space, fitted.population.values))


def convergence(fitted: FittedStudy) -> list[Axes]:
    """Mismatch of every evaluation of a study."""
    return _axes(loss_figure(fitted))


def target(target: Target) -> list[Axes]:
    """Beats of a target and its QRS window, one axes a lead."""
    return _axes(target_figure(target))


def _axes(figure: Figure) -> list[Axes]:
    return list(figure.axes)
