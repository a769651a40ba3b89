"""Figures of results: every function draws one and returns its Matplotlib axes.

The figure is pyplot's current one, so that a notebook shows it, and after
``import matplotlib.pyplot as plt`` a script shows it by ``plt.show()`` and saves it by
``fascicle.plot.ecg("STUDY"); plt.savefig("ecg.png")``. ``plt.close()`` frees its memory.

A study is passed as an object or as its folder; `predicted` is the result of `fascicle.predict`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.errors import InputError
from fascicle.core.files import as_path
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.heart.folder import load_heart
from fascicle.heart.heart import Heart
from fascicle.prediction.predicted import Predicted
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target
from fascicle.reporting.ecg import target_figure
from fascicle.reporting.parameters import pair_figure, prior_figure
from fascicle.reporting.scenarios import (
    index_figure,
    scenario_activation_figure,
    scenario_ecg_figure,
    spread_figure,
)
from fascicle.reporting.study import loss_figure, recorded_ecg_figure
from fascicle.study.fit import GivenStudy, as_study
from fascicle.study.fitted import FittedStudy
from fascicle.study.state_fit import HEART
from fascicle.study.study import CONFIGURATION


def ecg(
    fitted: GivenStudy, recording: int = 0, progress: Progress | Lines | None = "lines"
) -> list[Axes]:
    """Recorded and simulated QRS of a study, one axes a lead.

    Parameters
    ----------
    fitted : FittedStudy or path
        The study, or its folder.
    recording : int
        Which of its recordings, counted from 0.
    progress : Progress, "lines" or None
        Called with how many networks are simulated; by default lines on standard error say so.
    """
    fitted = as_study(fitted, progress)
    with shown_progress(progress) as shown:
        networks = fitted.networks(shown, recording)
    return _shown(recorded_ecg_figure(fitted, recording, networks))


def scenario_ecg(predicted: Mapping[str, Predicted], name: str) -> list[Axes]:
    """ECG of a scenario over that of the intrinsic beat: means, and what 90 % of the networks span.

    Parameters
    ----------
    predicted : mapping of name to Predicted
    name : str
        Of the scenario.
    """
    _check_predicted(predicted)
    return _shown(scenario_ecg_figure(predicted, name))


def activation(
    heart: Heart | GivenStudy, predicted: Mapping[str, Predicted], name: str
) -> list[Axes]:
    """Activation by the networks with the least, median and largest total activation time.

    Parameters
    ----------
    heart : Heart, FittedStudy or path
        The heart, the study, or the folder of either.
    predicted : mapping of name to Predicted
        The intrinsic beat's median network stands above, in the same colours.
    name : str
        The scenario.
    """
    _check_predicted(predicted)
    return _shown(scenario_activation_figure(_heart(heart, predicted), predicted, name))


def activation_spread(heart: Heart | GivenStudy, predicted: Mapping[str, Predicted]) -> list[Axes]:
    """Standard deviation of the activation over the networks, a row a scenario.

    Parameters
    ----------
    heart : Heart, FittedStudy or path
        The heart, the study, or the folder of either.
    predicted : mapping of name to Predicted
    """
    _check_predicted(predicted)
    return _shown(spread_figure(_heart(heart, predicted), predicted))


def indices(predicted: Mapping[str, Predicted]) -> list[Axes]:
    """Indices of scenarios, one axes an index: medians, and what half and 90 % of networks span."""
    _check_predicted(predicted)
    return _shown(index_figure(predicted))


def pairs(fitted: GivenStudy) -> list[Axes]:
    """Pairs of the parameters that were learnt, on the whole ranges of their priors."""
    fitted = as_study(fitted)
    population = fitted.population
    return _shown(pair_figure(fitted.simulator.space, population.values, population.best))


def priors(fitted: GivenStudy) -> list[Axes]:
    """Prior density of each parameter (lines), and the networks (histograms)."""
    fitted = as_study(fitted)
    return _shown(prior_figure(fitted.simulator.space, fitted.population.values))


def convergence(fitted: GivenStudy) -> list[Axes]:
    """Mismatch of every evaluation of a study."""
    return _shown(loss_figure(as_study(fitted)))


def target(target: Target | Path | str) -> list[Axes]:
    """Beats of a target, or of its netCDF file, and its QRS window, one axes a lead."""
    return _shown(target_figure(as_target(target)))


def _check_predicted(predicted: Mapping[str, Predicted]) -> None:
    """Refuse what `fascicle.predict` has not returned."""
    check_kind(predicted, Mapping, "predicted", "what fascicle.predict returned")
    if not predicted:
        raise InputError("predicted is empty; give what fascicle.predict returned")
    for name, each in predicted.items():
        check_kind(each, Predicted, f"predicted '{name}'", "what fascicle.predict returned")


def _heart(given: Heart | GivenStudy, predicted: Mapping[str, Predicted]) -> Heart:
    """The heart that the predictions are of."""
    if isinstance(given, FittedStudy):
        heart = given.simulator.model.heart
    elif isinstance(given, Heart):
        heart = given
    else:
        folder = as_path(given, "heart", "a heart, a fitted study, or the folder of either")
        heart = load_heart(folder / HEART if (folder / CONFIGURATION).exists() else folder)
    for name, each in predicted.items():
        count = len(each.beats[0].activation)
        if count != len(heart.vertices):
            raise InputError(
                f"heart '{heart.name}' has {len(heart.vertices)} vertices, '{name}' was predicted "
                f"on one of {count}; give the heart of the study"
            )
    return heart


def _shown(figure: Figure) -> list[Axes]:
    """The axes of a figure, which becomes pyplot's current one."""
    pyplot.figure(figure)
    return list(figure.axes)
