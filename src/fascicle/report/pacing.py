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
    TICK_SIZE,
    TITLE_SIZE,
    VERMILION,
    new_figure,
    tidy,
)

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
    figure = new_figure(6.0, 4.2)
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
        Line2D([], [], color=GREY, linewidth=0.6, marker="o", markersize=4.5, label="network"),
        Line2D([], [], color=GREY, linewidth=2.5, label="median"),
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=LABEL_SIZE
    )
    if title is not None:
        figure.suptitle(title, fontsize=TITLE_SIZE, x=0.01, ha="left")
    return figure


def _draw_pairs(axes: Axes, name: str, before: ArrayLike, after: ArrayLike) -> None:
    pairs = [np.asarray(values, dtype=float) for values in (before, after)]
    if pairs[0].shape != pairs[1].shape or pairs[0].ndim != 1 or not pairs[0].size:
        raise InputError(
            f"{name}: {pairs[0].shape} values before and {pairs[1].shape} after; "
            "give one of each for every network"
        )
    axes.plot([0, 1], np.array(pairs), color=GREY, linewidth=0.6, alpha=0.5)
    for position, values, colour in zip((0, 1), pairs, (GREY, VERMILION), strict=True):
        axes.plot(
            np.full(values.size, position), values, "o", color=colour, markersize=4.5, alpha=0.7,
            markeredgewidth=0,
        )  # fmt: skip
        outward = np.array([-0.06, -0.24]) if position == 0 else np.array([0.06, 0.24])
        axes.plot(position + outward, [np.nanmedian(values)] * 2, color=colour, linewidth=2.5)
    change = pairs[1] - pairs[0]
    low, high = np.nanpercentile(change, INTERVAL)
    axes.set_title(
        f"median change {_signed(float(np.nanmedian(change)))} ms\n"
        f"(5–95 %: {_signed(float(low))} to {_signed(float(high))} ms)",
        fontsize=TICK_SIZE, color=BLACK,
    )  # fmt: skip
    axes.set_xlim(-0.4, 1.4)
    axes.set_ylabel(name, fontsize=LABEL_SIZE)
    axes.grid(axis="y", color="#EAEAEA", linewidth=0.6)
    axes.set_axisbelow(True)
    tidy(axes)


def _signed(change: float) -> str:
    """Write a whole number with a true minus sign; no sign on zero."""
    whole = round(change)
    return "0" if whole == 0 else f"{whole:+d}".replace("-", "−")
