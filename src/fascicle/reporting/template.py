"""The template action potential and the cells it comes from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.progress import Progress
from fascicle.forward.cable.cable import duration, max_upstroke
from fascicle.forward.cable.template import CableTemplate, default_template, stored_template
from fascicle.kernels.ten_tusscher import CELLS
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure

COLOURS = {"endocardial": style.BLUE, "midmyocardial": style.GREY, "epicardial": style.VERMILION}
SIZE = (9.0, 3.8)  # inch
LEGEND_PLACE = (0.08, 0.4)  # of the axes
POINTS = 4000  # of each curve
LINE = 1.2  # points
SHOWN_BEFORE = 20.0  # ms before the upstroke
SHOWN_AFTER = 450.0  # ms after it
ZOOM = (-3.0, 80.0)  # ms around the upstroke


def template_figure(progress: Progress | None = None) -> tuple[Figure, dict[str, dict[str, float]]]:
    """Action potentials of the three cell types in a cable, and the template of the ECG.

    Parameters
    ----------
    progress : Progress, optional
        Called when a cable is done; the first time on a machine each takes seconds.

    Returns
    -------
    figure : Figure
        Left, whole action potentials with their APD90; right, the first 80 ms with the template.
    table : dict of cell type to dict
        ``resting_potential`` and ``overshoot`` (mV), ``max_upstroke`` (V/s), ``apd90`` (ms) and
        ``conduction_velocity`` (m/s) of each.
    """
    templates = {}
    for done, cell in enumerate(CELLS):
        if progress is not None:
            progress("template", done, len(CELLS), cell)
        templates[cell] = stored_template(cell)
    if progress is not None:
        progress("template", len(CELLS), len(CELLS), "")
    table = {cell: measure(template) for cell, template in templates.items()}
    figure = new_figure(*SIZE)
    whole, zoom = figure.subplots(1, 2)
    _draw_whole(whole, templates, table)
    _draw_zoom(zoom, templates, default_template())
    for axes in (whole, zoom):
        axes.legend(
            frameon=False, fontsize=style.TICK_SIZE, loc="center left", bbox_to_anchor=LEGEND_PLACE
        )
        style.finish_axes(axes, "time since activation (ms)", "transmembrane potential (mV)")
    style.set_title(figure, "Ten Tusscher–Panfilov 2006 cells in a cable")
    return figure, table


def measure(template: CableTemplate) -> dict[str, float]:
    """One row of the table of `template_figure`."""
    times, potentials = template.times, template.potentials
    return {
        "resting_potential": float(potentials[0]),
        "overshoot": float(potentials.max()),
        "max_upstroke": max_upstroke(times, potentials)[0],
        "apd90": duration(times, potentials),
        "conduction_velocity": template.speed,
    }


def _draw_whole(
    axes: Axes, templates: Mapping[str, CableTemplate], table: Mapping[str, Mapping[str, float]]
) -> None:
    time = np.linspace(-SHOWN_BEFORE, SHOWN_AFTER, POINTS)
    for cell, template in templates.items():
        apd = table[cell]["apd90"]
        axes.plot(
            time, template.full(time), color=COLOURS[cell], linewidth=LINE,
            label=f"{cell}, APD90 {apd:.0f} ms",
        )  # fmt: skip
        axes.plot(apd, template.full(np.array(apd)), "o", color=COLOURS[cell], markersize=4)
    axes.set_xlim(time[0], time[-1])


def _draw_zoom(axes: Axes, templates: Mapping[str, CableTemplate], used: CableTemplate) -> None:
    time = np.linspace(*ZOOM, POINTS)
    for cell, template in templates.items():
        axes.plot(time, template.full(time), color=COLOURS[cell], linewidth=LINE, label=cell)
    axes.plot(
        time, used(time), "--", color=style.BLACK, linewidth=LINE, label=f"template ({used.cell})"
    )
    axes.axvline(used.span[1], color=style.GREY, linewidth=0.6, linestyle=":")
    axes.set_xlim(*ZOOM)
