"""What a scenario does in the networks, drawn: its ECG over the own beat's, and its activation."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from fascicle.heart.heart import Heart
from fascicle.prediction.scenarios import OWN_BEAT, Predicted, qrs_aligned
from fascicle.reporting.ecg import EcgGroup, ecg_figure
from fascicle.reporting.hearts import activation_figure
from fascicle.reporting.study import activation_row
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
    """
    own, found = predicted[OWN_BEAT], predicted[name]
    groups = [EcgGroup(OWN_BEAT, "network", *qrs_aligned(own), GREY, BAND)]
    if found is not own:
        groups.append(EcgGroup(name, "network", *qrs_aligned(found), VERMILION, BAND))
    return ecg_figure(groups, f"Predicted ECG of {len(found.simulations)} networks")


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
        simulation = predicted.simulations[k]
        label = f"{which}, {simulation.total_activation_time:.0f} ms"
        rows.append(activation_row(label, simulation))
    return activation_figure(heart, rows)
