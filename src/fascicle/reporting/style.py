"""What figures share in looks: colours, sizes, titles, axes, legends, scale bars."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe & Ito's palette (2008): distinct with every common form of colour blindness.
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN, PURPLE, ORANGE, SKY, YELLOW = "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442"
GREY = "#6B6B6B"
BLACK = "#1A1A1A"

LABEL_SIZE = 9.0  # points
TICK_SIZE = 8.0
TITLE_SIZE = 10.5
LEGEND_STYLE: dict[str, Any] = {"frameon": False, "fontsize": LABEL_SIZE}
TITLE_LEFT = 0.01  # of the figure's width
THICK_LINE = 1.3  # points; means
FRAME_LINE, TICK_LENGTH = 0.6, 3.0  # points
BAR_LINE = 2.0  # points; scale bars
BAR_GAP = 0.015  # of the panel's height, between a scale bar and its text


def set_title(figure: Figure, title: str | None) -> None:
    """Write a heading, if there is one, from the left."""
    if title is not None:
        figure.suptitle(title, fontsize=TITLE_SIZE, x=TITLE_LEFT, ha="left")


def finish_axes(axes: Axes, x: str | None = None, y: str | None = None) -> None:
    """Name the axes, take away the frame's upper and right side and set the ticks' size.

    Parameters
    ----------
    axes : Axes
        What to finish.
    x, y : str, optional
        Quantity and unit.
    """
    if x is not None:
        axes.set_xlabel(x, fontsize=LABEL_SIZE)
    if y is not None:
        axes.set_ylabel(y, fontsize=LABEL_SIZE)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=TICK_SIZE, width=FRAME_LINE, length=TICK_LENGTH)
    for side in ("left", "bottom"):
        axes.spines[side].set_linewidth(FRAME_LINE)


def write_in(axes: Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write a text, by default black and of `TITLE_SIZE`.

    Parameters
    ----------
    axes : Axes
        Where to.
    x, y : float
        Place as shares of the axes' width and height.
    text : str
        What.
    **style
        As in Matplotlib's ``Axes.text``.
    """
    defaults: dict[str, Any] = {"fontsize": TITLE_SIZE, "color": BLACK}
    axes.text(x, y, text, transform=axes.transAxes, **(defaults | style))


def whole(value: float, *, signed: bool = False) -> str:
    """Write a rounded number with a true minus sign; `signed` also gives a plus, but none to 0."""
    rounded = round(value)
    return f"{rounded:{'+' if signed and rounded else ''}d}".replace("-", "\N{MINUS SIGN}")


def scale_bar(axes: Axes, length: float, *, below: bool = False) -> None:
    """Draw a bar at the lower left.

    Parameters
    ----------
    axes : Axes
        In mm.
    length : float
        Of the bar (mm).
    below : bool
        Whether its text is below it.
    """
    (left, _), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    axes.plot([left, left + length], [bottom] * 2, color=BLACK, linewidth=BAR_LINE, clip_on=False)
    gap = BAR_GAP * (top - bottom)
    axes.text(
        left + length / 2, bottom - gap if below else bottom + gap, f"{length:.0f} mm", ha="center",
        va="top" if below else "bottom", fontsize=TICK_SIZE, color=BLACK,
    )  # fmt: skip
