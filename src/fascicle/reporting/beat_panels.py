"""A target's beats over one another, lead by lead, with the QRS window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, MultipleLocator

from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import LEADS
from fascicle.recording.target import Target
from fascicle.reporting import style

NAME_PLACE = (0.02, 0.96)  # of the axes
ROWS = 3  # I II III | aVR aVL aVF | V1 V2 V3 | V4 V5 V6
EARLIER, LATER = 80.0, 120.0  # ms that are shown about the QRS window
MARGIN = 0.06  # of the height, above and below
SMALLEST_RANGE = 0.2  # mV
SMALL_BOX = 40.0  # ms, one small square of ECG paper
MOST_DRAWN = 100  # beats; of more, evenly many over the recording
FEW = 15  # beats that are drawn with a stronger line
WINDOW, UNCERTAIN = "#EFEFEF", "#C9C9C9"
BAND_OPACITY = 0.25
GLOBAL_END: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.7, "linestyle": (0, (4, 3))}


def draw_beats(panels: Sequence[Axes], target: Target) -> None:
    """Draw every lead of a target into its panel, all to one scale.

    Parameters
    ----------
    panels : sequence of 12 Axes
        In the order of `fascicle.core.leads.LEADS`.
    target : Target
        Its beats are thin lines (at most `MOST_DRAWN` of them), its mean a thick one, on a band of
        one standard deviation each way; the window is shaded, its ends with theirs, and broken
        lines are the ends of the global QRS.
    """
    start = max(target.qrs_onset - EARLIER, float(target.time[0]))
    stop = min(target.qrs_offset + LATER, float(target.time[-1]))
    shown = (target.time >= start) & (target.time <= stop)
    mean, spread = target.mean, target.standard_deviation
    limits = _range(target, mean[:, shown], (mean - spread, mean + spread))
    for lead, axes in enumerate(panels):
        _draw_window(axes, target)
        name: dict[str, Any] = {"va": "top", "fontsize": style.LABEL_SIZE, "fontweight": "bold"}
        if target.used[lead]:
            _draw_lead(axes, target, lead, mean[lead], spread[lead])
            style.write_in(axes, *NAME_PLACE, LEADS[lead], **name)
        else:
            middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": style.TICK_SIZE}
            style.write_in(axes, 0.5, 0.5, "not used", color=style.GREY, **middle)
            style.write_in(axes, *NAME_PLACE, LEADS[lead], color=style.GREY, **name)
        axes.set(xlim=(start, stop), ylim=limits)
        _set_ticks(axes, lead)
    for axes in panels[::ROWS]:
        _name_ends(axes, target)


def drawn_beats(target: Target) -> Integers:
    """Which beats are drawn: all, or `MOST_DRAWN` evenly over the recording."""
    count = len(target.beats)
    return np.unique(np.linspace(0, count - 1, min(count, MOST_DRAWN)).round().astype(np.int64))


def panel_handles(target: Target) -> list[tuple[Any, str]]:  # Matplotlib has no type for handles
    """What a legend of the panels shows: an artist and its text each."""
    drawn, count = len(drawn_beats(target)), len(target.beats)
    beats = f"{drawn} of {count} beats" if drawn < count else f"{count} beats"
    band = Patch(color=style.BLUE, alpha=BAND_OPACITY, linewidth=0)
    mean = Line2D([], [], color=style.BLACK, linewidth=1.3)
    handles: list[tuple[Any, str]] = [(mean, "mean"), (band, "± 1 SD from beat to beat")]
    if target.noise is not None:
        name = "the beat" if count == 1 else f"mean of {count} beats"
        handles = [(mean, name), (band, f"± {target.noise:.3g} mV, noise as stated")]
    if count > 1:
        handles.insert(0, (Line2D([], [], color=style.BLUE, linewidth=0.6), beats))
    handles.append((Patch(facecolor=WINDOW, edgecolor=style.BLACK, linewidth=0.6), "QRS window"))
    if target.onset_sd > 0 or target.offset_sd > 0:
        handles.append((Patch(color=UNCERTAIN, linewidth=0), "its ends ± 1 SD"))
    handles.append((Line2D([], [], **GLOBAL_END), "global QRS (outermost leads)"))
    return handles


def _range(target: Target, mean: Floats, band: tuple[Floats, ...]) -> tuple[float, float]:
    """Limits (mV) that hold the mean where it is shown, and beats and band in the QRS window.

    An artefact outside the window may leave the panel rather than flatten all of them.
    """
    values = [mean, target.qrs_beats, *(edge[:, target.qrs_samples] for edge in band)]
    low = min(float(np.nanmin(part)) for part in values)
    high = max(float(np.nanmax(part)) for part in values)
    missing = max(SMALLEST_RANGE - (high - low), 0.0) / 2
    low, high = low - missing, high + missing
    return low - MARGIN * (high - low), high + MARGIN * (high - low)


def _draw_window(axes: Axes, target: Target) -> None:
    axes.axvspan(target.qrs_onset, target.qrs_offset, color=WINDOW, linewidth=0, zorder=0.2)
    onset, offset = (target.qrs_onset, target.onset_sd), (target.qrs_offset, target.offset_sd)
    for end, spread in (onset, offset):
        if spread > 0:
            axes.axvspan(end - spread, end + spread, color=UNCERTAIN, linewidth=0, zorder=0.3)
        axes.axvline(end, color=style.BLACK, linewidth=0.7, zorder=1.5)
    for end in target.global_qrs:
        axes.axvline(end, zorder=1.5, **GLOBAL_END)


def _draw_lead(axes: Axes, target: Target, lead: int, mean: Floats, spread: Floats) -> None:
    drawn = drawn_beats(target)
    band: dict[str, Any] = {"color": style.BLUE, "alpha": BAND_OPACITY, "linewidth": 0}
    axes.fill_between(target.time, mean - spread, mean + spread, **band)
    if len(target.beats) > 1:
        axes.add_collection(
            LineCollection(
                [np.stack([target.time, beat], axis=1) for beat in target.beats[drawn, lead]],
                colors=style.BLUE, linewidths=0.45 if len(drawn) <= FEW else 0.25,
                alpha=0.8 if len(drawn) <= FEW else 0.5, zorder=1.8,
            ),
            autolim=False,
        )  # fmt: skip
    axes.plot(target.time, mean, color=style.BLACK, linewidth=1.1)


def _set_ticks(axes: Axes, lead: int) -> None:
    """Ticks at whole boxes of ECG paper, named at the left and below alone."""
    start, stop = axes.get_xlim()
    step = SMALL_BOX * math.ceil((stop - start) / (5 * SMALL_BOX))
    axes.xaxis.set_major_locator(MultipleLocator(step))
    axes.xaxis.set_minor_locator(MultipleLocator(SMALL_BOX))
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.grid(which="both", color="#EBD9D6", linewidth=0.4)
    axes.set_axisbelow(True)
    style.finish_axes(axes)
    axes.tick_params(labelsize=style.TICK_SIZE - 1, pad=2)
    axes.tick_params(which="minor", length=0)
    axes.tick_params(labelleft=lead < ROWS, labelbottom=lead % ROWS == ROWS - 1)


def _name_ends(axes: Axes, target: Target) -> None:
    """Onset and offset (ms) above a column of panels."""
    for end, side in ((target.qrs_onset, "right"), (target.qrs_offset, "left")):
        axes.annotate(
            style.whole(end), (end, 1.0), xycoords=axes.get_xaxis_transform(), xytext=(0, 1.5),
            textcoords="offset points",
            ha=side, va="bottom", fontsize=style.TICK_SIZE - 1, color=style.BLACK,
        )  # fmt: skip
