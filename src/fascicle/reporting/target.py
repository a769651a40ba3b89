"""The beats of a target over one another, lead by lead, with the QRS window."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS
from fascicle.recording.target import Target
from fascicle.reporting import style
from fascicle.reporting.ecg import ROWS, draw_time_grid
from fascicle.reporting.style import Colour

# How parts are drawn, in panels and legend
BAND: dict[str, Any] = {"color": Colour.BLUE, "alpha": 0.25, "linewidth": 0}
WINDOW: dict[str, Any] = {"color": "#EFEFEF", "linewidth": 0}
UNCERTAIN: dict[str, Any] = {"color": "#C9C9C9", "linewidth": 0}
GLOBAL_END: dict[str, Any] = {"color": "black", "linewidth": 0.7, "linestyle": (0, (4, 3))}


@style.styled
def target_figure(target: Target) -> Figure:
    """Draw the beats of a target over one another, lead by lead, with the QRS window."""
    figure = style.new_figure(10.0, 6.2)
    draw_target(figure, target)
    return figure


def draw_target(figure: Figure | SubFigure, target: Target) -> None:
    """Draw every lead of a target, all to one scale.

    Beats are thin lines (at most 100 of them, evenly over the recording), their mean a thick one,
    on a band of one standard deviation each way; the window is shaded, its ends with theirs, and
    broken lines are the ends of the global QRS.
    """
    start = max(target.qrs_onset - 80, float(target.time[0]))  # ms
    stop = min(target.qrs_offset + 120, float(target.time[-1]))
    mean, spread = target.mean, target.standard_deviation
    limits = _limits(target, mean[:, (target.time >= start) & (target.time <= stop)])
    count = len(target.beats)
    drawn = np.unique(np.linspace(0, count - 1, min(count, 100)).round().astype(np.int64))
    grid = figure.subplots(ROWS, len(LEADS) // ROWS, sharex=True, sharey=True)
    for lead, (axes, name) in enumerate(zip(grid.T.flat, LEADS, strict=True)):
        _draw_window(axes, target)
        if target.used[lead]:
            band = mean[lead] - spread[lead], mean[lead] + spread[lead]
            axes.fill_between(target.time, *band, **BAND)
            _draw_beats(axes, target, lead, drawn)
            axes.plot(target.time, mean[lead], color="black", label="mean")
        style.name_lead(axes, name if target.used[lead] else f"{name} not used")
        axes.set(xlim=(start, stop), ylim=limits)
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        draw_time_grid(axes)
    onset, offset = style.signed(target.qrs_onset), style.signed(target.qrs_offset)
    style.below_leads(figure, f"time from the R peak (ms); QRS window {onset} to {offset} ms")
    handles = _handles(target, len(drawn))
    style.legend(figure, handles, ncols=len(handles) if isinstance(figure, Figure) else 3)


def _handles(target: Target, drawn: int) -> list[tuple[Any, str]]:
    """What a legend of the panels shows: an artist and its text each."""
    count = len(target.beats)
    mean, band = Line2D([], [], color="black"), Patch(**BAND)
    handles: list[tuple[Any, str]] = [(mean, "mean"), (band, "± 1 SD from beat to beat")]
    if target.noise is not None:
        name = "the beat" if count == 1 else f"mean of {count} beats"
        handles = [(mean, name), (band, f"± {target.noise:.3g} mV, noise as stated")]
    if count > 1:
        beats = f"{drawn} of {count} beats" if drawn < count else f"{count} beats"
        handles.insert(0, (Line2D([], [], color=Colour.BLUE, linewidth=0.6), beats))
    handles.append((Patch(**WINDOW), "QRS window"))
    if target.onset_sd > 0 or target.offset_sd > 0:
        handles.append((Patch(**UNCERTAIN), "its ends ± 1 SD"))
    return [*handles, (Line2D([], [], **GLOBAL_END), "global QRS (outermost leads)")]


def _limits(target: Target, mean: Floats) -> tuple[float, float]:
    """Limits (mV) that hold the mean where it is shown, and beats and band in the QRS window.

    An artefact outside the window may leave the panel rather than flatten all of them.
    """
    band = target.standard_deviation[:, target.qrs_samples]
    inside = target.mean[:, target.qrs_samples]
    values = [mean, target.qrs_beats, inside - band, inside + band]
    low = min(float(np.nanmin(part)) for part in values)
    high = max(float(np.nanmax(part)) for part in values)
    missing = max(0.2 - (high - low), 0.0) / 2  # of a range of 0.2 mV, at least
    margin = missing + 0.06 * (high - low + 2 * missing)
    return low - margin, high + margin


def _draw_window(axes: Axes, target: Target) -> None:
    axes.axvspan(target.qrs_onset, target.qrs_offset, zorder=0.2, **WINDOW)
    onset, offset = (target.qrs_onset, target.onset_sd), (target.qrs_offset, target.offset_sd)
    for end, spread in (onset, offset):
        if spread > 0:
            axes.axvspan(end - spread, end + spread, zorder=0.3, **UNCERTAIN)
        axes.axvline(end, color="black", linewidth=0.7, zorder=1.5)
    for end in target.global_qrs:
        axes.axvline(end, zorder=1.5, **GLOBAL_END)


def _draw_beats(axes: Axes, target: Target, lead: int, drawn: Integers) -> None:
    """Thin lines, thinner where there are many."""
    if len(target.beats) > 1:
        few = len(drawn) <= 15
        lines = [np.stack([target.time, beat], axis=1) for beat in target.beats[drawn, lead]]
        beats = LineCollection(
            lines, colors=Colour.BLUE, linewidths=0.45 if few else 0.25, alpha=0.8 if few else 0.5,
            zorder=1.8,
        )  # fmt: skip
        axes.add_collection(beats, autolim=False)
