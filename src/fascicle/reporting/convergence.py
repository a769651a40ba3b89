"""How the mismatch fell from one evaluation to the next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from fascicle.core.arrays import Floats
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure

SIZE = (7.0, 3.8)  # inch
INFEASIBLE_ROW, NAME_ROW = 0.985, 1.02  # of the axes' height
SHADES = ("#F3F3F3", "#FFFFFF")  # of one stage and the next
NARROW = 0.15  # share of the evaluations below which a stage is too narrow for its name
FLAT: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.0, "linestyle": (0, (4, 3))}
HEADROOM = 1.5  # free space above the largest and below the smallest loss, as a factor


def convergence_figure(losses: Floats, stages: Sequence[str], flat: float) -> Figure:
    """Loss of every evaluation and the best so far, beside that of a flat line.

    Parameters
    ----------
    losses : (n,) array
        Loss (mV²) in the order of evaluation; NaN where the parameters were infeasible.
    stages : sequence of n str
        Stage of each evaluation, such as ``"initial"``, ``"optimisation"``, ``"rejection"``.
    flat : float
        Loss of a flat line (mV²).

    Returns
    -------
    Figure
        One panel: dots on a logarithmic axis, running best as steps, infeasible ones as ticks along
        the upper edge, stages shaded and named, a broken line at the loss of a flat line.
    """
    figure = new_figure(*SIZE)
    axes = figure.subplots()
    axes.set_yscale("log", nonpositive="clip")  # a loss of exactly 0 lands on the lower edge
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(*_limits(np.append(losses[losses > 0], flat)))
    axes.set_xlim(0.5, len(losses) + 0.5)
    _draw_stages(axes, stages)
    _draw_losses(axes, losses)
    axes.axhline(flat, label=f"flat line ({flat:.3g} mV²)", **FLAT)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))
    style.finish_axes(axes, "evaluation number", "loss (mV²)")
    figure.legend(loc="outside lower center", ncols=4, **style.LEGEND_STYLE)
    return figure


def running_best(losses: Floats) -> Floats:
    """Smallest loss (mV²) up to each evaluation, shape (n,); NaN before the first feasible one."""
    return np.asarray(np.fmin.accumulate(losses))


def _limits(positive: Floats) -> tuple[float, float]:
    return float(positive.min()) / HEADROOM, float(positive.max()) * HEADROOM


def _draw_losses(axes: Axes, values: Floats) -> None:
    number = np.arange(1, len(values) + 1)
    feasible = np.isfinite(values)
    axes.plot(
        number[feasible], values[feasible], "o", markersize=3, markeredgewidth=0, alpha=0.6,
        color=style.BLUE, label="evaluation",
    )  # fmt: skip
    axes.step(
        number, running_best(values), where="post", color=style.VERMILION, linewidth=1.6,
        label="best so far",
    )  # fmt: skip
    if not feasible.all():
        infeasible = number[~feasible]
        axes.plot(
            infeasible, np.full(len(infeasible), INFEASIBLE_ROW), "|",
            transform=axes.get_xaxis_transform(), markersize=6, markeredgewidth=0.8,
            color=style.GREY, label=f"infeasible ({len(infeasible)})",
        )  # fmt: skip


def _draw_stages(axes: Axes, stages: Sequence[str]) -> None:
    for index, (name, first, last) in enumerate(stage_runs(stages)):
        axes.axvspan(first - 0.5, last + 0.5, color=SHADES[index % 2], linewidth=0, zorder=0)
        narrow = last - first + 1 < NARROW * len(stages)  # so is slanted, away from its neighbours
        axes.text(
            (first + last) / 2, NAME_ROW, name, transform=axes.get_xaxis_transform(),
            ha="left" if narrow else "center", va="bottom", rotation=30 if narrow else 0,
            rotation_mode="anchor", fontsize=style.LABEL_SIZE, color=style.BLACK,
        )  # fmt: skip


def stage_runs(stages: Sequence[str]) -> Iterator[tuple[str, int, int]]:
    """Name, first and last evaluation (counted from 1) of each stretch of one stage."""
    first = 1
    for name, run in groupby(stages):
        last = first + len(list(run)) - 1
        yield name, first, last
        first = last + 1
