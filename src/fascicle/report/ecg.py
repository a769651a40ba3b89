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
from numpy.typing import ArrayLike

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.report.figures import (
    BLUE,
    GREY,
    LABEL_SIZE,
    LEGEND_STYLE,
    THICK_LINE,
    VERMILION,
    finish_axes,
    new_figure,
    set_title,
    write_in,
)

SIZE = (10.0, 6.2)  # inch
NAME_PLACE = (0.03, 0.95)  # of the axes
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
class EcgEnsemble:
    """Several 12-lead ECGs on one time axis, drawn as their mean and the band they span.

    Attributes
    ----------
    label : str
        What the legend calls them.
    time : (t,) array
        Time (ms).
    leads : (n, 12, t) array
        Potential (mV), leads in the order of `fascicle.core.leads.LEADS`; NaN where an ECG has
        ended.
    colour : str
        Colour of line and band.
    """

    label: str
    time: Floats
    leads: Floats
    colour: str

    def __post_init__(self) -> None:
        needed = (len(LEADS), len(self.time))
        if self.leads.ndim != 3 or self.leads.shape[1:] != needed or not len(self.leads):
            raise InputError(
                f"ECGs '{self.label}' have shape {self.leads.shape}; "
                f"needed is (n, {needed[0]}, {needed[1]}): ECG, lead, time"
            )

    @property
    def mean(self) -> Floats:
        """Mean over the ECGs (mV), shape (12, t)."""
        return np.asarray(np.ma.masked_invalid(self.leads).mean(axis=0).filled(np.nan))

    @property
    def band(self) -> tuple[Floats, Floats]:
        """Smallest and largest value over the ECGs (mV), each of shape (12, t)."""
        return np.fmin.reduce(self.leads, axis=0), np.fmax.reduce(self.leads, axis=0)


def match_figure(
    time: ArrayLike, recorded: ArrayLike | None, predicted: ArrayLike, *, title: str | None = None
) -> Figure:
    """Draw the recorded ECG against what the networks predict.

    Parameters
    ----------
    time : (t,) array
        Time (ms) of both.
    recorded : (n_beats, 12, t) array or None
        Beats (mV); one beat may come as (12, t). None draws the prediction alone.
    predicted : (n, 12, t) array
        One ECG (mV) per network.
    title : str, optional
        Heading.

    Returns
    -------
    Figure
        Twelve panels; lines are means, bands run from minimum to maximum over beats or networks.
    """
    ensembles = [_ensemble("predicted", "network", time, predicted, VERMILION)]
    if recorded is not None:
        ensembles.insert(0, _ensemble("recorded", "beat", time, recorded, BLUE))
    return ecg_figure(ensembles, title=title)


def before_after_figure(
    before_time: ArrayLike,
    before: ArrayLike,
    after_time: ArrayLike,
    after: ArrayLike,
    *,
    labels: tuple[str, str] = ("before", "after"),
    title: str | None = None,
) -> Figure:
    """Draw the predicted ECG before and after a therapy.

    Parameters
    ----------
    before_time : (t,) array
        Time (ms) of `before`.
    before : (n, 12, t) array
        One ECG (mV) per network.
    after_time : (s,) array
        Time (ms) of `after`; need not be as long as the other.
    after : (n, 12, s) array
        One ECG (mV) per network.
    labels : tuple of two str
        What the legend calls them.
    title : str, optional
        Heading.

    Returns
    -------
    Figure
        Twelve panels; lines are means, bands run from minimum to maximum over networks.
    """
    ensembles = [
        _ensemble(labels[0], "network", before_time, before, GREY),
        _ensemble(labels[1], "network", after_time, after, VERMILION),
    ]
    return ecg_figure(ensembles, title=title)


def ecg_figure(ensembles: Sequence[EcgEnsemble], *, title: str | None = None) -> Figure:
    """Draw any number of 12-lead ensembles over one another in the clinical 3 × 4 layout.

    Parameters
    ----------
    ensembles : sequence of EcgEnsemble
        Drawn in this order, each with its own time axis.
    title : str, optional
        Heading.

    Returns
    -------
    Figure
        Axes in the order of `fascicle.core.leads.LEADS`, all with the same limits (ms, mV).
    """
    if not ensembles:
        raise InputError("no ECG to draw; give at least one ensemble")
    figure = new_figure(*SIZE)
    panels = figure.subplots(ROWS, COLUMNS, sharex=True, sharey=True)
    for index, lead in enumerate(LEADS):
        axes = panels[index % ROWS, index // ROWS]
        for ensemble in ensembles:
            _draw_lead(axes, ensemble, index)
        write_in(axes, *NAME_PLACE, lead, va="top", fontweight="bold")
    _set_scales(panels.flat, ensembles)
    figure.legend(
        [_handle(ensemble) for ensemble in ensembles],
        [ensemble.label for ensemble in ensembles],
        loc="outside upper right", ncols=len(ensembles), **LEGEND_STYLE,
    )  # fmt: skip
    set_title(figure, title)
    figure.supxlabel("time (ms)", fontsize=LABEL_SIZE)
    figure.supylabel("potential (mV)", fontsize=LABEL_SIZE)
    return figure


def _ensemble(label: str, unit: str, time: ArrayLike, leads: ArrayLike, colour: str) -> EcgEnsemble:
    values = np.asarray(leads, dtype=float)
    values = values[np.newaxis] if values.ndim == 2 else values
    count = len(values)
    spread = f"mean and range of {count} {unit}s" if count > 1 else f"1 {unit}"
    return EcgEnsemble(f"{label} ({spread})", np.asarray(time, dtype=float), values, colour)


def _handle(ensemble: EcgEnsemble) -> Any:  # Matplotlib's stubs know no tuples of artists
    """Line on band, as in the panels."""
    line = Line2D([], [], color=ensemble.colour, linewidth=THICK_LINE)
    if len(ensemble.leads) == 1:
        return (line,)
    return (Patch(color=ensemble.colour, alpha=BAND_OPACITY, linewidth=0), line)


def _draw_lead(axes: Axes, ensemble: EcgEnsemble, lead: int) -> None:
    low, high = ensemble.band
    if len(ensemble.leads) > 1:
        axes.fill_between(
            ensemble.time, low[lead], high[lead],
            color=ensemble.colour, alpha=BAND_OPACITY, linewidth=0,
        )  # fmt: skip
    axes.plot(
        ensemble.time, ensemble.mean[lead], color=ensemble.colour, linewidth=THICK_LINE,
        label=ensemble.label,
    )  # fmt: skip


def _set_scales(panels: Iterable[Axes], ensembles: Sequence[EcgEnsemble]) -> None:
    """One scale for all leads, on a grid of whole ECG-paper boxes."""
    start = min(float(ensemble.time.min()) for ensemble in ensembles)
    stop = max(float(ensemble.time.max()) for ensemble in ensembles)
    low = min(float(np.nanmin(ensemble.leads)) for ensemble in ensembles)
    high = max(float(np.nanmax(ensemble.leads)) for ensemble in ensembles)
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
        finish_axes(axes)
        axes.tick_params(which="minor", length=0)
