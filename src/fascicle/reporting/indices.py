"""Indices of several scenarios side by side: medians and intervals over the networks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.arrays import Floats
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.fitted_text import shortened
from fascicle.reporting.names import index_label

SHOWN = (
    "qrs_duration", "global_qrs_duration", "total_activation_time", "lv_dyssynchrony",
    "lv_rv_delay", "qrs_area",
)  # fmt: skip
COLUMNS = 3  # of panels
PANEL, NAMES, ROW, ROOM = 2.15, 2.25, 0.28, 0.65  # inch
NAME_ROOM = 55.0  # mm, for the name of a scenario
HALF, MOST = (25, 75), (5, 95)  # percentiles that the thick and the thin bar hold
THICK, THIN, DOT = 4.5, 1.2, 4.0  # points


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
    rows, lines = list(indices), -(-len(SHOWN) // COLUMNS)
    figure = new_figure(NAMES + PANEL * COLUMNS, lines * (ROOM + ROW * len(rows)))
    panels = figure.subplots(lines, COLUMNS, sharey=True)
    for panel, index in zip(panels.flat, SHOWN, strict=True):
        _draw(panel, [indices[name][index] for name in rows])
        style.finish_axes(panel, x=index_label(index))
    names = [shortened(name, style.LABEL_SIZE, NAME_ROOM) for name in rows]
    for first, *_ in panels:
        first.set_yticks(range(len(rows)), names, fontsize=style.LABEL_SIZE)
        first.set_ylim(len(rows) - 0.5, -0.5)
    return figure


def _draw(axes: Axes, values: Sequence[Floats]) -> None:
    """Values of each scenario, (n,), from the top down; the first, the intrinsic beat, in grey."""
    for row, of_networks in enumerate(values):
        colour = style.GREY if row == 0 else style.VERMILION
        for share, width in ((MOST, THIN), (HALF, THICK)):
            axes.plot(np.nanpercentile(of_networks, share), [row, row], color=colour, lw=width)
        axes.plot(
            np.nanmedian(of_networks), row, "o", color="white", markeredgecolor=colour, ms=DOT
        )
    axes.grid(axis="x", color="#EAEAEA", linewidth=style.FRAME_LINE)
    axes.set_axisbelow(True)
