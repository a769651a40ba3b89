"""What a scenario does in the networks, drawn: its ECG over the own beat's, and its activation."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from fascicle.core.errors import InputError
from fascicle.heart.heart import Heart
from fascicle.prediction.scenarios import OWN_BEAT, Predicted, qrs_aligned
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.hearts import ActivationRow, activation_figure
from fascicle.reporting.style import GREY, VERMILION

BAND = 0.9  # of the networks


def scenario_ecg_figure(predicted: Mapping[str, Predicted], name: str) -> Figure:
    """Draw the ECG of a scenario over that of the own beat: means, and what 90 % span.

    Parameters
    ----------
    predicted : mapping of name to Predicted
        The own beat among them.
    name : str
        The scenario.

    Raises
    ------
    InputError
        If there is no such scenario.
    """
    if name not in predicted:
        raise InputError(f"'{name}' was not predicted; there are {', '.join(predicted)}")
    own, found = predicted[OWN_BEAT], predicted[name]
    groups = [EcgGroup(OWN_BEAT, "network", *qrs_aligned(own), GREY, BAND)]
    if found is not own:
        groups.append(EcgGroup(name, "network", *qrs_aligned(found), VERMILION, BAND))
    return ecg_figure(groups, f"Predicted ECG of {len(found.beats)} networks")


def scenario_activation_figure(heart: Heart, predicted: Predicted) -> Figure:
    """Draw the networks with the least, median and largest total activation time.

    Parameters
    ----------
    heart : Heart
        That of the study.
    predicted : Predicted
        The scenario.
    """
    rows = []
    for which, k in predicted.extremes().items():
        beat = predicted.beats[k]
        label = f"{which}, {predicted.indices['total_activation_time'][k]:.0f} ms"
        trees = tuple((tree, times.astype(float)) for tree, times in beat.trees)
        rows.append(ActivationRow(label, beat.activation.astype(float), trees))
    return activation_figure(heart, rows)
