"""QRS duration and total activation time of every network, before and after a therapy."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fascicle.core.arrays import Floats
from fascicle.predict.pacing import Pacing
from fascicle.report import style
from fascicle.report.figures import new_figure

SIZE = (6.0, 4.2)  # inch
PAIR_LINE, MEDIAN_LINE, DOT = 0.6, 2.5, 4.5  # points
MEDIAN_BAR = (0.06, 0.24)  # from the dots outwards, of the distance between before and after
SIDE_ROOM = 0.4  # beside the dots
PERCENTILES = (5.0, 50.0, 95.0)  # of the change


def pacing_figure(pacing: Pacing, labels: tuple[str, str]) -> Figure:
    """Paired dot plot: one thin line a network, thick bars at the medians.

    Parameters
    ----------
    pacing : Pacing
        Durations (ms) of n networks before and after.
    labels : tuple of two str
        Names on the horizontal axis.

    Returns
    -------
    Figure
        Two panels, QRS duration (ms) and total activation time (ms), with the median of the paired
        change and its 5th to 95th percentile.
    """
    figure = new_figure(*SIZE)
    qrs, activation = figure.subplots(1, 2, sharey=True)
    _draw_pairs(qrs, np.array([pacing.qrs_before, pacing.qrs_after]))
    _draw_pairs(activation, np.array([pacing.tat_before, pacing.tat_after]))
    style.finish_axes(qrs, y="QRS duration (ms)")
    style.finish_axes(activation, y="total activation time (ms)")
    for axes in (qrs, activation):
        axes.set_xticks([0, 1], labels, fontsize=style.LABEL_SIZE)
        axes.tick_params(labelleft=True)
    dots: dict[str, Any] = {"linewidth": PAIR_LINE, "marker": "o", "markersize": DOT}
    handles = [
        Line2D([], [], color=style.GREY, label="network", **dots),
        Line2D([], [], color=style.GREY, label="median", linewidth=MEDIAN_LINE),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, **style.LEGEND_STYLE)
    return figure


def _draw_pairs(axes: Axes, pairs: Floats) -> None:
    """Durations (2, n) before and after (ms), with the change in the title."""
    axes.plot([0, 1], pairs, color=style.GREY, linewidth=PAIR_LINE, alpha=0.5)
    for position, values, colour in zip((0, 1), pairs, (style.GREY, style.VERMILION), strict=True):
        axes.plot(
            np.full(values.size, position), values, "o", color=colour, markersize=DOT, alpha=0.7,
            markeredgewidth=0,
        )  # fmt: skip
        bar = position + np.array(MEDIAN_BAR) * (1 if position else -1)
        axes.plot(bar, [np.nanmedian(values)] * 2, color=colour, linewidth=MEDIAN_LINE)
    change = pairs[1] - pairs[0]
    low, middle, high = (
        style.whole(value, signed=True) for value in np.nanpercentile(change, PERCENTILES)
    )
    axes.set_title(
        f"median change {middle} ms\n(5–95 %: {low} to {high} ms)",
        fontsize=style.TICK_SIZE, color=style.BLACK,
    )  # fmt: skip
    axes.set_xlim(-SIDE_ROOM, 1 + SIDE_ROOM)
    axes.grid(axis="y", color="#EAEAEA", linewidth=PAIR_LINE)
    axes.set_axisbelow(True)
