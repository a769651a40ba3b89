"""Figures of superimposed twelve-lead ECGs, and of the action potential they are computed with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, MultipleLocator

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS
from fascicle.core.progress import Progress
from fascicle.recording.target import Target
from fascicle.reporting import style
from fascicle.reporting.style import Colour

if TYPE_CHECKING:
    from fascicle.forward.template import CableTemplate

# Looks of a target's parts, in panels and legend
LOOKS: dict[str, dict[str, Any]] = {
    "band": {"color": Colour.BLUE, "alpha": 0.25, "linewidth": 0},
    "window": {"color": "#EFEFEF", "linewidth": 0},
    "uncertain": {"color": "#C9C9C9", "linewidth": 0},
}


@dataclass(frozen=True)
class EcgGroup:
    """Several ECGs on one time axis, drawn as their mean and the band they span."""

    name: str  # name of the group in the legend
    member: str  # name of one ECG: "beat" or "network"
    time: Floats  # (t,) ms
    leads: Floats  # (n, 12 + k, t) mV; NaN where an ECG has ended
    colour: str
    share: float = 1.0  # share of the ECGs within the band at every time; 1: their range

    @property
    def label(self) -> str:
        """Name of the group, with the meaning of line and band and the number of ECGs."""
        count = len(self.leads)
        band = "range" if self.share == 1 else f"{self.share:.0%}"
        shown = f"mean and {band} of {count} {self.member}s" if count > 1 else f"1 {self.member}"
        return f"{self.name} ({shown})"

    @property
    def looks(self) -> dict[str, Any]:
        """Look of the band."""
        return {"color": self.colour, "alpha": 0.28, "linewidth": 0}

    @property
    def handle(self) -> Any:
        """Line on band, as in the panels, for a legend."""
        line = Line2D([], [], color=self.colour)
        return (Patch(**self.looks), line) if len(self.leads) > 1 else (line,)

    def draw(self, axes: Axes, lead: int) -> None:
        """Draw the group's ECGs in one lead."""
        ecgs = self.leads[:, lead]
        finite = np.isfinite(ecgs).any(axis=0)
        if len(ecgs) > 1 and finite.any():  # a lead that was not recorded has no band
            ends = (1 - self.share) / 2, (1 + self.share) / 2
            band = np.nanquantile(ecgs[:, finite], ends, axis=0)
            axes.fill_between(self.time[finite], *band, **self.looks)
        mean = np.ma.masked_invalid(ecgs).mean(axis=0).filled(np.nan)
        axes.plot(self.time, mean, color=self.colour, label=self.label)


@style.styled
def ecg_figure(
    groups: Sequence[EcgGroup],
    title: str = "",
    notes: Sequence[str] = (),
    time_zero: str = "",
    caption: str = "",
    leads: Sequence[str] = LEADS,
) -> Figure:
    """Draw superimposed groups of ECGs, the twelve leads in the clinical 3 × 4 layout.

    Additional leads follow in further columns. Lines are means over a group, bands hold its
    `share`. All axes have the same limits (ms, mV). `notes`, one per lead, are beside the names of
    the leads, the caption below the panels.
    """
    figure = style.new_figure(*figure_size(len(leads)), title)
    panels = lead_panels(figure, len(leads))
    for lead, (axes, name) in enumerate(zip(panels, leads, strict=True)):
        for group in groups:
            group.draw(axes, lead)
        style.name_lead(axes, name, notes[lead] if notes else "")
    start = min(float(group.time.min()) for group in groups)
    stop = max(float(group.time.max()) for group in groups)
    low = min(float(np.nanmin(group.leads)) for group in groups)
    high = max(float(np.nanmax(group.leads)) for group in groups)
    box = 0.5 if high - low <= 8 else 1.0  # mV; a box of ECG paper, to which limits are rounded
    bottom, top = box * np.floor(low / box - 0.1), box * np.ceil(high / box + 0.1)
    for axes in panels:
        axes.set(xlim=(start, stop), ylim=(bottom, top))
        axes.yaxis.set_major_locator(MultipleLocator(2 * box))
        axes.yaxis.set_minor_locator(MultipleLocator(box))
        draw_time_grid(axes)
    style.legend(figure, [(group.handle, group.label) for group in groups])
    zero = f"; 0: {time_zero}" if time_zero else ""
    style.below_leads(figure, f"time (ms{zero})", caption)
    return figure


def figure_size(leads: int) -> tuple[float, float]:
    """Width and height (inch) of a figure of `leads` leads; it grows with the columns of panels."""
    rows, columns = _grid(leads)
    return min(10.0 + 2.0 * max(columns - 4, 0), 22.0), 6.2 + 1.0 * (rows - 3)


def lead_panels(figure: Figure | SubFigure, leads: int) -> list[Axes]:
    """Panels of `leads` leads, column by column, with common axes."""
    rows, columns = _grid(leads)
    panels = list(figure.subplots(rows, columns, sharex=True, sharey=True).T.flat)
    for axes in panels[leads:]:
        axes.remove()
    panels[leads - 1].tick_params(labelbottom=True)  # the last column may be shorter
    return panels[:leads]


def _grid(leads: int) -> tuple[int, int]:
    """Rows and columns of panels: three rows, or more for many leads, as of an electrode vest."""
    # I II III | aVR aVL aVF | V1 V2 V3 | V4 V5 V6
    rows = 3 if leads <= 24 else math.ceil(math.sqrt(leads / 1.6))
    return rows, math.ceil(leads / rows)


def draw_time_grid(axes: Axes) -> None:
    """Draw ticks (ms) and a grid at small boxes of ECG paper, 40 ms wide at 25 mm/s."""
    start, stop = axes.get_xlim()
    tick = next((s for s in (40, 80, 200, 400, 1000) if (stop - start) / s <= 6), 1000)
    axes.xaxis.set_major_locator(MultipleLocator(tick))
    if stop - start <= 50 * 40:
        axes.xaxis.set_minor_locator(MultipleLocator(40))
    axes.grid(which="both", color=Colour.PAPER, linewidth=0.5)


@style.styled
def target_figure(target: Target) -> Figure:
    """Draw the superimposed beats of a target, lead by lead, with the QRS window."""
    figure = style.new_figure(*figure_size(len(target.leads)))
    draw_target(figure, target)
    return figure


def draw_target(figure: Figure | SubFigure, target: Target) -> None:
    """Draw every lead of a target, all on one scale.

    Thin lines are beats (at most 100, evenly spread over the recording), the thick line is their
    mean, the band ± 1 SD. The QRS and ± 1 SD about its ends are shaded.
    """
    start = max(target.qrs_onset - 80, float(target.time[0]))  # ms
    stop = min(target.qrs_offset + 120, float(target.time[-1]))
    mean, spread = target.mean, target.standard_deviation
    limits = _limits(target, mean[:, (target.time >= start) & (target.time <= stop)])
    count = len(target.beats)
    drawn = np.unique(np.linspace(0, count - 1, min(count, 100)).round().astype(np.int64))
    panels = lead_panels(figure, len(target.leads))
    for lead, (axes, name) in enumerate(zip(panels, target.leads, strict=True)):
        axes.axvspan(target.qrs_onset, target.qrs_offset, zorder=0.2, **LOOKS["window"])
        for end, sd in ((target.qrs_onset, target.onset_sd), (target.qrs_offset, target.offset_sd)):
            if sd > 0:
                axes.axvspan(end - sd, end + sd, zorder=0.3, **LOOKS["uncertain"])
            axes.axvline(end, color="black", linewidth=0.7, zorder=1.5)
        if target.used[lead]:
            band = mean[lead] - spread[lead], mean[lead] + spread[lead]
            axes.fill_between(target.time, *band, **LOOKS["band"])
            if count > 1:  # thinner lines for many beats
                width, opacity = (0.45, 0.8) if len(drawn) <= 15 else (0.25, 0.5)
                lines = [np.stack([target.time, beat], 1) for beat in target.beats[drawn, lead]]
                looks = {"linewidths": width, "alpha": opacity, "zorder": 1.8}
                beats = LineCollection(lines, colors=Colour.BLUE, **looks)
                axes.add_collection(beats, autolim=False)
            axes.plot(target.time, mean[lead], color="black", label="mean")
        style.name_lead(axes, name if target.used[lead] else f"{name} not used")
        axes.set(xlim=(start, stop), ylim=limits)
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        draw_time_grid(axes)
    onset, offset = style.signed(target.qrs_onset), style.signed(target.qrs_offset)
    style.below_leads(figure, f"time from the R peak (ms); QRS {onset} to {offset} ms")
    handles = _handles(target, len(drawn))
    style.legend(figure, handles, ncols=len(handles) if isinstance(figure, Figure) else 3)


def _handles(target: Target, drawn: int) -> list[tuple[Any, str]]:
    """Handles and labels of the legend of a target, of which `drawn` beats are shown."""
    count = len(target.beats)
    mean, band = Line2D([], [], color="black"), Patch(**LOOKS["band"])
    handles: list[tuple[Any, str]] = [(mean, "mean"), (band, "± 1 SD from beat to beat")]
    if target.noise is not None:
        name = "the beat" if count == 1 else f"mean of {count} beats"
        handles = [(mean, name), (band, f"± {target.noise:.3g} mV, stated noise")]
    if count > 1:
        beats = f"{drawn} of {count} beats" if drawn < count else f"{count} beats"
        handles.insert(0, (Line2D([], [], color=Colour.BLUE, linewidth=0.6), beats))
    handles.append((Patch(**LOOKS["window"]), "QRS"))
    if target.onset_sd > 0 or target.offset_sd > 0:
        handles.append((Patch(**LOOKS["uncertain"]), "QRS onset and offset ± 1 SD"))
    return handles


def _limits(target: Target, mean: Floats) -> tuple[float, float]:
    """Limits (mV) of the panels: the visible mean, and beats and band within the QRS window.

    An artefact outside the window may leave the panel; otherwise it would flatten all of them.
    """
    band = target.standard_deviation[:, target.qrs_samples]
    inside = target.mean[:, target.qrs_samples]
    values = [mean, target.qrs_beats, inside - band, inside + band]
    low = min(float(np.nanmin(part)) for part in values)
    high = max(float(np.nanmax(part)) for part in values)
    missing = max(0.2 - (high - low), 0.0) / 2  # the range is at least 0.2 mV
    margin = missing + 0.06 * (high - low + 2 * missing)
    return low - margin, high + margin


def template_figure(progress: Progress | None = None) -> tuple[Figure, dict[str, dict[str, float]]]:
    """Action potentials of the three cell types in a cable, and the template of the ECG.

    The first time on a machine each cable takes seconds. Left, whole action potentials with their
    APD90; right, the first 80 ms with the template. The table, by cell type, has
    ``resting_potential`` and ``overshoot`` (mV), ``max_upstroke`` (V/s), ``apd90`` (ms) and
    ``conduction_velocity`` (m/s).
    """
    from fascicle.forward.cable import duration, max_upstroke  # loads Numba
    from fascicle.forward.template import default_template, stored_template
    from fascicle.kernels.ten_tusscher import CELLS

    templates, report = {}, progress if progress is not None else lambda *stage: None
    for done, cell in enumerate(CELLS):
        report("template", done, len(CELLS), cell)
        templates[cell] = stored_template(cell)
    report("template", len(CELLS), len(CELLS), "")
    table = {
        cell: {
            "resting_potential": float(template.potentials[0]),
            "overshoot": float(template.potentials.max()),
            "max_upstroke": max_upstroke(template.times, template.potentials)[0],
            "apd90": duration(template.times, template.potentials),
            "conduction_velocity": template.speed,
        }
        for cell, template in templates.items()
    }
    return _drawn(templates, table, default_template()), table


@style.styled
def _drawn(
    templates: Mapping[str, CableTemplate],
    table: Mapping[str, Mapping[str, float]],
    used: CableTemplate,
) -> Figure:
    figure = style.new_figure(9.0, 3.8, "Ten Tusscher–Panfilov 2006 cells in a cable")
    overview, zoom = figure.subplots(1, 2)
    long, brief = np.linspace(-20, 450, 4000), np.linspace(-3, 80, 4000)  # ms
    colours = (Colour.BLUE, Colour.GREY, Colour.VERMILION)
    for (cell, template), colour in zip(templates.items(), colours, strict=True):
        apd = table[cell]["apd90"]
        overview.plot(long, template.full(long), color=colour, label=f"{cell}, APD90 {apd:.0f} ms")
        overview.plot(apd, template.full(np.array(apd)), "o", color=colour)
        zoom.plot(brief, template.full(brief), color=colour, label=cell)
    zoom.plot(brief, used(brief), "--", color="black", label=f"template ({used.cell})")
    zoom.axvline(used.span[1], color=Colour.GREY, linewidth=0.6, linestyle=":")
    for axes, time in ((overview, long), (zoom, brief)):
        axes.legend(loc="center left", bbox_to_anchor=(0.05, 0.4), fontsize=8)
        axes.set(xlabel="time since activation (ms)", ylabel="transmembrane potential (mV)")
        axes.set_xlim(time[0], time[-1])
    return figure
