"""Text of any origin, made to fit its place on a page."""

from __future__ import annotations

from functools import cache

from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.font_manager import FontProperties, findfont, get_font

from fascicle.reporting.figures import RESOLUTION

INCH = 25.4  # mm
MISSING, DOTS = "?", "…"
KEPT = "\N{NO-BREAK SPACE}"  # no line is broken there


def drawable(text: str) -> str:
    """Text on one line, with a question mark for what the figure's font cannot draw."""
    glyphs = _glyphs()
    return " ".join(_words("".join(_drawn(character, glyphs) for character in text)))


def width(text: str, size: float, weight: str = "normal") -> float:
    """Width (mm) of a line of `size` points.

    As in a PNG, where hinting makes text up to 5% wider than in PDF and SVG.

    Parameters
    ----------
    text : str
        One line.
    size : float
        Of the font (points).
    weight : str
        Of the font, as Matplotlib names it.
    """
    font = FontProperties(size=size, weight=weight)
    measured = _renderer().get_text_width_height_descent(text, font, False)  # type: ignore[no-untyped-call]
    pixels = measured[0]
    return float(pixels) / RESOLUTION * INCH


def shortened(text: str, size: float, room: float, weight: str = "normal") -> str:
    """Text on one line, the middle left out where it is too wide.

    Parameters
    ----------
    text, size, weight
        As for `width`.
    room : float
        The widest it may be (mm).
    """
    text = drawable(text)
    if width(text, size, weight) <= room:
        return text
    fewest, most = 0, len(text)
    while most - fewest > 1:
        kept = (fewest + most) // 2
        fits = width(_without_middle(text, kept), size, weight) <= room
        fewest, most = (kept, most) if fits else (fewest, kept)
    return _without_middle(text, fewest)


def wrapped(text: str, size: float, room: float) -> list[str]:
    """Lines broken between words, but not at no-break spaces.

    Parameters
    ----------
    text, size, room
        As for `shortened`, for each line.
    """
    lines: list[str] = []
    for word in _words(drawable(text)):
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and width(longer, size) <= room:
            lines[-1] = longer
        else:
            lines.append(shortened(word, size, room))
    return lines


def _without_middle(text: str, kept: int) -> str:
    """Start and end of a text, `kept` characters together."""
    start = kept - kept // 2
    return text[:start] + DOTS + text[len(text) - kept // 2 :]


def _words(text: str) -> list[str]:
    return [word for word in text.split(" ") if word]


def _drawn(character: str, glyphs: frozenset[int]) -> str:
    if character == KEPT:
        return character
    if character.isspace():
        return " "
    return character if character.isprintable() and ord(character) in glyphs else MISSING


@cache
def _renderer() -> RendererAgg:
    """What measures text; its size does not matter."""
    return RendererAgg(1, 1, RESOLUTION)  # type: ignore[no-untyped-call]


@cache
def _glyphs() -> frozenset[int]:
    """Characters of the font that figures are set in."""
    return frozenset(get_font(findfont(FontProperties())).get_charmap())
