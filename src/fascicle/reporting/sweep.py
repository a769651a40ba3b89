"""What a sweep found: a curve, or a bull's eye of the left ventricle."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from fascicle.core.arrays import Floats
from fascicle.core.files import atomic_folder, write_text
from fascicle.heart.sites import SEGMENTS
from fascicle.prediction.comparison import SIGNED
from fascicle.prediction.index_names import INDICES
from fascicle.prediction.sweeps import SEGMENT, Swept
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure, save
from fascicle.reporting.fitted_text import INCH, wrapped
from fascicle.reporting.names import index_label, index_name
from fascicle.reporting.prediction import index_table
from fascicle.study.fitted import FittedStudy

SIZE, EYE = (5.6, 3.6), (4.6, 4.2)  # inch
TITLE_SHARE = 0.95  # of a figure's width
HALF, MOST = (25, 75), (5, 95)  # percentiles of the bands
COLOURS = "cividis_r"  # ordered for every colour vision; less is lighter, and better
# Rings of the bull's eye from outside: how many sectors, and the middle of the first one (degrees
# from the right, counter-clockwise): anterior is above, septal to the left
RINGS = ((6, 90.0), (6, 90.0), (4, 90.0), (1, 90.0))


def write_sweep(fitted: FittedStudy, swept: Swept, name: str, index: str, out: Path) -> None:
    """Write what a family of scenarios does.

    The folder holds ``indices.csv`` (every index of every scenario and network), ``summary.json``
    and ``sweep.png``.

    Parameters
    ----------
    fitted : FittedStudy
        The study.
    swept : Swept
        What `fascicle.prediction.sweeps.simulate_sweep` found.
    name, index : str
        Of the scenario that was varied, and what to draw.
    out : Path
        Folder to write.
    """
    named = {swept.called(key): found for key, found in swept.predicted.items()}
    values = {key: found.indices[index] for key, found in swept.predicted.items()}
    medians = [round(float(np.nanmedian(each)), 2) for each in values.values()]
    content: dict[str, Any] = {
        "verdict": fitted.verdict,
        "caution": fitted.statements.caution_text,
        "networks": len(next(iter(values.values()))),
        "index": index,
        "medians": dict(zip(named, medians, strict=True)),
        "impossible": {swept.called(key): why for key, why in swept.impossible.items()},
    }
    draw = partial(_bulls_eye, name=name)
    if swept.varied != SEGMENT:
        draw = partial(curve_figure, varied=swept.varied, name=name)
    with atomic_folder(out) as folder:
        write_text(folder / "indices.csv", index_table(named))
        write_text(folder / "summary.json", json.dumps(content, indent=2) + "\n")
        save(draw(values, index), folder / "sweep.png", content["caution"])


def _bulls_eye(values: Mapping[float, Floats], index: str, name: str) -> Figure:
    """Medians of an index with the stimulus in each segment; of a delay, of its size."""
    medians, title = np.full(len(SEGMENTS), np.nan), f"median {index_name(index)}"
    for key, each in values.items():
        medians[int(key) - 1] = np.nanmedian(np.abs(each) if index in SIGNED else each)
    if index in SIGNED:
        title += ", either way,"
    title = f"{name}: {title}, stimulus in each segment"
    return bulls_eye_figure(medians, title, INDICES[index])


def _head(figure: Figure, title: str, wide: float) -> None:
    """Write a title in as many lines as a figure of this width (inch) asks for."""
    lines = wrapped(title, style.TITLE_SIZE, TITLE_SHARE * wide * INCH)
    style.set_title(figure, "\n".join(lines))


def curve_figure(values: Mapping[float, Floats], index: str, varied: str, name: str) -> Figure:
    """Draw an index over what was varied.

    Parameters
    ----------
    values : mapping of float to (n,) array
        Of the networks.
    index : str
        One of `INDICES`.
    varied : str
        What was varied, and its unit.
    name : str
        Of the scenario.

    Returns
    -------
    Figure
        The median, and bands of half and of 90 % of the networks.
    """
    figure = new_figure(*SIZE)
    axes = figure.subplots()
    found = np.array(list(values.values()))
    for share, opacity in ((MOST, 0.2), (HALF, 0.35)):
        low, high = np.nanpercentile(found, share, axis=1)
        axes.fill_between(list(values), low, high, color=style.VERMILION, alpha=opacity, lw=0)
    axes.plot(list(values), np.nanmedian(found, axis=1), "o-", color=style.VERMILION, ms=3.0)
    style.finish_axes(axes, x=varied, y=index_label(index))
    title = f"{name}: median, half and 90 % of the networks"
    _head(figure, title, SIZE[0])
    return figure


def bulls_eye_figure(values: Floats, title: str, unit: str) -> Figure:
    """Draw a value of each segment of the left ventricle, seen from the apex.

    Parameters
    ----------
    values : (17,) array
        In the order of `fascicle.heart.sites.SEGMENTS`; NaN is left white.
    title, unit : str
        What they are.
    """
    figure = new_figure(*EYE)
    axes = figure.add_subplot(projection="polar")
    assert isinstance(axes, PolarAxes)
    norm = Normalize(float(np.nanmin(values)), float(np.nanmax(values)))
    colours = ScalarMappable(norm, COLOURS)
    number = 0
    for ring, (count, first) in enumerate(RINGS):
        for sector in range(count):
            middle = np.radians(first + sector * 360 / count)
            _draw(axes, ring, middle, 2 * np.pi / count, values[number], colours)
            number += 1
    axes.set_axis_off()
    axes.set_ylim(0, len(RINGS))
    for angle, wall in zip(
        (90, 180, 270, 0), ("anterior", "septal", "inferior", "lateral"), strict=True
    ):
        turned = 0 if angle in (90, 270) else 90
        axes.text(
            np.radians(angle), len(RINGS) + 0.25, wall, ha="center", va="center", rotation=turned,
            fontsize=style.LABEL_SIZE,
        )  # fmt: skip
    bar = figure.colorbar(colours, ax=axes, fraction=0.04, pad=0.08)
    bar.set_label(unit, fontsize=style.LABEL_SIZE)
    bar.ax.tick_params(labelsize=style.TICK_SIZE)
    _head(figure, title, EYE[0])
    return figure


def _draw(
    axes: PolarAxes, ring: int, middle: float, width: float, value: float, colours: ScalarMappable
) -> None:
    """One segment, with its value."""
    outer, innermost = len(RINGS) - ring, ring == len(RINGS) - 1
    red, green, blue, _ = colours.to_rgba(np.array([value]))[0]
    known = np.isfinite(value)
    axes.bar(
        middle, 1, width, bottom=outer - 1, color=(red, green, blue) if known else "white",
        edgecolor="white", linewidth=0 if innermost else 1,
    )  # fmt: skip
    if known:
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        axes.text(
            middle, 0 if innermost else outer - 0.5, style.whole(value), ha="center", va="center",
            fontsize=style.TICK_SIZE, color="white" if dark else style.BLACK,
        )  # fmt: skip
