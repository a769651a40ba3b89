"""One page that shows what a target was made of: the recording, its beats, the QRS window."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import PureWindowsPath
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fascicle.core.leads import LEADS
from fascicle.recording.analysis import Analysis, BeatClass
from fascicle.reporting import style
from fascicle.reporting.beat_panels import ROWS, draw_beats, panel_handles
from fascicle.reporting.ecg_paper import (
    PACE,
    PAPER_GAIN,
    PAPER_PACE,
    SHOWN,
    draw_strip,
    strip_start,
)
from fascicle.reporting.figures import new_figure
from fascicle.reporting.fitted_text import shortened, wrapped
from fascicle.reporting.single_beat import PACE as SINGLE_PACE
from fascicle.reporting.single_beat import draw_single_beat, is_single_beat

MM = 1 / 25.4  # inch
PAGE_WIDTH, PAGE_HEIGHT = 210.0, 297.0  # mm, A4
LEFT, RIGHT = 14.0, 6.0  # mm beside the strip, which is SHOWN * PACE = 190 mm wide
TEXT_LEFT, TEXT_WIDTH = 6.0, 198.0  # mm
NAME_BASE, MEASURES_BASE, WARNINGS_BASE = 10.0, 15.0, 19.5  # mm below the upper edge
SMALL, LINE = 7.0, 3.4  # points, and mm from one such line to the next
GAP = 1.0  # mm between the strip and the texts about it
MOST_WARNING_LINES, LONGEST_WARNING = 5, 2  # in all, and for one
LEGEND_COLUMNS, LEGEND_GAP, LEGEND_MARK = 3, 2.0, 12.0  # and mm above it, and beside a text
PANEL_HEIGHT, PANEL_GAP = 37.0, 2.5  # mm
PANEL_BLOCK = ROWS * PANEL_HEIGHT + (ROWS - 1) * PANEL_GAP  # mm
BELOW_PANELS, ABOVE_PANELS = 11.0, 10.0  # mm for axis labels, and for the legend and the ends

# Okabe & Ito's colours after the blue of the chosen class; what is left shares the grey.
OTHER_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def recording_figure(analysis: Analysis) -> Figure:
    """Draw the page from which a cardiologist judges a target.

    The strip above shows ten seconds of all leads as they were recorded, on the squares of ECG
    paper, beats numbered and coloured by class; of a recording of one beat it shows that, large.
    The panels below show the target: its beats, their
    mean and spread, and the QRS window.

    Parameters
    ----------
    analysis : Analysis
        A recording, its beats and the target.

    Returns
    -------
    Figure
        A4, upright. The first axes hold the strip, twelve more the leads in the order of
        `fascicle.core.leads.LEADS`.
    """
    figure = new_figure(PAGE_WIDTH * MM, PAGE_HEIGHT * MM, constrained=False)
    colours = class_colours(analysis)
    top, single = _head(figure, analysis), is_single_beat(analysis)
    if not single:  # its class says nothing
        top = _class_legend(figure, analysis, colours, top)
    unused = _unused_text(analysis)
    panels_top = PAGE_HEIGHT - BELOW_PANELS - PANEL_BLOCK
    strip_bottom = panels_top - ABOVE_PANELS - (2 if unused else 1) * LINE
    top += LINE  # for the scale
    height = strip_bottom - top - GAP
    strip = _axes(figure, LEFT, top + GAP, SHOWN * PACE, height)
    if single:
        gain = draw_single_beat(strip, analysis, SHOWN * PACE, height)
        scale = _single_scale_text(analysis, gain)
    else:
        gain, cut = draw_strip(strip, analysis, colours, height)
        scale = _scale_text(analysis, gain, cut=cut)
    _write(figure, TEXT_LEFT, top, scale, weight="bold")
    if unused:
        _write(figure, TEXT_LEFT, strip_bottom + 2 * LINE, unused)
    handles = panel_handles(analysis.target)
    _legend(figure, handles, panels_top - 4.0 - LINE, len(handles))
    draw_beats(_panels(figure, panels_top), analysis.target)
    return figure


def class_colours(analysis: Analysis) -> dict[str, str]:
    """Colour of each class: blue for the chosen one, grey where the others run out."""
    others = [known.label for known in analysis.classes if known.label != analysis.chosen]
    colours = dict.fromkeys([*others, *(beat.label for beat in analysis.beats)], style.GREY)
    return colours | dict(zip(others, OTHER_COLOURS, strict=False)) | {analysis.chosen: style.BLUE}


def _head(figure: Figure, analysis: Analysis) -> float:
    """Name, measures and warnings; returns how far down (mm) they reach."""
    name = PureWindowsPath(analysis.recording.source).name or analysis.recording.source
    size = style.TITLE_SIZE + 1
    name = shortened(name, size, TEXT_WIDTH, "bold")
    _write(figure, TEXT_LEFT, NAME_BASE, name, size=size, weight="bold")
    _write(figure, TEXT_LEFT, MEASURES_BASE, _measures_text(analysis), size=style.LABEL_SIZE)
    lines = [*_read_lines(analysis), *_filter_lines(analysis), *_warning_lines(analysis)]
    for k, line in enumerate(lines):
        _write(figure, TEXT_LEFT, WARNINGS_BASE + k * LINE, line)
    return WARNINGS_BASE + (len(lines) - 1) * LINE


def _measures_text(analysis: Analysis) -> str:
    target = analysis.target
    spread = math.hypot(target.onset_sd, target.offset_sd)
    uncertainty = f" ± {spread:.{0 if spread >= 1 else 1}f}" if spread > 0 else ""
    onset, offset = style.whole(target.qrs_onset), style.whole(target.qrs_offset)
    heart_rate = target.heart_rate
    rate = f"{heart_rate:.0f} beats/min" if heart_rate is not None else "heart rate unknown"
    qrs = (
        f"QRS {target.qrs_duration:.0f}{uncertainty} ms, {onset} to {offset} ms about R "
        f"(global {target.global_qrs_duration:.0f} ms)"
    )
    used, count = sum(beat.used for beat in analysis.beats), len(target.beats)
    beats = f"{used} of {len(analysis.beats)} beats used, class {analysis.chosen}"
    if used != count:
        beats += f", put together to {count}"
    if is_single_beat(analysis):
        beats = "a single beat"
    return "   ·   ".join([rate, qrs, beats])


def _read_lines(analysis: Analysis) -> list[str]:
    """What the user has said of the file, in one line; none where nothing was said."""
    said = "; ".join(analysis.read_with)
    return [shortened(f"read with {said}", SMALL, TEXT_WIDTH)] if said else []


def _filter_lines(analysis: Analysis) -> list[str]:
    """What the beats have passed, in one line; none where nothing is known."""
    filters = "; ".join(map(str, analysis.target.filters))
    return [shortened(f"filters: {filters}", SMALL, TEXT_WIDTH)] if filters else []


def _warning_lines(analysis: Analysis) -> list[str]:
    """What the checks found, in as many lines as fit."""
    messages = analysis.target.provenance.get("warnings", "").splitlines()
    if not messages:
        return ["no warnings"]
    lines: list[str] = []
    for count, message in enumerate(messages):
        more = wrapped(f"! {message}", SMALL, TEXT_WIDTH - 2.0)
        if len(more) > LONGEST_WARNING:
            more = [*more[: LONGEST_WARNING - 1], more[LONGEST_WARNING - 1] + " …"]
        last = count == len(messages) - 1
        if len(lines) + len(more) > MOST_WARNING_LINES - (0 if last else 1):
            left = len(messages) - count
            return [*lines, f"! and {left} more warning{'s' if left > 1 else ''}"]
        lines += more
    return lines


def _class_legend(
    figure: Figure, analysis: Analysis, colours: Mapping[str, str], top: float
) -> float:
    """What colours and marks of the strip mean; returns how far down (mm) it reaches."""
    named = analysis.classes[: len(OTHER_COLOURS) + 1]
    if analysis.chosen not in {known.label for known in named}:
        named += tuple(known for known in analysis.classes if known.label == analysis.chosen)
    handles = [(_class_line(colours[known.label]), _class_text(known)) for known in named]
    rest = [known for known in analysis.classes if known not in named]
    if rest:
        count = sum(known.count for known in rest)
        handles.append((_class_line(style.GREY), f"{len(rest)} more classes, {count} beats"))
    handles.append((_number_mark(style.BLUE), "filled number: beat used"))
    if not all(beat.used for beat in analysis.beats):
        handles.append((_number_mark("white"), "hollow number: beat not used"))
    if len(analysis.spikes):
        mark = Line2D([], [], color=style.BLACK, linestyle="none", marker="|", markersize=5)
        handles.append((mark, "pacing spike"))
    room = TEXT_WIDTH / LEGEND_COLUMNS - LEGEND_MARK
    handles = [(mark, shortened(text, SMALL, room)) for mark, text in handles]
    _legend(figure, handles, top + LEGEND_GAP, LEGEND_COLUMNS)
    return top + LEGEND_GAP + math.ceil(len(handles) / LEGEND_COLUMNS) * LINE


def _class_text(known: BeatClass) -> str:
    count = f"{known.label} {known.count} beat{'s' if known.count != 1 else ''}"
    return f"{count}: {known.description}" if known.description else count


def _class_line(colour: str) -> Line2D:
    return Line2D([], [], color=colour, linewidth=2.2)


def _number_mark(fill: str) -> Line2D:
    return Line2D(
        [], [], linestyle="none", marker="s", markersize=5.5, markerfacecolor=fill,
        markeredgecolor=style.BLUE, markeredgewidth=0.7,
    )  # fmt: skip


def _scale_text(analysis: Analysis, gain: float, *, cut: bool) -> str:
    """Stretch of time, scales, and what the recorder did, above the strip."""
    recording, start = analysis.recording, strip_start(analysis)
    stretch = f"{recording.duration:.3g} s"
    if recording.duration > SHOWN + 0.05:
        stretch = f"{start:g} to {start + SHOWN:g} s of {recording.duration:.4g} s"
        if start == 0:
            stretch = f"first {SHOWN:g} s of {recording.duration:.4g} s"
    share = PACE / PAPER_PACE
    named = {1.0: "", 0.5: ": half gain", 0.25: ": quarter gain"}[gain]
    parts = [
        stretch,
        f"{PACE:g} mm/s, {gain * share * PAPER_GAIN:.3g} mm/mV on A4 "
        f"({share:.0%} of {PAPER_PACE:g} mm/s, {gain * PAPER_GAIN:g} mm/mV{named})",
        f"small square 40 ms, {0.1 / gain:g} mV",
    ]
    if cut:
        parts.append("largest excursions cut off")
    if recording.derived:
        parts.append(f"computed from other leads: {', '.join(recording.derived)}")
    return shortened("   ·   ".join(parts), SMALL, TEXT_WIDTH, "bold")


def _single_scale_text(analysis: Analysis, gain: float) -> str:
    """Scales of a beat that is drawn large, and which leads were computed."""
    parts = [
        f"{SINGLE_PACE:g} mm/s, {gain:g} mm/mV on A4",
        f"small square {1000 / SINGLE_PACE:g} ms, {1 / gain:g} mV",
    ]
    if analysis.recording.derived:
        parts.append(f"computed from other leads: {', '.join(analysis.recording.derived)}")
    return shortened("   ·   ".join(parts), SMALL, TEXT_WIDTH, "bold")


def _unused_text(analysis: Analysis) -> str:
    """Numbers of the beats that the target lacks, by reason; empty where it lacks none."""
    reasons: dict[str, list[str]] = {}
    for beat in analysis.beats:
        if not beat.used:
            reasons.setdefault(beat.why_unused, []).append(str(beat.number))
    parts = [f"{', '.join(numbers)} ({reason})" for reason, numbers in reasons.items()]
    return shortened(f"not used: {'; '.join(parts)}", SMALL, TEXT_WIDTH) if parts else ""


def _panels(figure: Figure, top: float) -> list[Axes]:
    """Twelve axes in the clinical columns, and what their scales are."""
    columns = len(LEADS) // ROWS
    width = (PAGE_WIDTH - LEFT - RIGHT - (columns - 1) * PANEL_GAP) / columns
    _write(figure, LEFT - 1.5, top - 1.0, "mV", size=8, ha="right")
    below = PAGE_HEIGHT - 3.5
    _write(figure, PAGE_WIDTH / 2, below, "time from the R peak (ms)", size=8, ha="center")
    lefts = [LEFT + column * (width + PANEL_GAP) for column in range(columns)]
    tops = [top + row * (PANEL_HEIGHT + PANEL_GAP) for row in range(ROWS)]
    return [_axes(figure, left, upper, width, PANEL_HEIGHT) for left in lefts for upper in tops]


def _axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes at a place in mm from the upper left corner of the page."""
    bottom = PAGE_HEIGHT - top - height
    return figure.add_axes(
        (left / PAGE_WIDTH, bottom / PAGE_HEIGHT, width / PAGE_WIDTH, height / PAGE_HEIGHT)
    )


def _write(figure: Figure, left: float, base: float, text: str, **looks: Any) -> None:
    """Text at a place in mm from the upper left corner of the page; a $ is a $."""
    chosen: dict[str, Any] = {"size": SMALL, "color": style.BLACK, "parse_math": False} | looks
    figure.text(left / PAGE_WIDTH, 1 - base / PAGE_HEIGHT, text, **chosen)


def _legend(figure: Figure, handles: Sequence[tuple[Any, str]], top: float, columns: int) -> None:
    """Legend from the left, its first line `top` mm below the upper edge of the page."""
    legend = figure.legend(
        [handle for handle, _ in handles],
        [text for _, text in handles],
        loc="upper left", bbox_to_anchor=(TEXT_LEFT / PAGE_WIDTH, 1 - top / PAGE_HEIGHT),
        ncols=columns, frameon=False, fontsize=SMALL, borderpad=0, borderaxespad=0,
        handlelength=1.6, handletextpad=0.6, columnspacing=2.0, labelspacing=0.38,
    )  # fmt: skip
    for text in legend.get_texts():
        text.set_parse_math(False)
