"""The template action potential and the cells it comes from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from fascicle.core.progress import Progress
from fascicle.forward.cable.cable import duration, max_upstroke
from fascicle.forward.cable.template import CableTemplate, default_template, stored_template
from fascicle.kernels.ten_tusscher import CELLS
from fascicle.reporting import style
from fascicle.reporting.style import Colour


def template_figure(progress: Progress | None = None) -> tuple[Figure, dict[str, dict[str, float]]]:
    """Action potentials of the three cell types in a cable, and the template of the ECG.

    The first time on a machine each cable takes seconds. Left, whole action potentials with their
    APD90; right, the first 80 ms with the template. The table, by cell type, has
    ``resting_potential`` and ``overshoot`` (mV), ``max_upstroke`` (V/s), ``apd90`` (ms) and
    ``conduction_velocity`` (m/s).
    """
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
    return _drawn(templates, table), table


@style.styled
def _drawn(
    templates: Mapping[str, CableTemplate], table: Mapping[str, Mapping[str, float]]
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
    used = default_template()
    zoom.plot(brief, used(brief), "--", color="black", label=f"template ({used.cell})")
    zoom.axvline(used.span[1], color=Colour.GREY, linewidth=0.6, linestyle=":")
    for axes, time in ((overview, long), (zoom, brief)):
        axes.legend(loc="center left", bbox_to_anchor=(0.05, 0.4), fontsize=8)
        axes.set(xlabel="time since activation (ms)", ylabel="transmembrane potential (mV)")
        axes.set_xlim(time[0], time[-1])
    return figure
