"""Indices of several scenarios side by side: medians and intervals over the networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats
from fascicle.prediction.indices import INDICES
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure

SHOWN = (
    "qrs_duration", "global_qrs_duration", "total_activation_time", "lv_dyssynchrony",
    "lv_rv_delay", "qrs_area",
)  # fmt: skip
PANEL, NAMES, ROW, ROOM = 1.9, 2.4, 0.28, 1.2  # inch
HALF, MOST = (25, 75), (5, 95)  # percentiles that the thick and the thin bar hold
THICK, THIN, DOT = 4.5, 1.2, 4.0  # points


def index_name(index: str) -> str:
    """Name of an index as a reader knows it."""
    if index == "qrs_duration":
        return "window QRS duration"  # so that it is not taken for the global one
    words = index.replace("_", " ").replace("lv rv", "LV-RV")
    return " ".join({"qrs": "QRS", "lv": "LV", "rv": "RV"}.get(w, w) for w in words.split())


def index_figure(indices: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Draw indices of scenarios, a row each.

    Parameters
    ----------
    indices : mapping of scenario to mapping of index to (n,) array
        Over the networks.

    Returns
    -------
    Figure
        A panel for each index of `SHOWN`: the median, and what half and 90 % of the networks span.
    """
    rows = list(indices)
    figure = new_figure(NAMES + PANEL * len(SHOWN), ROOM + ROW * len(rows))
    panels = figure.subplots(1, len(SHOWN), sharey=True)
    for panel, index in zip(panels, SHOWN, strict=True):
        _draw(panel, [indices[name][index] for name in rows])
        style.finish_axes(panel, x=f"{index_name(index)} ({INDICES[index]})")
    panels[0].set_yticks(range(len(rows)), rows, fontsize=style.TICK_SIZE)
    panels[0].set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _draw(axes: Axes, values: Sequence[Floats]) -> None:
    """Values of each scenario, (n,), from the top down; the first, the own beat, in grey."""
    for row, of_networks in enumerate(values):
        colour = style.GREY if row == 0 else style.VERMILION
        for share, width in ((MOST, THIN), (HALF, THICK)):
            axes.plot(np.nanpercentile(of_networks, share), [row, row], color=colour, lw=width)
        axes.plot(
            np.nanmedian(of_networks), row, "o", color="white", markeredgecolor=colour, ms=DOT
        )
    axes.grid(axis="x", color="#EAEAEA", linewidth=style.FRAME_LINE)
    axes.set_axisbelow(True)
