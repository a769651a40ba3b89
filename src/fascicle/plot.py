"""Figures of results: every function draws one and returns its Matplotlib axes.

The figure is pyplot's current one, so that a notebook shows it, and after
``import matplotlib.pyplot as plt`` a script shows it by ``plt.show()`` and saves it by
``fascicle.plot.ecg("STUDY"); plt.savefig("ecg.png")``. ``plt.close()`` frees its memory.

A study or a heart is passed as an object or as its folder, and a study in place of its heart, too;
`predicted` is the result of `fascicle.predict`, and `name` that of a scenario in it.
The size of figures, resolution, fonts and looks that you have set in Matplotlib count. Functions
that take `ax` draw into axes of yours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats, Singles
from fascicle.core.errors import InputError
from fascicle.core.files import as_path
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.forward.beat import Beat
from fascicle.heart.folder import as_heart, load_heart
from fascicle.heart.heart import Heart
from fascicle.prediction.predicted import Predicted
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.recording.target import Target
from fascicle.recording.target_files import as_target
from fascicle.reporting.activation import draw_tree, spread_figure
from fascicle.reporting.ecg import target_figure
from fascicle.reporting.heart import draw_heart
from fascicle.reporting.parameters import pair_figure, prior_figure
from fascicle.reporting.prediction import (
    index_figure,
    prediction_ecg_figure,
    scenario_activation_figure,
    scenario_ecg_figure,
    simulated_activation_figure,
    simulated_ecg_figure,
)
from fascicle.reporting.study import draw_losses, recorded_ecg_figure
from fascicle.reporting.style import P, one_axes, user_first
from fascicle.study.fitted import FittedStudy, StudyLike, as_study
from fascicle.study.study import StudyFile


def heart(heart: Heart | Path | str, view: str = "anterior", ax: Axes | None = None) -> list[Axes]:
    """Endocardia of a heart, or of its folder, within its surface, and the roots of its bundles.

    A `view` is ``"anterior"``, ``"RV side"``, ``"LV side"`` or ``"base"``.
    """
    return _into(ax, draw_heart, as_heart(heart), view)


def tree(tree: PurkinjeTree, ax: Axes | None = None) -> list[Axes]:
    """Bundle, fascicles and branches of a Purkinje tree, in three dimensions."""
    check_kind(tree, PurkinjeTree, "tree", "one that a ForwardModel grows")
    return _into(ax, draw_tree, tree, projection="3d")


def beat(beat: Beat, heart: Heart | Path | str | None = None) -> list[Axes]:
    """ECG of a beat, one axes a lead; with its heart, or the folder of that, activation."""
    check_kind(beat, Beat, "beat", "what a ForwardModel simulates")
    if heart is None:
        return _shown(simulated_ecg_figure, beat)
    heart = as_heart(heart)
    _check_vertices(heart, "the beat", beat.activation)
    roots = {tree.side: tree.nodes[tree.root] for tree in beat.trees}
    for e in heart.endocardia if heart.atlas is not None else ():
        if e.side in roots and np.linalg.norm(e.vertices - roots[e.side], axis=1).min() > 0.1:  # mm
            raise InputError(
                f"{heart.name}: the beat is on another heart of the atlas; give that heart, "
                "model.of_heart(parameters).heart"
            )
    return _shown(simulated_activation_figure, heart, beat)


def prediction(predicted: Predicted) -> list[Axes]:
    """ECG of one scenario, one axes a lead: mean, and what 90 % of the networks span."""
    check_kind(predicted, Predicted, "predicted", "one of what fascicle.predict returned")
    return _shown(prediction_ecg_figure, {"predicted": predicted})


def ecg(
    fitted: StudyLike,
    recording: int = 0,
    progress: Progress | Lines | None = "lines",
    *,
    caption: bool = False,
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
    caption : bool
        Whether to write below how well recording and networks agree.
    """
    check_kind(caption, bool, "caption", "True or False")
    fitted = as_study(fitted, progress)
    with shown_progress(progress) as shown:
        networks = fitted.networks(shown, recording)
    return _shown(recorded_ecg_figure, fitted, recording, networks, caption)


def scenario_ecg(predicted: Mapping[str, Predicted], name: str) -> list[Axes]:
    """ECG of a scenario over that of the intrinsic beat: means, and what 90 % of networks span."""
    _check_predicted(predicted)
    return _shown(scenario_ecg_figure, predicted, name)


def activation(
    heart: Heart | StudyLike, predicted: Mapping[str, Predicted], name: str
) -> list[Axes]:
    """Activation by the networks at three percentiles of the total activation time.

    The intrinsic beat's median network stands above, in the same colours. Of hearts of an atlas
    give the study, which knows the heart of each network.
    """
    _check_predicted(predicted)
    template, heart_of = _heart(heart, predicted), None
    if template.atlas is not None:
        if isinstance(heart, Heart):
            raise InputError(f"{heart.name}: each network has a heart of its own; give the study")
        heart_of = as_study(heart).heart_of
    return _shown(scenario_activation_figure, template, predicted, name, heart_of)


def activation_spread(heart: Heart | StudyLike, predicted: Mapping[str, Predicted]) -> list[Axes]:
    """Standard deviation of the activation over the networks, a row a scenario."""
    _check_predicted(predicted)
    spreads = {name: prediction.maps["activation_sd"] for name, prediction in predicted.items()}
    return _shown(spread_figure, _heart(heart, predicted), spreads)


def indices(predicted: Mapping[str, Predicted]) -> list[Axes]:
    """Indices of scenarios, one axes an index: medians, and what half and 90 % of networks span."""
    _check_predicted(predicted)
    return _shown(index_figure, predicted)


def pairs(fitted: StudyLike) -> list[Axes]:
    """Pairs of the parameters that were learnt, on the whole ranges of their priors."""
    fitted = as_study(fitted)
    population = fitted.population
    return _shown(pair_figure, fitted.simulator.prior.learnt, population.values, population.best)


def priors(fitted: StudyLike) -> list[Axes]:
    """Prior density of each parameter (lines), and the networks (histograms)."""
    fitted = as_study(fitted)
    return _shown(prior_figure, fitted.simulator.prior.learnt, fitted.population.values)


def convergence(fitted: StudyLike, ax: Axes | None = None) -> list[Axes]:
    """Mismatch of every evaluation of a study."""
    return _into(ax, draw_losses, as_study(fitted), size=(7.0, 3.8))


def target(target: Target | Path | str) -> list[Axes]:
    """Beats of a target, or of its netCDF file, and its QRS window, one axes a lead."""
    return _shown(target_figure, as_target(target))


def _check_predicted(predicted: Mapping[str, Predicted]) -> None:
    """Refuse what `fascicle.predict` has not returned."""
    check_kind(predicted, Mapping, "predicted", "what fascicle.predict returned")
    if not predicted:
        raise InputError("predicted is empty; give what fascicle.predict returned")
    for name, prediction in predicted.items():
        check_kind(prediction, Predicted, f"predicted '{name}'", "what fascicle.predict returned")


def _heart(source: Heart | StudyLike, predicted: Mapping[str, Predicted]) -> Heart:
    """The heart that the predictions are of."""
    if isinstance(source, FittedStudy):
        heart = source.simulator.model.heart
    elif isinstance(source, Heart):
        heart = source
    else:
        folder = as_path(source, "heart", "a heart, a fitted study, or the folder of either")
        heart = load_heart(
            folder / StudyFile.HEART if (folder / StudyFile.CONFIGURATION).exists() else folder
        )
    for name, prediction in predicted.items():
        _check_vertices(heart, f"'{name}'", prediction.beats[0].activation)
    return heart


def _check_vertices(heart: Heart, name: str, activation: Floats | Singles) -> None:
    if len(activation) != len(heart.vertices):
        raise InputError(
            f"heart '{heart.name}' has {len(heart.vertices)} vertices, {name} was predicted "
            f"on one of {len(activation)}; give that heart"
        )


def _into(ax: Axes | None, draw: Callable[..., None], *arguments: Any, **looks: Any) -> list[Axes]:
    """Draw into the user's axes, or into those of a new figure."""
    check_kind(ax, (Axes, NoneType), "ax", "Matplotlib axes")
    if ax is None:
        return _shown(one_axes, draw, *arguments, **looks)
    draw(ax, *arguments)
    return [ax]


def _shown(draw: Callable[P, Figure], *args: P.args, **kwargs: P.kwargs) -> list[Axes]:
    """Draw a figure by the user's settings of Matplotlib; it becomes pyplot's current one."""
    token = user_first.set(True)
    try:
        figure = draw(*args, **kwargs)
    finally:
        user_first.reset(token)
    pyplot.figure(figure)
    return list(figure.axes)
