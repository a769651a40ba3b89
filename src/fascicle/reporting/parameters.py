"""Figures of a fit: parameters of its networks, and convergence."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from fascicle.core.arrays import Floats
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.reporting import style
from fascicle.reporting.names import parameter_label
from fascicle.reporting.style import Colour

Marks = list[tuple[Mapping[str, float], dict[str, Any]]]  # parameters, and how they are drawn


@style.styled
def pair_figure(
    space: ParameterSpace,
    samples: Mapping[str, Floats],
    best: Mapping[str, float],
    truth: Mapping[str, float] | None = None,
    *,
    title: str = "",
) -> Figure:
    """Lower-triangle pair plot over the whole prior ranges, d (d+1)/2 axes, row by row.

    Scatter plots below the diagonal; on it, the histogram as a density, and the prior density as a
    broken line. Every panel marks the best-fitting parameters, and a synthetic target's `truth`.
    `samples` has the networks' values (n,) of each of the d parameters, in its unit.
    """
    count = len(space)
    figure = style.new_figure(0.95 * count + 2.5, 0.95 * count + 2.0, title)
    grid = figure.add_gridspec(count, count)
    diamond = {"color": Colour.VERMILION, "marker": "D", "markersize": 4.5}
    marks: Marks = [(best, diamond)]
    if truth is not None:
        marks.append((truth, {"color": "black", "marker": "X", "markersize": 5.5}))
    for row in range(count):
        for column in range(row + 1):
            axes = figure.add_subplot(grid[row, column])
            x, y = space.parameters[column], space.parameters[row]
            if row == column:
                _draw_marginal(axes, x, samples[x.name], marks)
            else:
                _draw_pair(axes, x, y, samples, marks)
            _name_outer(axes, x, y, bottom=row == count - 1, left=column == 0)
    networks = len(next(iter(samples.values())))
    handles: list[tuple[Any, str]] = [
        (Line2D([], [], ls="", marker="o", color=Colour.BLUE, alpha=0.6), f"network ({networks})"),
        (Patch(color=Colour.BLUE, alpha=0.45), "density of networks"),
        (Line2D([], [], color=Colour.GREY, linestyle="--"), "prior density"),
    ]
    names = ("best fit", "truth")
    handles += [(Line2D([], [], **m), name) for (_, m), name in zip(marks, names, strict=False)]
    place = "upper right" if count >= 4 else "outside right upper"  # in the empty triangle
    style.legend(figure, handles, loc=place, ncols=1, fontsize=8 + 0.5 * min(count, 12))
    figure.align_ylabels()
    return figure


def _draw_marginal(axes: Axes, parameter: Parameter, sample: Floats, marks: Marks) -> None:
    """Histogram with fine bins, because they span the whole prior."""
    bins = int(np.clip(2 * np.sqrt(len(sample)), 10, 40))
    edges = np.linspace(parameter.lower, parameter.upper, bins + 1)
    density, _ = np.histogram(sample, edges, density=True)
    axes.stairs(density, edges, fill=True, color=Colour.BLUE, alpha=0.45)
    within = np.linspace(parameter.lower, parameter.upper, 101)
    prior = parameter.density(within)
    axes.plot(within, prior, color=Colour.GREY, linewidth=1.0, linestyle="--")
    for point, look in marks:
        axes.axvline(point[parameter.name], color=look["color"])
    axes.set_ylim(0, 1.15 * max(float(density.max()), 2 * float(prior.mean()), float(prior.max())))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _draw_pair(
    axes: Axes, x: Parameter, y: Parameter, samples: Mapping[str, Floats], marks: Marks
) -> None:
    size = float(np.clip(1200 / len(samples[x.name]), 1.5, 9.0))  # points²
    axes.scatter(samples[x.name], samples[y.name], s=size, color=Colour.BLUE, alpha=0.65, lw=0)
    for point, look in marks:
        white = look | {"linestyle": "", "markeredgecolor": "white", "markeredgewidth": 0.5}
        axes.plot(point[x.name], point[y.name], **white)
    axes.set_ylim(y.lower, y.upper)
    axes.yaxis.set_major_locator(MaxNLocator(3, prune="both", steps=[1, 2, 2.5, 5, 10]))


def _name_outer(axes: Axes, x: Parameter, y: Parameter, *, bottom: bool, left: bool) -> None:
    """Name the outer axes only, on lines of 13 characters."""
    axes.set_xlim(x.lower, x.upper)
    axes.xaxis.set_major_locator(MaxNLocator(3, prune="both", steps=[1, 2, 2.5, 5, 10]))
    axes.tick_params(labelbottom=bottom, labelleft=left)
    below, left_of = (
        textwrap.fill(parameter_label(p.name, p.unit), 13, break_long_words=False) for p in (x, y)
    )
    if bottom:
        axes.set_xlabel(below)
    if left:
        axes.set_ylabel("density" if x is y else left_of)


@style.styled
def prior_figure(space: ParameterSpace, values: Mapping[str, Floats]) -> Figure:
    """Histograms of the networks' values (n,) of each parameter, with the prior densities."""
    count = len(space.parameters)
    rows = -(-count // 4)
    figure = style.new_figure(8.4, 1.35 * rows)
    panels = figure.subplots(rows, 4, squeeze=False)
    shares = np.linspace(0.005, 0.995, 200)  # quantiles of a prior at which its curve is drawn
    for panel, parameter in zip(panels.flat, space.parameters, strict=False):
        at = parameter.from_unit(shares)
        inside = np.clip(values[parameter.name], at[0], at[-1])  # values beyond count at the ends
        edges = np.linspace(at[0], at[-1], 25)
        panel.hist(inside, edges, density=True, color=Colour.VERMILION, alpha=0.6)
        panel.plot(at, np.gradient(shares, at), color=Colour.GREY)
        label = parameter_label(parameter.name, parameter.unit)
        panel.set(xlabel=textwrap.fill(label, 30), yticks=[])
    for panel in panels.flat[count:]:
        panel.set_axis_off()
    return figure


def draw_convergence(axes: Axes, losses: Floats, stages: Sequence[str], null: float) -> None:
    """Draw the loss of every evaluation, the best so far, and the null loss.

    Losses (n,) (mV²), in the order of evaluation, are dots on a logarithmic axis; the best so far
    is a step line. Infeasible parameters (NaN) are ticks along the upper edge. The stages (n,) are
    shaded and named. A broken line marks the null loss `null`, that of a flat line.
    """
    positive = np.append(losses[losses > 0], null)
    axes.set_yscale("log", nonpositive="clip")  # a loss of exactly 0 lands on the lower edge
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="evaluation number", ylabel="loss (mV²)", xlim=(0.5, len(losses) + 0.5))
    axes.set_ylim(float(positive.min()) / 1.5, float(positive.max()) * 1.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))
    first = 0.5
    for index, (name, run) in enumerate(groupby(stages)):
        last = first + len(list(run))
        axes.axvspan(first, last, color=("#F3F3F3", "#FFFFFF")[index % 2], linewidth=0, zorder=0)
        narrow = last - first < 0.15 * len(stages)  # then the name is slanted
        axes.text(
            (first + last) / 2, 1.02, name, transform=axes.get_xaxis_transform(), va="bottom",
            ha="left" if narrow else "center", rotation=30 if narrow else 0,
            rotation_mode="anchor",
        )  # fmt: skip
        first = last
    number, feasible = np.arange(1, len(losses) + 1), np.isfinite(losses)
    dots: dict[str, Any] = {"markersize": 3, "markeredgewidth": 0, "alpha": 0.6}
    dots |= {"color": Colour.BLUE, "label": "evaluation"}
    axes.plot(number[feasible], losses[feasible], "o", **dots)
    best = np.fmin.accumulate(losses)
    axes.step(number, best, where="post", color=Colour.VERMILION, label="best so far")
    if not feasible.all():
        at = number[~feasible]
        axes.plot(
            at, np.full(len(at), 0.985), "|", transform=axes.get_xaxis_transform(), markersize=6,
            color=Colour.GREY, label=f"infeasible ({len(at)})",
        )  # fmt: skip
    axes.axhline(null, label=f"flat line ({null:.3g} mV²)", color="black", lw=1, ls=(0, (4, 3)))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=4)
