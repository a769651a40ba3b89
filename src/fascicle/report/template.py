"""The template action potential and the cells it comes from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fascicle.core.progress import Progress
from fascicle.forward.cable.cell import CELLS
from fascicle.forward.cable.measures import duration, max_upstroke, overshoot, resting_potential
from fascicle.forward.cable.stored import default_template, stored_template
from fascicle.forward.cable.template import CableTemplate
from fascicle.report.figures import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    TICK_SIZE,
    TITLE_SIZE,
    VERMILION,
    new_figure,
    tidy,
)

COLOURS = {"endocardial": BLUE, "midmyocardial": GREY, "epicardial": VERMILION}
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
    figure = new_figure(9.0, 3.8)
    whole, zoom = figure.subplots(1, 2)
    _draw_whole(whole, templates, table)
    _draw_zoom(zoom, templates, default_template())
    for axes in (whole, zoom):
        axes.set_xlabel("time since activation (ms)", fontsize=LABEL_SIZE)
        axes.set_ylabel("transmembrane potential (mV)", fontsize=LABEL_SIZE)
        axes.legend(
            frameon=False, fontsize=TICK_SIZE, loc="center left", bbox_to_anchor=(0.08, 0.4)
        )
        tidy(axes)
    figure.suptitle(
        "Ten Tusscher–Panfilov 2006 cells in a cable", fontsize=TITLE_SIZE, x=0.01, ha="left"
    )
    return figure, table


def measure(template: CableTemplate) -> dict[str, float]:
    """One row of the table of `template_figure`."""
    times, potentials = template.times, template.potentials
    return {
        "resting_potential": resting_potential(potentials),
        "overshoot": overshoot(potentials),
        "max_upstroke": max_upstroke(times, potentials)[0],
        "apd90": duration(times, potentials),
        "conduction_velocity": template.speed,
    }


def _draw_whole(
    axes: Axes, templates: Mapping[str, CableTemplate], table: Mapping[str, Mapping[str, float]]
) -> None:
    time = np.linspace(-SHOWN_BEFORE, SHOWN_AFTER, 4000)
    for cell, template in templates.items():
        apd = table[cell]["apd90"]
        axes.plot(
            time, template.full(time), color=COLOURS[cell], linewidth=1.2,
            label=f"{cell}, APD90 {apd:.0f} ms",
        )  # fmt: skip
        axes.plot(apd, template.full(np.array(apd)), "o", color=COLOURS[cell], markersize=4)
    axes.set_xlim(time[0], time[-1])


def _draw_zoom(axes: Axes, templates: Mapping[str, CableTemplate], used: CableTemplate) -> None:
    time = np.linspace(*ZOOM, 4000)
    for cell, template in templates.items():
        axes.plot(time, template.full(time), color=COLOURS[cell], linewidth=1.2, label=cell)
    axes.plot(time, used(time), "--", color=BLACK, linewidth=1.2, label=f"template ({used.cell})")
    axes.axvline(used.span[1], color=GREY, linewidth=0.6, linestyle=":")
    axes.set_xlim(*ZOOM)
