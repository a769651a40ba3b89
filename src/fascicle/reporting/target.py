"""A target on a page of its own: beats, mean and spread, QRS window."""

from __future__ import annotations

from matplotlib.figure import Figure

from fascicle.core.leads import LEADS
from fascicle.recording.target import Target
from fascicle.reporting import style
from fascicle.reporting.beat_panels import ROWS, draw_beats, panel_handles
from fascicle.reporting.figures import new_figure

SIZE = (10.0, 6.2)  # inch


def target_figure(target: Target) -> Figure:
    """Draw the beats of a target over one another, lead by lead, with the QRS window.

    Returns
    -------
    Figure
        Axes in the order of `fascicle.core.leads.LEADS`.
    """
    figure = new_figure(*SIZE)
    panels = figure.subplots(ROWS, len(LEADS) // ROWS)
    draw_beats(list(panels.T.flat), target)
    handles, texts = zip(*panel_handles(target), strict=True)
    figure.legend(
        handles, texts, loc="outside upper right", ncols=len(handles), **style.LEGEND_STYLE
    )
    figure.supxlabel("time from the R peak (ms)", fontsize=style.LABEL_SIZE)
    figure.supylabel("potential (mV)", fontsize=style.LABEL_SIZE)
    return figure
