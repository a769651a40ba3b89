"""New figures, and the way to disk."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fascicle.core.errors import InputError
from fascicle.core.files import atomic_path

FORMATS = (".png", ".pdf", ".svg")
RESOLUTION = 150  # dots per inch


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


def save(figure: Figure, path: Path | str) -> Path:
    """Write a figure whole or not at all.

    Parameters
    ----------
    figure : Figure
        What to write.
    path : Path or str
        Where to; the suffix gives the format (``.png`` for the report; ``.pdf`` and ``.svg`` work).

    Returns
    -------
    Path
        The path written.
    """
    path = Path(path)
    check_picture(path)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=RESOLUTION)
    return path
