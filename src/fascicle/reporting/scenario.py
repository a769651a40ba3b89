"""Figures of a scenario: its ECG over that of the intrinsic beat, and its activation."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

from matplotlib.figure import Figure

from fascicle.core.errors import InputError
from fascicle.core.ranges import check_text
from fascicle.heart.heart import Heart
from fascicle.prediction.predicted import Predicted
from fascicle.prediction.scenarios import INTRINSIC, qrs_aligned
from fascicle.reporting import style
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.fitted_text import shortened
from fascicle.reporting.hearts import (
    SINCE_FIRST,
    SPREAD,
    ActivationRow,
    activation_figure,
    total_time,
)

BAND = 0.9  # of the networks
LEGEND_ROOM = 60.0  # mm, for the name of a scenario
ROW_NAME = 22  # characters of a line beside a row


def scenario_ecg_figure(predicted: Mapping[str, Predicted], name: str) -> Figure:
    """Draw the ECG of a scenario over that of the intrinsic beat: means, and what 90 % span.

    Parameters
    ----------
    predicted : mapping of name to Predicted
        The intrinsic beat among them.
    name : str
        The scenario.

    Raises
    ------
    InputError
        If there is no such scenario.
    """
    own, found = _with_own(predicted, name)
    shown = [own] if found is own else [own, found]
    time, ecgs = qrs_aligned(*shown)
    called = (INTRINSIC, shortened(name, style.LABEL_SIZE, LEGEND_ROOM))
    groups = [
        EcgGroup(label, "network", time, leads, colour, BAND)
        for label, leads, colour in zip(called, ecgs, (style.GREY, style.VERMILION), strict=False)
    ]
    return ecg_figure(groups, "Predicted ECG", time_zero="QRS onset")


def scenario_activation_figure(
    heart: Heart, predicted: Mapping[str, Predicted], name: str
) -> Figure:
    """Draw the networks with the least, median and largest total activation time.

    Parameters
    ----------
    heart : Heart
        That of the study.
    predicted : mapping of name to Predicted
        The intrinsic beat among them, whose median network stands above, in the same colours.
    name : str
        The scenario.

    Raises
    ------
    InputError
        If there is no such scenario.
    """
    own, found = _with_own(predicted, name)
    rows = [_row(found, which, k) for which, k in found.extremes().items()]
    if found is not own:
        rows.insert(0, _row(own, f"{INTRINSIC}: median", own.extremes()["median"]))
    return activation_figure(heart, rows, SINCE_FIRST)


def spread_figure(heart: Heart, predicted: Mapping[str, Predicted]) -> Figure:
    """Draw how far the networks' activations are apart, a row a scenario, in the same colours.

    Parameters
    ----------
    heart : Heart
        That of the study.
    predicted : mapping of name to Predicted
        The scenarios.
    """
    rows = [
        ActivationRow(textwrap.fill(name, ROW_NAME), found.maps["activation_sd"])
        for name, found in predicted.items()
    ]
    return activation_figure(heart, rows, SPREAD)


def _with_own(predicted: Mapping[str, Predicted], name: str) -> tuple[Predicted, Predicted]:
    """The intrinsic beat and a scenario."""
    check_text(name, "name of a scenario")
    if name not in predicted:
        raise InputError(f"'{name}' was not predicted; there are {', '.join(predicted)}")
    if INTRINSIC not in predicted:
        raise InputError(f"'{INTRINSIC}' is not among the predictions; fascicle.predict makes it")
    return predicted[INTRINSIC], predicted[name]


def _row(found: Predicted, label: str, number: int) -> ActivationRow:
    """One network, from its first activation on."""
    beat, total = found.beats[number], found.indices["total_activation_time"][number]
    trees = tuple((tree, times.astype(float)) for tree, times in beat.trees)
    name = f"{label}\n{total_time(total)}"
    row = ActivationRow(name, beat.activation.astype(float), trees)
    return row.since_first()
