"""Style of all figures, and how they are saved."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from matplotlib import rc_context, rcParams, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure

from fascicle.core.errors import InputError
from fascicle.core.files import MADE_WITH, atomic_path
from fascicle.core.ranges import check_items

KINDS = ("png", "pdf", "svg")  # file formats of figures
RC: dict[str, Any] = {
    "font.size": 9,
    "figure.titlesize": 10.5,
    "figure.labelsize": 9,
    "figure.facecolor": "white",
    "axes.titlesize": 10.5,
    "axes.labelsize": 9,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "legend.title_fontsize": 9,
    "lines.linewidth": 1.3,
    "lines.markersize": 4,
    "text.parse_math": False,  # names of files and scenarios may hold a $
}


class Colour(StrEnum):
    """Okabe and Ito's palette (2008), distinct with every common form of colour blindness."""

    BLUE = "#0072B2"
    VERMILION = "#D55E00"
    GREEN = "#009E73"
    PURPLE = "#CC79A7"
    ORANGE = "#E69F00"
    SKY = "#56B4E9"
    YELLOW = "#F0E442"
    GREY = "#6B6B6B"
    LIGHT_GREY = "#C4C4C4"
    PAPER = "#F0D3CF"  # lines of ECG paper


P = ParamSpec("P")
user_first = ContextVar("what the user has set in Matplotlib counts before `RC`", default=False)


def set_by_user(name: str) -> bool:
    """True if the user has changed a setting of Matplotlib, and `user_first` lets it count."""
    settings: dict[str, Any] = rcParams  # type: ignore[assignment]  # its stubs want literals
    return user_first.get() and settings[name] != rcParamsDefault[name]  # type: ignore[index]


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Decorate a function that draws a figure: it uses `RC` instead of the user's settings."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        sizes = not set_by_user("font.size")  # else all sizes of text follow it
        look = {k: v for k, v in RC.items() if not set_by_user(k) and (sizes or "size" not in k)}
        with rc_context(look):  # type: ignore[arg-type]  # its stubs want literals
            figure = draw(*args, **kwargs)
        for axes in figure.axes:  # ticks are made when they are drawn
            axes.tick_params(which="major", width=0.6, length=3)  # points
            axes.tick_params(which="minor", length=0)
            if sizes:
                axes.tick_params(which="major", labelsize=8)
        return figure

    return drawn


@styled
def one_axes(
    draw: Callable[..., None], *arguments: Any, size: tuple[float, float] = (4.8, 4.4), **kind: Any
) -> Figure:
    """Figure that `draw` draws into axes of a `kind`, such as a projection."""
    figure = new_figure(*size)
    draw(figure.add_subplot(**kind), *arguments)
    return figure


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """Figure (inch) with a constrained layout, independent of pyplot."""
    size = None if set_by_user("figure.figsize") else (width, height)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    if title and size:  # at a size given by the user it may lie under the legend
        head(figure, title)
    return figure


def head(figure: Figure | SubFigure, text: str, **looks: Any) -> None:
    """Write a text above a figure, left-aligned and wrapped."""
    text = re.sub(r"(?<!\\)\$", r"\$", text)  # else Matplotlib measures wrapped text as a formula
    figure.suptitle(text, x=0.01, ha="left", wrap=True, parse_math=True, **looks)


def mark(figure: Figure, caution: str | None) -> Figure:
    """Write above a figure why it should not be relied on, if there is a caution."""
    if caution is not None:
        title = f"{caution}\n{figure.get_suptitle()}".strip()
        head(figure, title, color="#B34700", fontweight="bold", fontsize=RC["figure.titlesize"])
        for figure_legend in figure.legends:  # below that line
            top = 1 - 0.16 / figure.get_figheight()
            figure_legend.set_bbox_to_anchor((0, 0, 1, top), figure.transFigure)
    return figure


def below_leads(figure: Figure | SubFigure, time: str, caption: str = "") -> None:
    """Name the axes of panels of leads, and write a caption below them."""
    figure.supxlabel(f"{time}\n{caption}".strip(), wrap=True)
    figure.supylabel("potential (mV)")


def name_lead(axes: Axes, lead: str, note: str = "", **looks: Any) -> None:
    """Write the name of a lead into the upper left corner of its panel, a note into the right."""
    place: dict[str, Any] = {"transform": axes.transAxes, "va": "top"} | looks
    axes.text(0.03, 0.96, lead, fontweight="bold", **place)
    if note:
        axes.text(0.98, 0.96, note, ha="right", fontsize="small", **place)


def legend(figure: Figure | SubFigure, handles: Sequence[tuple[Any, str]], **place: Any) -> None:
    """Legend of artists and their names, by default in one row above at the right."""
    artists, names = [artist for artist, _ in handles], [name for _, name in handles]
    looks: dict[str, Any] = {"loc": "outside upper right", "ncols": len(names)} | place
    figure.legend(artists, names, **looks)


def short(text: str, most: int = 40) -> str:
    """Text on one line; an ellipsis replaces its middle beyond `most` characters."""
    text = " ".join(text.split())
    if len(text) <= most:
        return text
    return f"{text[: most // 2]}…{text[len(text) - most // 2 + 1 :]}"


def signed(value: float) -> str:
    """Whole number with a true minus sign."""
    return f"{round(value):d}".replace("-", "\N{MINUS SIGN}")


def save(figure: Figure, path: Path | str) -> Path:
    """Write a figure atomically, in the format of the path's suffix; returns the path."""
    path = Path(path)
    check_picture(path)
    with atomic_path(path) as temporary, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # missing from the font: drawn as a box
        key = "Software" if path.suffix.lower() == ".png" else "Creator"
        figure.savefig(temporary, dpi=150, metadata={key: MADE_WITH})
    return path


def check_picture(path: Path) -> None:
    """Refuse a picture in a format that cannot be drawn."""
    if path.suffix.lower().removeprefix(".") not in KINDS:
        kinds = ", ".join(f".{kind}" for kind in KINDS)
        raise InputError(f"{path}: cannot draw '{path.suffix or 'no suffix'}'; use one of {kinds}")


def check_kinds(kinds: Sequence[str]) -> None:
    """Refuse file formats in which no figure can be written."""
    check_items(kinds, str, "figures", f"kinds of files: {', '.join(KINDS)}")
    for kind in kinds:
        if kind not in KINDS:
            raise InputError(f"figures cannot be drawn as '{kind}'; use {', '.join(KINDS)}")
