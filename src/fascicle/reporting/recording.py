"""Page on how a target was made: the recording, its beats, the QRS window."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PureWindowsPath
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from fascicle.core.arrays import Booleans, Floats
from fascicle.core.leads import LEADS
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.recording.pipeline import Analysis
from fascicle.reporting import style
from fascicle.reporting.ecg import draw_target
from fascicle.reporting.style import Colour

SAMPLES = 1000.0 / SAMPLING_STEP  # per second


@style.styled
def recording_figure(analysis: Analysis) -> Figure:
    """Draw the page (A4, upright) from which a cardiologist judges a target.

    The strip above shows up to ten seconds of all leads as recorded, with beats numbered and
    coloured by class. The panels below show the target: its beats, their mean and spread, and the
    QRS window.
    """
    name = PureWindowsPath(analysis.recording.source).name or analysis.recording.source
    figure = style.new_figure(8.27, 11.69)
    style.head(figure, style.short(name), fontweight="bold", fontsize="large")
    upper, lower = np.asarray(figure.subfigures(2, 1, height_ratios=(1.15, 1)))
    style.head(upper, "\n".join(_lines(analysis)), fontsize=8)
    colours = class_colours(analysis)
    _draw_strip(upper.subplots(), analysis, colours)
    _class_legend(upper, analysis, colours)
    draw_target(lower, analysis.target)
    return figure


def strip_span(analysis: Analysis) -> tuple[float, float]:
    """Start and end of the strip (s): the first ten seconds with nearly the most used beats.

    A shorter recording is shown whole, on at least 2.5 s.
    """
    duration = analysis.signal.shape[1] / SAMPLES
    length = min(max(duration, 2.5), 10.0)
    times = np.array([beat.time for beat in analysis.beats if beat.used])
    starts = np.arange(0.0, max(duration - length, 0.0) + 0.5)
    shown = np.array([((times >= start) & (times < start + length)).sum() for start in starts])
    start = starts[np.argmax(shown >= 0.8 * shown.max())]
    return float(start), float(start + length)


def class_colours(analysis: Analysis) -> dict[str, str]:
    """Colour of each class: blue for the chosen one, grey once the other colours are used up."""
    palette = (Colour.VERMILION, Colour.GREEN, Colour.PURPLE, Colour.ORANGE, Colour.SKY)
    unused = [c.label for c in analysis.classes if c.label != analysis.chosen]
    colours = dict.fromkeys([*unused, *(beat.label for beat in analysis.beats)], str(Colour.GREY))
    return colours | dict(zip(unused, palette, strict=False)) | {analysis.chosen: Colour.BLUE}


def _lines(analysis: Analysis) -> list[str]:
    """Measurements, reading options, filters, warnings and unused beats."""
    target = analysis.target
    spread = math.hypot(target.onset_sd, target.offset_sd)
    uncertainty = f" ± {spread:.{0 if spread >= 1 else 1}f}" if spread > 0 else ""
    onset, offset = style.signed(target.qrs_onset), style.signed(target.qrs_offset)
    heart_rate = target.heart_rate
    rate = "heart rate unknown" if heart_rate is None else f"{heart_rate:.0f} beats/min"
    used, count = sum(beat.used for beat in analysis.beats), len(target.beats)
    beats = f"{used} of {len(analysis.beats)} beats used, class {analysis.chosen}"
    if used != count:
        beats += f", combined to {count}"
    lines = [
        f"{rate}   ·   QRS {target.qrs_duration:.0f}{uncertainty} ms, {onset} to {offset} ms about "
        f"R   ·   {beats}"
    ]
    if analysis.read_with:
        lines.append(style.short(f"read with {'; '.join(analysis.read_with)}", 250))
    if target.filters:
        lines.append(f"filters: {'; '.join(map(str, target.filters))}")
    messages = target.warnings
    most = 5 if len(messages) <= 5 else 4
    lines += [style.short(f"! {message}", 250) for message in messages[:most]]
    if len(messages) > most:
        lines.append(f"! and {len(messages) - most} more warnings")
    reasons: dict[str, list[str]] = {}
    for beat in analysis.beats:
        if not beat.used:
            reasons.setdefault(beat.why_unused, []).append(str(beat.number))
    unused = [f"{', '.join(numbers)} ({reason})" for reason, numbers in reasons.items()]
    if unused:
        lines.append(style.short(f"not used: {'; '.join(unused)}", 250))
    return lines if messages else [*lines, "no warnings"]


def _draw_strip(axes: Axes, analysis: Analysis, colours: Mapping[str, str]) -> None:
    """Draw all leads, one below the other, on one scale (mV), with numbers above the beats."""
    start, stop = strip_span(analysis)
    signal = analysis.signal[:, round(start * SAMPLES) : round(stop * SAMPLES)]
    time = start + np.arange(signal.shape[1], dtype=np.float64) / SAMPLES
    recorded = np.asarray(np.isfinite(signal).any(axis=1))
    level = signal.copy()
    level[recorded] -= np.nanmedian(level[recorded], axis=1, keepdims=True)
    level, cut = _without_artefacts(level, time, analysis.spikes)
    baselines, height = _baselines(level)
    box = 0.5 if height <= 25 else 1.0  # mV
    axes.set(xlim=(start, stop), ylim=(-height, 0.0))
    axes.set_yticks(baselines, LEADS)
    axes.xaxis.set_minor_locator(MultipleLocator(0.2))
    axes.xaxis.grid(which="both", color=Colour.PAPER, linewidth=0.5)
    axes.hlines(-np.arange(0, height, box), start, stop, color=Colour.PAPER, lw=0.5, zorder=0.5)
    _draw_traces(axes, time, level + baselines[:, None], analysis, colours)
    for lead in np.flatnonzero(~recorded):
        times, why = np.flatnonzero(np.isfinite(analysis.signal[lead])) / SAMPLES, "not used"
        if len(times):
            why = f"recorded from {times[0]:.1f} to {times[-1]:.1f} s"
        axes.text((start + stop) / 2, baselines[lead], why, ha="center")
    _number_beats(axes, analysis, colours)
    spikes = analysis.spikes[(analysis.spikes >= start) & (analysis.spikes < stop)]
    axes.vlines(spikes, -0.7, -0.5, color="black", linewidth=0.8, label="spikes")
    duration = analysis.recording.duration
    of = f"; {start:g} to {stop:g} s of {duration:.4g} s" if duration > stop - start + 0.05 else ""
    notes = [f"time (s{of})", f"boxes of 200 ms and {box:g} mV"]
    if cut:
        notes.append("largest excursions cut off")
    if analysis.recording.derived:
        notes.append(f"computed from other leads: {', '.join(analysis.recording.derived)}")
    axes.set_xlabel("   ·   ".join(notes))


def _without_artefacts(level: Floats, time: Floats, spikes: Floats) -> tuple[Floats, bool]:
    """Leads (12, n) clipped 1 mV beyond their usual range, and whether anything was clipped.

    The usual range holds a lead for 99.6 % of the time, pacing spikes excluded.
    """
    calm = np.nan_to_num(level)
    for sample in np.searchsorted(time, spikes[(spikes >= time[0]) & (spikes <= time[-1])]):
        calm[:, max(sample - 8, 0) : sample + 9] = 0.0
    low = np.quantile(calm, 0.002, axis=1, keepdims=True) - 1.0
    high = np.quantile(calm, 0.998, axis=1, keepdims=True) + 1.0
    clipped = np.clip(level, low, high)
    return clipped, bool((np.abs(clipped - level) > 1e-9).any())


def _baselines(level: Floats) -> tuple[Floats, float]:
    """Baselines at which leads (12, n) do not cross, and the height of the strip (mV).

    The height is at least 16 mV, which makes the boxes square, as on ECG paper.
    """
    flat = np.nan_to_num(level)
    between = np.quantile(flat[1:] - flat[:-1], 0.998, axis=1)
    top, bottom = np.quantile(flat[0], 0.998), -np.quantile(flat[-1], 0.002)
    needed = np.maximum([top, *between, bottom], 0.5) + 0.1
    needed[0] += 0.8  # numbers of beats
    apart = np.quantile(flat[1:], 0.998, axis=1) - np.quantile(flat[:-1], 0.002, axis=1)
    more = np.maximum(apart + 0.1 - needed[1:-1], 0.0)  # then leads never overlap
    needed[1:-1] += more * min(1.0, max(16.0 - needed.sum(), 0.0) / max(more.sum(), 0.1))
    needed += max(16.0 - needed.sum(), 0.0) / len(needed)
    return -np.cumsum(needed)[:-1], float(needed.sum())


def _draw_traces(
    axes: Axes, time: Floats, traces: Floats, analysis: Analysis, colours: Mapping[str, str]
) -> None:
    """Draw leads, a line per colour; a beat's colour spans 100 ms before R to 400 ms after."""
    shades = np.full(len(time), str(Colour.GREY), dtype=object)
    ends = [beat.time - 0.1 for beat in analysis.beats[1:]] + [np.inf]
    for beat, end in zip(analysis.beats, ends, strict=True):
        span = np.searchsorted(time, (beat.time - 0.1, min(beat.time + 0.4, end)))
        shades[slice(*span)] = colours[beat.label]
    for colour in dict.fromkeys(shades):
        coloured: Booleans = shades == colour
        for trace in traces[np.isfinite(traces).any(axis=1)]:
            axes.plot(time, np.where(coloured, trace, np.nan), color=colour, linewidth=0.65)


def _number_beats(axes: Axes, analysis: Analysis, colours: Mapping[str, str]) -> None:
    """Number of each beat above its R peak, hollow if the target does not use the beat."""
    start, stop = axes.get_xlim()
    several = len(analysis.classes) > 1
    for beat in analysis.beats:
        if start <= beat.time < stop:
            colour = colours[beat.label]
            axes.text(
                beat.time, -0.3, f"{beat.number}{beat.label if several else ''}", fontsize=6,
                ha="center", va="center", color="white" if beat.used else colour,
                bbox={"boxstyle": "round,pad=0.2", "linewidth": 0.7, "edgecolor": colour,
                      "facecolor": colour if beat.used else "white"},
            )  # fmt: skip


def _class_legend(figure: SubFigure, analysis: Analysis, colours: Mapping[str, str]) -> None:
    ranked = sorted(analysis.classes, key=lambda beat_class: beat_class.label != analysis.chosen)
    handles: list[tuple[Any, str]] = []
    named = [c for c in ranked if colours[c.label] != Colour.GREY]
    for beat_class in named:
        text = f"{beat_class.label} {beat_class.count} beat{'s' if beat_class.count != 1 else ''}"
        text = style.short(f"{text}: {beat_class.description}" if beat_class.description else text)
        handles.append((Line2D([], [], color=colours[beat_class.label], linewidth=2.2), text))
    if more := ranked[len(named) :]:
        text = f"{len(more)} more classes, {sum(beat_class.count for beat_class in more)} beats"
        handles.append((Line2D([], [], color=Colour.GREY, linewidth=2.2), text))
    box: dict[str, Any] = {"linestyle": "none", "marker": "s", "color": Colour.BLUE}
    handles.append((Line2D([], [], **box), "filled number: beat used"))
    if not all(beat.used for beat in analysis.beats):
        hollow = Line2D([], [], markerfacecolor="white", **box)
        handles.append((hollow, "hollow number: beat not used"))
    if len(analysis.spikes):
        handles.append((Line2D([], [], color="black", ls="none", marker="|"), "pacing spike"))
    style.legend(figure, handles, loc="outside lower left", ncols=3, fontsize=8)
