"""What networks say about each parameter and each pair of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.names import on_narrow_axis, parameter_name, with_unit

PANEL = 0.95  # inch
MARGIN = 1.25  # inch, at the left and below, for names on four lines
FEW, LEGEND_ROOM = 4, 1.75  # parameters whose empty triangle holds the legend; inch beside fewer
LEGEND_SIZE = 14.0  # points, where the empty triangle has room
NAME_SIZE, TICK_SIZE = 11.0, 9.5  # points
PRIOR_POINTS = 101  # of the curve of a prior
BINS = (10, 40)  # fewest and most in a histogram

BEST_MARK: dict[str, Any] = {
    "color": style.VERMILION, "marker": "D", "markersize": 4.5, "label": "best fit",
}  # fmt: skip
TRUTH_MARK: dict[str, Any] = {
    "color": style.BLACK, "marker": "X", "markersize": 5.5, "label": "truth",
}  # fmt: skip
Marks = list[tuple[Mapping[str, float], dict[str, Any]]]  # parameters, and how they are drawn


def pair_figure(
    space: ParameterSpace,
    samples: Mapping[str, Floats],
    best: Mapping[str, float],
    truth: Mapping[str, float] | None = None,
    *,
    title: str | None = None,
) -> Figure:
    """Lower-triangle pair plot on the whole prior range.

    Parameters
    ----------
    space : ParameterSpace
        The d free parameters; its ranges are the axes' limits.
    samples : mapping of name to (n,) array
        The networks, each parameter in its own unit.
    best : mapping of name to float
        The best-fitting parameters, marked in every panel.
    truth : mapping of name to float, optional
        The parameters that made a synthetic target, marked in every panel.
    title : str, optional
        Heading.

    Returns
    -------
    Figure
        d (d+1)/2 axes, row by row: scatter below the diagonal; on it, the histogram as a density
        against the prior as a broken line.
    """
    size = len(space)
    side = max(PANEL * size + MARGIN + 0.4, 4.0)
    wide = side + (LEGEND_ROOM if size < FEW else 0.0)
    figure = new_figure(wide, side, constrained=False)
    grid = figure.add_gridspec(
        size, size, hspace=0.09, wspace=0.09,
        left=MARGIN / wide, bottom=MARGIN / side, right=(side - 0.25) / wide, top=1 - 0.4 / side,
    )  # fmt: skip
    marks: Marks = [(best, BEST_MARK)]
    if truth is not None:
        marks.append((truth, TRUTH_MARK))
    for row in range(size):
        for column in range(row + 1):
            axes = figure.add_subplot(grid[row, column])
            x, y = space.parameters[column], space.parameters[row]
            if row == column:
                _draw_marginal(axes, x, samples[x.name], marks)
            else:
                _draw_pair(axes, x, y, samples, marks)
            _label(axes, x, y, bottom=row == size - 1, left=column == 0)
    _legend(figure, len(next(iter(samples.values()))), marks)
    figure.align_ylabels()
    if title is not None:
        figure.suptitle(
            title, fontsize=1.2 * style.TITLE_SIZE, x=0.25 / wide, y=1 - 0.15 / side, ha="left"
        )
    return figure


def _draw_marginal(axes: Axes, parameter: Parameter, sample: Floats, marks: Marks) -> None:
    edges = np.linspace(parameter.lower, parameter.upper, _bins(len(sample)) + 1)
    density, _ = np.histogram(sample, edges, density=True)
    axes.stairs(density, edges, fill=True, color=style.BLUE, alpha=0.45)
    within = np.linspace(parameter.lower, parameter.upper, PRIOR_POINTS)
    prior = parameter.density(within)
    axes.plot(within, prior, color=style.GREY, linewidth=1.0, linestyle="--")
    for point, mark in marks:
        axes.axvline(point[parameter.name], color=mark["color"], linewidth=1.2)
    axes.set_ylim(0, 1.15 * max(float(density.max()), 2 * float(prior.mean()), float(prior.max())))
    axes.set_yticks([])
    axes.spines[["top", "right", "left"]].set_visible(False)


def _bins(count: int) -> int:
    """Twice the square root of the count: finer than usual, for the bins span the whole prior."""
    return int(np.clip(2 * np.sqrt(count), *BINS))


def _draw_pair(
    axes: Axes, x: Parameter, y: Parameter, samples: Mapping[str, Floats], marks: Marks
) -> None:
    size = float(np.clip(1200 / len(samples[x.name]), 1.5, 9.0))  # points²
    axes.scatter(
        samples[x.name], samples[y.name], s=size, color=style.BLUE, alpha=0.65, linewidths=0
    )
    for point, mark in marks:
        axes.plot(
            point[x.name], point[y.name], linestyle="", markeredgecolor="white",
            markeredgewidth=0.5, **mark,
        )  # fmt: skip
    axes.set_ylim(y.lower, y.upper)
    axes.yaxis.set_major_locator(MaxNLocator(3, prune="both", steps=[1, 2, 2.5, 5, 10]))


def _label(axes: Axes, x: Parameter, y: Parameter, *, bottom: bool, left: bool) -> None:
    """Name the outer axes only."""
    axes.set_xlim(x.lower, x.upper)
    axes.xaxis.set_major_locator(MaxNLocator(3, prune="both", steps=[1, 2, 2.5, 5, 10]))
    axes.tick_params(labelsize=TICK_SIZE, width=0.5, length=2, pad=1.5)
    for spine in axes.spines.values():
        spine.set_linewidth(0.5)
    if bottom:
        axes.set_xlabel(_title(x), fontsize=NAME_SIZE)
    else:
        axes.tick_params(labelbottom=False)
    if left and x is not y:
        axes.set_ylabel(_title(y), fontsize=NAME_SIZE)
    elif left:
        axes.set_ylabel("density", fontsize=NAME_SIZE)
    else:
        axes.tick_params(labelleft=False)


def _title(parameter: Parameter) -> str:
    return on_narrow_axis(with_unit(parameter_name(parameter.name), parameter.unit))


def _legend(figure: Figure, count: int, marks: Marks) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], linestyle="", marker="o", color=style.BLUE, alpha=0.6, markersize=4,
               label=f"network ({count})"),
        Patch(color=style.BLUE, alpha=0.45, label="density of networks"),
        Line2D([], [], color=style.GREY, linewidth=1.0, linestyle="--", label="prior density"),
    ]  # fmt: skip
    handles += [Line2D([], [], linewidth=1.2, **mark) for _, mark in marks]
    size = style.LABEL_SIZE if figure.get_figwidth() < 8 else LEGEND_SIZE
    figure.legend(
        handles=handles, loc="upper right", frameon=False, fontsize=size,
        bbox_to_anchor=(0.98, 1 - 0.35 / figure.get_figheight()),
    )  # fmt: skip
