"""QRS duration and total activation time of every network, before and after a therapy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.report.figures import (
    BLACK,
    GREY,
    LABEL_SIZE,
    LEGEND_STYLE,
    TICK_SIZE,
    VERMILION,
    finish_axes,
    new_figure,
    set_title,
)

SIZE = (6.0, 4.2)  # inch
PAIR_LINE, MEDIAN_LINE, DOT = 0.6, 2.5, 4.5  # points
MEDIAN_BAR = (0.06, 0.24)  # from the dots outwards, of the distance between before and after
SIDE_ROOM = 0.4  # beside the dots
INTERVAL = (5.0, 95.0)  # percentiles given with the median change


@dataclass(frozen=True)
class Durations:
    """How long activation takes in each network.

    Attributes
    ----------
    qrs : (n,) array
        QRS duration (ms).
    total_activation : (n,) array
        From first to last activation in the myocardium (ms).
    """

    qrs: Floats
    total_activation: Floats


def pacing_figure(
    before: Durations,
    after: Durations,
    *,
    labels: tuple[str, str] = ("before", "after"),
    title: str | None = None,
) -> Figure:
    """Paired dot plot: one thin line a network, thick bars at the medians.

    Parameters
    ----------
    before, after : Durations
        The same n networks in the same order.
    labels : tuple of two str
        Names on the horizontal axis.
    title : str, optional
        Heading.

    Returns
    -------
    Figure
        Two panels, QRS duration (ms) and total activation time (ms), with the median of the paired
        change and its 5th to 95th percentile.

    Raises
    ------
    InputError
        If the two have different numbers of networks.
    """
    figure = new_figure(*SIZE)
    panels = figure.subplots(1, 2, sharey=True)
    quantities = [
        ("QRS duration (ms)", before.qrs, after.qrs),
        ("total activation time (ms)", before.total_activation, after.total_activation),
    ]
    for axes, (name, first, second) in zip(panels, quantities, strict=True):
        _draw_pairs(axes, name, first, second)
        axes.set_xticks([0, 1], labels, fontsize=LABEL_SIZE)
        axes.tick_params(labelleft=True)
    handles = [
        Line2D(
            [], [], color=GREY, linewidth=PAIR_LINE, marker="o", markersize=DOT, label="network"
        ),
        Line2D([], [], color=GREY, linewidth=MEDIAN_LINE, label="median"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, **LEGEND_STYLE)
    set_title(figure, title)
    return figure


def _draw_pairs(axes: Axes, name: str, before: ArrayLike, after: ArrayLike) -> None:
    pairs = [np.asarray(values, dtype=float) for values in (before, after)]
    if pairs[0].shape != pairs[1].shape or pairs[0].ndim != 1 or not pairs[0].size:
        raise InputError(
            f"{name}: {pairs[0].shape} values before and {pairs[1].shape} after; "
            "give one of each for every network"
        )
    axes.plot([0, 1], np.array(pairs), color=GREY, linewidth=PAIR_LINE, alpha=0.5)
    for position, values, colour in zip((0, 1), pairs, (GREY, VERMILION), strict=True):
        axes.plot(
            np.full(values.size, position), values, "o", color=colour, markersize=DOT, alpha=0.7,
            markeredgewidth=0,
        )  # fmt: skip
        outward = np.array(MEDIAN_BAR) * (1 if position else -1)
        axes.plot(
            position + outward, [np.nanmedian(values)] * 2, color=colour, linewidth=MEDIAN_LINE
        )
    change = pairs[1] - pairs[0]
    low, high = np.nanpercentile(change, INTERVAL)
    axes.set_title(
        f"median change {_signed(float(np.nanmedian(change)))} ms\n"
        f"(5–95 %: {_signed(float(low))} to {_signed(float(high))} ms)",
        fontsize=TICK_SIZE, color=BLACK,
    )  # fmt: skip
    axes.set_xlim(-SIDE_ROOM, 1 + SIDE_ROOM)
    axes.grid(axis="y", color="#EAEAEA", linewidth=PAIR_LINE)
    axes.set_axisbelow(True)
    finish_axes(axes, y=name)


def _signed(change: float) -> str:
    """Write a whole number with a true minus sign; no sign on zero."""
    whole = round(change)
    return "0" if whole == 0 else f"{whole:+d}".replace("-", "−")
