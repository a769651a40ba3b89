"""Ten seconds of a recording on ECG paper, every beat in the colour of its class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS
from fascicle.recording.analysis import Analysis, Beat
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.reporting import style

SHOWN = 10.0  # s
PACE = 19.0  # mm/s; ten seconds then fill a page of A4
PAPER_PACE, PAPER_GAIN = 25.0, 10.0  # mm/s and mm/mV, usual on electrocardiographs
SMALL_SQUARE = PACE / PAPER_PACE  # mm; 40 ms wide
GAINS = (1.0, 0.5, 0.25)  # of the standard, as on electrocardiographs
THIN_PINK, THICK_PINK = "#FBE3E0", "#F0B8B1"

BEFORE, AFTER = 0.1, 0.4  # s about R that are drawn in the colour of the beat
NUMBER_ROW, LETTER_ROW, SPIKE_ROW = 5.0, 2.6, 2.4  # mm above the leads
MARK_SIZE = 6.2  # points; numbers and letters of beats
CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
CLOSEST = 4.6  # mm between two baselines, for the names of leads
CLEARANCE = 0.8  # mm between two leads
BEYOND = 9.0  # mm by which an artefact may leave the room of its lead
RARE = 0.002  # share of the time in which leads may cross: artefacts are no reason to shrink all
SPIKE_REACH = 8  # samples about a pacing spike that do not count for the room of a lead
MOST_BEATS = 0.8  # the strip is the first that holds this share of the most that one can hold


def strip_start(analysis: Analysis) -> float:
    """Where the strip begins (s): the first stretch that shows about as many used beats as any."""
    times = np.array([beat.time for beat in analysis.beats if beat.used])
    duration = analysis.signal.shape[1] * SAMPLING_STEP / 1000.0
    starts = np.arange(0.0, max(duration - SHOWN, 0.0) + 0.5)
    shown = [int(((times >= start) & (times < start + SHOWN)).sum()) for start in starts]
    enough = MOST_BEATS * max(shown)
    return float(next(start for start, count in zip(starts, shown, strict=True) if count >= enough))


def draw_strip(
    axes: Axes, analysis: Analysis, colours: Mapping[str, str], height: float
) -> tuple[float, bool]:
    """Draw all leads below one another, to one scale, with numbers above the beats.

    Baselines are as far apart as the leads need so as not to cross; the gain is halved, as
    electrocardiographs do, where they do not fit.

    Parameters
    ----------
    axes : Axes
        `SHOWN` times `PACE` mm wide.
    analysis : Analysis
        Recording, beats and classes.
    colours : mapping of class label to colour
        One for each class.
    height : float
        Of the axes (mm).

    Returns
    -------
    gain : float
        Share of the standard gain, one of `GAINS`.
    cut : bool
        Whether excursions were cut off.
    """
    start = strip_start(analysis)
    first, stop = (round(second * 1000.0 / SAMPLING_STEP) for second in (start, start + SHOWN))
    signal = analysis.signal[:, first:stop]
    time = start + np.arange(signal.shape[1], dtype=np.float64) * (SAMPLING_STEP / 1000.0)
    level = without_baseline(signal)
    letters = len(analysis.classes) > 1
    head = NUMBER_ROW + LETTER_ROW * letters + SPIKE_ROW * (len(analysis.spikes) > 0)
    flat = _without_spikes(level, time, analysis.spikes)
    gain, baselines = _arrange(flat, height, head)
    scale = gain * PAPER_GAIN * PACE / PAPER_PACE
    traces, cut = _within_reach(scale * level, scale * flat)
    axes.set(xlim=(start, start + SHOWN), ylim=(-height, 0.0))
    _draw_grid(axes, start, height)
    _draw_traces(axes, time, traces + baselines[:, None], analysis, colours)
    _name_leads(axes, analysis, baselines, signal)
    shown = [beat for beat in analysis.beats if start <= beat.time < start + SHOWN]
    _number(axes, shown, colours, letters=letters)
    spikes = analysis.spikes[(analysis.spikes >= start) & (analysis.spikes < start + SHOWN)]
    axes.vlines(
        spikes, 0.6 - head, SPIKE_ROW - head, color=style.BLACK, linewidth=0.8, label="spikes"
    )
    return gain, cut


def without_baseline(signal: Floats) -> Floats:
    """Each lead (12, n) less its median, which is its baseline."""
    level = np.full(signal.shape, np.nan)
    for lead, samples in enumerate(signal):
        if np.isfinite(samples).any():
            level[lead] = samples - np.nanmedian(samples)
    return level


def draw_paper(
    axes: Axes, extent: tuple[float, float], height: float, *, square: float, pace: float = 1.0
) -> None:
    """Draw the squares of ECG paper, small ones and those of five, from the upper left corner.

    Parameters
    ----------
    axes : Axes
        Its vertical axis is in mm, 0 at the top.
    extent : (start, width)
        Along the horizontal axis, in its unit.
    height : float
        Of the paper (mm).
    square : float
        Side of a small square (mm).
    pace : float
        How many mm a unit of the horizontal axis is wide.
    """
    start, width = extent
    for side, colour, line in ((square, THIN_PINK, 0.35), (5 * square, THICK_PINK, 0.5)):
        across = start + np.arange(0.0, width + 1e-9, side / pace)
        down = -np.arange(0.0, height + 1e-9, side)
        axes.vlines(across, -height, 0.0, color=colour, linewidth=line, zorder=0.5)
        axes.hlines(down, start, start + width, color=colour, linewidth=line, zorder=0.5)
    axes.spines[:].set(color=THICK_PINK, linewidth=0.6)


def beat_colour(beat: Beat, colours: Mapping[str, str], chosen: str) -> str:
    """Colour of a beat's trace: that of its class, paler where the target lacks it nevertheless.

    Parameters
    ----------
    beat : Beat
        One beat of the recording.
    colours : mapping of class label to colour
        One for each class.
    chosen : str
        Label of the class that the target is made of.
    """
    colour = colours[beat.label]
    if beat.used or beat.label != chosen:
        return colour
    red, green, blue = (0.5 + 0.5 * part for part in to_rgb(colour))
    return to_hex((red, green, blue)).upper()


def _without_spikes(level: Floats, time: Floats, spikes: Floats) -> Floats:
    """Leads (12, n), flat at pacing spikes and where nothing was recorded."""
    flat = np.nan_to_num(level)
    for sample in np.searchsorted(time, spikes[(spikes >= time[0]) & (spikes <= time[-1])]):
        flat[:, max(sample - SPIKE_REACH, 0) : sample + SPIKE_REACH + 1] = 0.0
    return flat


def _arrange(level: Floats, height: float, head: float) -> tuple[float, Floats]:
    """Gain (share of the standard) and where the baselines lie (mm, negative below the top).

    Leads keep apart at every instant; with room to spare, also from one instant to another.
    """
    high, low = np.quantile(level, 1 - RARE, axis=1), np.quantile(level, RARE, axis=1)
    between = np.quantile(level[1:] - level[:-1], 1 - RARE, axis=1)
    at_once = np.array([high[0], *between, -low[-1]])  # mV
    ever = np.array([high[0], *np.maximum(high[1:] - low[:-1], between), -low[-1]])  # mV
    least = np.array([CLOSEST / 2, *np.full(len(between), CLOSEST), CLOSEST / 2])
    for gain in GAINS:
        scale = gain * PAPER_GAIN * PACE / PAPER_PACE
        needed = np.maximum(scale * at_once + CLEARANCE, least)
        spare = height - head - float(needed.sum())
        if spare >= 0:
            break
    if spare < 0:  # leads cross, their names do not
        needed = least + (needed - least) * (1 + spare / float((needed - least).sum()))
    else:
        wanted = np.maximum(scale * ever + CLEARANCE, needed) - needed
        needed = needed + wanted * min(1.0, spare / max(float(wanted.sum()), CLEARANCE))
        needed += max(height - head - float(needed.sum()), 0.0) / len(needed)
    return gain, -head - np.cumsum(needed)[: len(level)]


def _within_reach(traces: Floats, flat: Floats) -> tuple[Floats, bool]:
    """Traces (12, n) in mm without what artefacts and spikes add, and whether there was any."""
    low = np.quantile(flat, RARE, axis=1, keepdims=True) - BEYOND
    high = np.quantile(flat, 1 - RARE, axis=1, keepdims=True) + BEYOND
    return np.clip(traces, low, high), bool(((traces < low) | (traces > high)).any())


def _draw_grid(axes: Axes, start: float, height: float) -> None:
    """Paper at the strip's scale, and seconds below it."""
    draw_paper(axes, (start, SHOWN), height, square=SMALL_SQUARE, pace=PACE)
    axes.set_yticks([])
    seconds = start + np.arange(SHOWN + 1)
    axes.set_xticks(seconds, [f"{second:g}" for second in seconds[:-1]] + [f"{seconds[-1]:g} s"])
    axes.get_xticklabels()[-1].set_horizontalalignment("right")
    axes.tick_params(labelsize=style.TICK_SIZE - 1, width=0.5, length=2, pad=1.5)


def _draw_traces(
    axes: Axes, time: Floats, traces: Floats, analysis: Analysis, colours: Mapping[str, str]
) -> None:
    """Each lead as one line per colour, with gaps where another one goes on."""
    shades = np.full(len(time), style.GREY, dtype=object)
    following = [beat.time - BEFORE for beat in analysis.beats[1:]] + [np.inf]
    for beat, end in zip(analysis.beats, following, strict=True):
        stretch = slice(*np.searchsorted(time, (beat.time - BEFORE, min(beat.time + AFTER, end))))
        shades[stretch] = beat_colour(beat, colours, analysis.chosen)
    for colour in dict.fromkeys(shades):
        here = shades == colour
        for trace in traces[np.isfinite(traces).any(axis=1)]:
            axes.plot(time, np.where(here, trace, np.nan), color=colour, linewidth=0.65)


def _name_leads(axes: Axes, analysis: Analysis, baselines: Floats, signal: Floats) -> None:
    """Names at the left, and a word on rows that stay empty."""
    middle = float(np.mean(axes.get_xlim()))
    recorded = np.asarray(np.isfinite(analysis.signal).any(axis=1))
    for lead, baseline in enumerate(baselines):
        axes.annotate(
            LEADS[lead], (0.0, baseline), xycoords=axes.get_yaxis_transform(), xytext=(-3, 0),
            textcoords="offset points", ha="right", va="center", fontsize=style.TICK_SIZE,
            fontweight="bold", color=style.BLACK if recorded[lead] else style.GREY,
        )  # fmt: skip
        if np.isfinite(signal[lead]).any():
            continue
        word = "not used"
        if recorded[lead]:
            samples = np.flatnonzero(np.isfinite(analysis.signal[lead]))[[0, -1]]
            begin, end = samples * SAMPLING_STEP / 1000.0
            word = f"recorded from {begin:.1f} to {end:.1f} s"
        axes.text(middle, baseline, word, fontsize=style.TICK_SIZE, color=style.GREY, **CENTRED)


def _number(
    axes: Axes, beats: Sequence[Beat], colours: Mapping[str, str], *, letters: bool
) -> None:
    """Number of each beat above its R peak, hollow where the target lacks the beat."""
    for beat in beats:
        colour = colours[beat.label]
        axes.text(
            beat.time, -NUMBER_ROW / 2, str(beat.number), fontsize=MARK_SIZE, fontweight="bold",
            color="white" if beat.used else colour,
            bbox={
                "boxstyle": "round,pad=0.2", "linewidth": 0.7, "edgecolor": colour,
                "facecolor": colour if beat.used else "white",
            },
            **CENTRED,
        )  # fmt: skip
        if letters:
            place = (beat.time, -NUMBER_ROW - 1.0)
            axes.text(*place, beat.label, fontsize=MARK_SIZE, color=colour, **CENTRED)
