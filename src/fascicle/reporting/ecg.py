"""Twelve-lead ECGs over one another: recorded and predicted, before and after."""

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

ROWS = 3  # I II III | aVR aVL aVF | V1 V2 V3 | V4 V5 V6


@dataclass(frozen=True)
class EcgGroup:
    """Several 12-lead ECGs on one time axis, drawn as their mean and the band they span.

    Attributes
    ----------
    name, member : str
        What the legend calls them, and one of them: ``"beat"`` or ``"network"``.
    time : (t,) array
        Time (ms).
    leads : (n, 12, t) array
        Potential (mV); NaN where an ECG has ended.
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

    @property
    def looks(self) -> dict[str, Any]:
        """How the band is drawn."""
        return {"color": self.colour, "alpha": 0.28, "linewidth": 0}

    @property
    def handle(self) -> Any:
        """Line on band, as in the panels, for a legend."""
        line = Line2D([], [], color=self.colour)
        return (Patch(**self.looks), line) if len(self.leads) > 1 else (line,)

    def draw(self, axes: Axes, lead: int) -> None:
        """Draw one lead."""
        ecgs = self.leads[:, lead]
        if len(ecgs) > 1:
            ends = (1 - self.share) / 2, (1 + self.share) / 2
            there = np.isfinite(ecgs).any(axis=0)
            band = np.nanquantile(ecgs[:, there], ends, axis=0)
            axes.fill_between(self.time[there], *band, **self.looks)
        mean = np.ma.masked_invalid(ecgs).mean(axis=0).filled(np.nan)
        axes.plot(self.time, mean, color=self.colour, label=self.label)


@style.styled
def ecg_figure(
    groups: Sequence[EcgGroup],
    title: str = "",
    notes: Sequence[str] = ("",) * len(LEADS),
    time_zero: str = "",
    caption: str = "",
) -> Figure:
    """Draw groups of 12-lead ECGs over one another in the clinical 3 × 4 layout.

    Lines are means over a group, bands hold its `share`; every group has its own time axis, and all
    axes have the same limits (ms, mV). There is a note for each lead, and a caption below.
    """
    figure = style.new_figure(10.0, 6.2, title)
    grid = figure.subplots(ROWS, len(LEADS) // ROWS, sharex=True, sharey=True)
    panels = list(grid.T.flat)
    for lead, (axes, name, note) in enumerate(zip(panels, LEADS, notes, strict=True)):
        for group in groups:
            group.draw(axes, lead)
        style.name_lead(axes, name, note)
    _set_scales(panels, groups)
    style.legend(figure, [(group.handle, group.label) for group in groups])
    zero = f"; 0: {time_zero}" if time_zero else ""
    style.below_leads(figure, f"time (ms{zero})", caption)
    return figure


def _set_scales(panels: Iterable[Axes], groups: Sequence[EcgGroup]) -> None:
    """One scale for all leads, on a grid of whole ECG-paper boxes."""
    start = min(float(group.time.min()) for group in groups)
    stop = max(float(group.time.max()) for group in groups)
    low = min(float(np.nanmin(group.leads)) for group in groups)
    high = max(float(np.nanmax(group.leads)) for group in groups)
    box = 0.5 if high - low <= 8 else 1.0  # mV
    bottom, top = box * np.floor(low / box - 0.1), box * np.ceil(high / box + 0.1)
    for axes in panels:
        axes.set(xlim=(start, stop), ylim=(bottom, top))
        axes.yaxis.set_major_locator(MultipleLocator(2 * box))
        axes.yaxis.set_minor_locator(MultipleLocator(box))
        draw_time_grid(axes)


def draw_time_grid(axes: Axes) -> None:
    """Ticks (ms) at whole boxes of ECG paper, 40 ms wide at 25 mm/s, and a grid."""
    start, stop = axes.get_xlim()
    tick = next((s for s in (40, 80, 200, 400, 1000) if (stop - start) / s <= 6), 1000)
    axes.xaxis.set_major_locator(MultipleLocator(tick))
    if stop - start <= 50 * 40:
        axes.xaxis.set_minor_locator(MultipleLocator(40))
    axes.grid(which="both", color=style.Colour.PAPER, linewidth=0.5)
