"""New figures, and the way to disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path

FORMATS = (".png", ".pdf", ".svg")
RESOLUTION = 150  # dots per inch
CAUTION_ROOM, CAUTION_SIZE = 0.3, 10.0  # inch above a figure; points
CAUTION_PLACE = 0.1  # inch from the left, and above the figure
CAUTION_COLOUR = "#B34700"


def new_figure(width: float, height: float, *, constrained: bool = True) -> Figure:
    """Empty white figure on the Agg canvas, of no pyplot window and no global state.

    Parameters
    ----------
    width, height : float
        Size (inch).
    constrained : bool
        Whether Matplotlib's constrained layout places the axes.
    """
    figure = Figure(
        figsize=(width, height), layout="constrained" if constrained else None, facecolor="white"
    )
    FigureCanvasAgg(figure)
    return figure


def check_picture(path: Path) -> None:
    """Refuse a picture in a format that cannot be drawn."""
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            f"{path}: cannot draw '{path.suffix or 'no suffix'}'; use one of {', '.join(FORMATS)}"
        )


def save(figure: Figure, path: Path | str, caution: str | None = None) -> Path:
    """Write a figure whole or not at all.

    Parameters
    ----------
    figure : Figure
        What to write.
    path : Path or str
        Where to; the suffix gives the format (``.png`` for the report; ``.pdf`` and ``.svg`` work).
    caution : str, optional
        Why it is not to be relied on; stands on a line above it.

    Returns
    -------
    Path
        The path written.
    """
    path = Path(path)
    check_picture(path)
    with atomic_path(path) as temporary, _line_above(figure, caution) as area:
        figure.savefig(temporary, dpi=RESOLUTION, bbox_inches=area)
    return path


@contextmanager
def _line_above(figure: Figure, text: str | None) -> Iterator[Bbox | None]:
    """Write a line above a figure, outside it, for as long as it is saved.

    Yields
    ------
    Bbox or None
        Area of both (inch); None, the figure's own, where there is no text.
    """
    if text is None:
        yield None
        return
    width, height = figure.get_size_inches()
    for legend in figure.legends:  # anchored to the figure as it is, not to both
        place = legend.get_bbox_to_anchor().transformed(figure.transFigure.inverted())
        legend.set_bbox_to_anchor(place, figure.transFigure)
    line = figure.text(
        CAUTION_PLACE / width, 1 + CAUTION_PLACE / height, text, fontsize=CAUTION_SIZE,
        fontweight="bold", color=CAUTION_COLOUR, in_layout=False,
    )  # fmt: skip
    try:
        yield Bbox([[0, 0], [width, height + CAUTION_ROOM]])
    finally:
        line.remove()
