"""Twelve-lead ECGs: recorded against predicted, before against after."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.fitted_text import INCH, wrapped

SIZE = (10.0, 6.2)  # inch
CAPTION_ROOM = 0.97 * SIZE[0] * INCH  # mm
NAME_PLACE, NOTE_PLACE = (0.03, 0.95), (0.98, 0.95)  # of the axes
FINE_BOX, COARSE_BOX, TALL = 0.5, 1.0, 8.0  # mV; from a range of `TALL` on, boxes are coarse
BOX_MARGIN = 0.1  # of a box, at least, above and below
MOST_FINE_LINES = 50  # small boxes of time that are drawn
THIN_PINK, THICK_PINK = "#F0E1DF", "#E8CFCB"
ROWS, COLUMNS = 3, 4  # I II III | aVR aVL aVF | V1 V2 V3 | V4 V5 V6
SMALL_BOX = 40.0  # ms, one small square of ECG paper at 25 mm/s
TICK_STEPS = (40.0, 80.0, 200.0, 400.0, 1000.0)  # ms, multiples of the small box
MOST_TICKS = 6
BAND_OPACITY = 0.28


@dataclass(frozen=True)
class EcgGroup:
    """Several 12-lead ECGs on one time axis, drawn as their mean and the band they span.

    Attributes
    ----------
    name : str
        What the legend calls them.
    member : str
        What one of them belongs to: ``"beat"`` or ``"network"``.
    time : (t,) array
        Time (ms).
    leads : (n, 12, t) array
        Potential (mV), leads in the order of `fascicle.core.leads.LEADS`; NaN where an ECG has
        ended.
    colour : str
        Colour of line and band.
    share : float
        Of the ECGs that the band holds at every time, in the middle; 1 for their range.
    """

    name: str
    member: str
    time: Floats
    leads: Floats
    colour: str
    share: float = 1.0

    @property
    def label(self) -> str:
        """Name, and how many ECGs the line and the band stand for."""
        count = len(self.leads)
        band = "range" if self.share == 1 else f"{self.share:.0%}"
        shown = f"mean and {band} of {count} {self.member}s" if count > 1 else f"1 {self.member}"
        return f"{self.name} ({shown})"


def ecg_figure(
    groups: Sequence[EcgGroup],
    title: str | None = None,
    notes: Sequence[str] = (),
    time_zero: str = "",
    caption: str = "",
) -> Figure:
    """Draw groups of 12-lead ECGs over one another in the clinical 3 × 4 layout.

    Parameters
    ----------
    groups : sequence of EcgGroup
        Drawn in this order, each with its own time axis.
    title : str, optional
        Heading.
    notes : sequence of str, optional
        One a lead, written beside its name.
    time_zero : str, optional
        What happens at time 0.
    caption : str, optional
        Written below.

    Returns
    -------
    Figure
        Axes in the order of `fascicle.core.leads.LEADS`, all with the same limits (ms, mV). Lines
        are means over a group, bands hold its `share`.
    """
    figure = new_figure(*SIZE)
    panels = figure.subplots(ROWS, COLUMNS, sharex=True, sharey=True)
    for index, lead in enumerate(LEADS):
        axes = panels[index % ROWS, index // ROWS]
        for group in groups:
            _draw_lead(axes, group, index)
        style.write_in(axes, *NAME_PLACE, lead, va="top", fontweight="bold")
        if notes:
            size = style.TICK_SIZE
            style.write_in(axes, *NOTE_PLACE, notes[index], va="top", ha="right", fontsize=size)
    _set_scales(panels.flat, groups)
    figure.legend(
        [_handle(group) for group in groups],
        [group.label for group in groups],
        loc="outside upper right", ncols=len(groups), **style.LEGEND_STYLE,
    )  # fmt: skip
    style.set_title(figure, title)
    zero = f"; 0: {time_zero}" if time_zero else ""
    below = wrapped(caption, style.LABEL_SIZE, CAPTION_ROOM)
    figure.supxlabel("\n".join([f"time (ms{zero})", *below]), fontsize=style.LABEL_SIZE)
    figure.supylabel("potential (mV)", fontsize=style.LABEL_SIZE)
    return figure


def _handle(group: EcgGroup) -> Any:  # Matplotlib's stubs know no tuples of artists
    """Line on band, as in the panels."""
    line = Line2D([], [], color=group.colour, linewidth=style.THICK_LINE)
    if len(group.leads) == 1:
        return (line,)
    return (Patch(color=group.colour, alpha=BAND_OPACITY, linewidth=0), line)


def _draw_lead(axes: Axes, group: EcgGroup, lead: int) -> None:
    ecgs = group.leads[:, lead]
    if len(ecgs) > 1:
        ends = (1 - group.share) / 2, (1 + group.share) / 2
        there = np.isfinite(ecgs).any(axis=0)
        axes.fill_between(
            group.time[there], *np.nanquantile(ecgs[:, there], ends, axis=0),
            color=group.colour, alpha=BAND_OPACITY, linewidth=0,
        )  # fmt: skip
    mean = np.ma.masked_invalid(ecgs).mean(axis=0).filled(np.nan)
    axes.plot(group.time, mean, color=group.colour, linewidth=style.THICK_LINE, label=group.label)


def _set_scales(panels: Iterable[Axes], groups: Sequence[EcgGroup]) -> None:
    """One scale for all leads, on a grid of whole ECG-paper boxes."""
    start = min(float(group.time.min()) for group in groups)
    stop = max(float(group.time.max()) for group in groups)
    low = min(float(np.nanmin(group.leads)) for group in groups)
    high = max(float(np.nanmax(group.leads)) for group in groups)
    box = FINE_BOX if high - low <= TALL else COARSE_BOX
    bottom, top = box * np.floor(low / box - BOX_MARGIN), box * np.ceil(high / box + BOX_MARGIN)
    tick = next((s for s in TICK_STEPS if (stop - start) / s <= MOST_TICKS), TICK_STEPS[-1])
    for axes in panels:
        axes.set(xlim=(start, stop), ylim=(bottom, top))
        axes.xaxis.set_major_locator(MultipleLocator(tick))
        axes.yaxis.set_major_locator(MultipleLocator(2 * box))
        if stop - start <= MOST_FINE_LINES * SMALL_BOX:
            axes.xaxis.set_minor_locator(MultipleLocator(SMALL_BOX))
        axes.yaxis.set_minor_locator(MultipleLocator(box))
        axes.grid(which="minor", color=THIN_PINK, linewidth=0.5)
        axes.grid(which="major", color=THICK_PINK, linewidth=0.7)
        axes.set_axisbelow(True)
        style.finish_axes(axes)
        axes.tick_params(which="minor", length=0)
