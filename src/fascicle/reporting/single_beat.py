"""A recording of one beat, large, on ECG paper: all leads in the clinical columns."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from fascicle.core.arrays import Floats
from fascicle.core.leads import LEADS
from fascicle.recording.analysis import Analysis
from fascicle.recording.filters import SAMPLING_STEP
from fascicle.reporting import style
from fascicle.reporting.beat_panels import ROWS
from fascicle.reporting.ecg_paper import draw_paper, without_baseline

PACE = 50.0  # mm/s; a beat then fills a column
GAINS = (20.0, 10.0, 5.0, 2.5)  # mm/mV, the largest that fits
BEFORE, AFTER = 0.25, 0.5  # s about R that are shown
LONGEST = 2.0  # s; a longer recording is a strip, even if one beat alone was found
SMALL_SQUARE = 1.0  # mm, as on real paper
MARGIN = 2.0  # mm between one lead and the next
INDENT, NAME = 1.0, 9.0  # mm from the left edge of a column to its names, and to its traces


def is_single_beat(analysis: Analysis) -> bool:
    """Whether a recording is one beat, such as a machine's median beat."""
    return len(analysis.beats) == 1 and analysis.recording.duration <= LONGEST


def draw_single_beat(axes: Axes, analysis: Analysis, width: float, height: float) -> float:
    """Draw the beat in every lead, as it was recorded, less each lead's median.

    Parameters
    ----------
    axes : Axes
        `width` times `height` mm.
    analysis : Analysis
        A recording of one beat.
    width, height : float
        Of the axes (mm).

    Returns
    -------
    float
        The gain (mm/mV), one of `GAINS`.
    """
    r_peak = round(analysis.beats[0].time * 1000.0 / SAMPLING_STEP)
    first = max(r_peak - round(BEFORE * 1000.0 / SAMPLING_STEP), 0)
    signal = analysis.signal[:, first : r_peak + round(AFTER * 1000.0 / SAMPLING_STEP)]
    level = without_baseline(signal)
    level[~np.isfinite(signal).all(axis=1)] = np.nan
    gain, baselines = _arrange(np.nan_to_num(level), height)
    axes.set(xlim=(0.0, width), ylim=(-height, 0.0), xticks=[], yticks=[])
    draw_paper(axes, (0.0, width), height, square=SMALL_SQUARE)
    column = width / (len(LEADS) // ROWS)
    along = np.arange(signal.shape[1]) * (SAMPLING_STEP / 1000.0 * PACE) + NAME
    for lead, name in enumerate(LEADS):
        left, baseline = lead // ROWS * column, baselines[lead % ROWS]
        recorded = bool(np.isfinite(level[lead]).all())
        axes.text(
            left + INDENT, baseline, name if recorded else f"{name} not used", va="center",
            fontsize=style.LABEL_SIZE, fontweight="bold",
            color=style.BLACK if recorded else style.GREY,
        )  # fmt: skip
        axes.plot(left + along, baseline + gain * level[lead], color=style.BLUE, linewidth=1.0)
    return gain


def _arrange(level: Floats, height: float) -> tuple[float, Floats]:
    """Gain (mm/mV) and where the baselines of the rows lie (mm, negative below the top).

    No lead reaches into that below it in the same column.
    """
    high = np.maximum(level.max(axis=1), 0.0).reshape(-1, ROWS)
    low = np.maximum(-level.min(axis=1), 0.0).reshape(-1, ROWS)
    between = (low[:, :-1] + high[:, 1:]).max(axis=0)
    distances = np.array([high[:, 0].max(), *between, low[:, -1].max()])  # mV
    gain, spare = GAINS[-1], 0.0
    for gain in GAINS:
        spare = height - float((gain * distances + MARGIN).sum())
        if spare >= 0:
            break
    rooms = gain * distances + MARGIN + spare / len(distances)
    return gain, -np.cumsum(rooms)[:ROWS]
