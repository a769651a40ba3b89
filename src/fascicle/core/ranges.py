"""What is possible for numbers that are given with hearts, recordings and scenarios.

The quantities of the model have theirs in `fascicle.core.quantities`. What lies outside is a slip
of units or of a key, and would make a simulation of hours, or one of nothing.
"""

from __future__ import annotations

import math
import numbers
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fascicle.core.errors import InputError

if TYPE_CHECKING:
    from fascicle.core.arrays import Floats

LONGEST = 40  # characters of what is no number that are shown
LONGEST_TEXT = 200  # characters of a name
ADDRESS = re.compile(r" at 0x[0-9A-Fa-f]+")  # where an object is in memory: says nothing to anybody


@dataclass(frozen=True)
class Range:
    """Possible values of one kind of number.

    Attributes
    ----------
    unit : str
        Of its values; empty where it has none.
    low, high : float
        Least and largest.
    also : float, optional
        One value beside: 0, which blocks, or infinity, which is never.
    meaning : str
        What such numbers are.
    """

    unit: str
    low: float
    high: float
    meaning: str
    also: float | None = None

    def __contains__(self, value: float) -> bool:
        """Whether a number is possible."""
        return self.low <= value <= self.high or value == self.also

    def __str__(self) -> str:
        """Such as ``0.01 to 100 mm, or 0``."""
        unit = f" {self.unit}" if self.unit else ""
        other = f", or {self.also:g}" if self.also is not None else ""
        return f"{digits(self.low)} to {digits(self.high)}{unit}{other}"


RANGES = {
    "time": Range("ms", -10_000.0, 10_000.0, "when a stimulus or the root of a tree fires"),
    "firing time": Range(
        "ms", -10_000.0, 10_000.0, "when the His bundle fires; inf: not at all", math.inf
    ),
    "coordinate": Range("mm", -10_000.0, 10_000.0, "a coordinate of a position or a mesh"),
    "capture radius": Range("mm", 0.0, 20.0, "radius within which a stimulus captures"),
    "radius": Range("mm", 0.01, 1000.0, "radius of a sphere of slow or scarred tissue"),
    "speed factor": Range("", 0.01, 100.0, "factor on a speed; 0 blocks", 0.0),
    "conductivity factor": Range("", 1e-4, 1e4, "factor on conductivities; 0 is scar", 0.0),
    "conductivity": Range("mS/cm", 1e-4, 1e3, "a conductivity of tissue"),
    "potential": Range("mV", -1e5, 1e5, "a sample of a recording"),
    "QRS end": Range("ms", -1000.0, 1000.0, "onset or offset of a QRS, from its R peak"),
    "noise": Range("mV", 1e-4, 1.0, "standard deviation of a single beat"),
    "low-pass": Range("Hz", 40.0, 450.0, "cutoff of a low-pass; lower ones smear the QRS"),
    "recorder's low-pass": Range("Hz", 20.0, 1000.0, "cutoff of the recorder's own low-pass"),
    "gain of the file": Range("1/mV", 1.0, 1e7, "a file's numbers per mV"),
    "sampling rate": Range(
        "Hz", 250.0, 1e5, "samples per second of a recording; fewer do not resolve the QRS"
    ),
    "threshold": Range("", -1e6, 1e6, "a gain that matters, in the unit of its index"),
    "label": Range("", -(2.0**31), 2.0**31 - 1, "number of a region of a mesh"),
}


def number(value: Any, what: str) -> float:
    """A number of Python or NumPy as a float.

    Parameters
    ----------
    value
        What was given.
    what : str
        What it is, for the message.

    Raises
    ------
    InputError
        If it is no number.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise InputError(f"{what} is {shown(value)}; give a number")
    try:
        return float(value)
    except OverflowError:  # a whole number of hundreds of digits
        raise InputError(
            f"{what} is {shown(value)}, which is too large; give a smaller one"
        ) from None


def within(name: str, value: Any, what: str) -> float:
    """A number as a float, if it is possible.

    Parameters
    ----------
    name : str
        Of its kind in `RANGES`.
    value
        What was given.
    what : str
        What it is, for the message, such as ``"stimulus: its time"``.

    Raises
    ------
    InputError
        If it is no number, or outside the range, with both.
    """
    found, possible = number(value, what), RANGES[name]
    if found not in possible:
        unit = f" {possible.unit}" if possible.unit else ""
        raise InputError(f"{what} is {digits(found)}{unit}; give {possible}")
    return found


def check_count(value: Any, what: str, least: int = 1) -> None:
    """Refuse what is no whole number, or less than `least`; `what` it is, for the message."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or value < least:
        raise InputError(f"{what} is {shown(value)}; give a whole number, {least} or more")


def check_kind(value: object, kind: type | tuple[type, ...], what: str, needed: str) -> None:
    """Refuse what is no object of a class.

    Parameters
    ----------
    value
        What was given.
    kind : type or tuple of types
        What it must be.
    what, needed : str
        What it is, and what to give instead, for the message.
    """
    if not isinstance(value, kind):
        raise InputError(f"{what} is {shown(value)}; give {needed}")


def check_items(values: object, kind: type | tuple[type, ...], what: str, needed: str) -> None:
    """Refuse what is no list or tuple of objects of a class; see `check_kind`."""
    if not isinstance(values, list | tuple) or not all(isinstance(one, kind) for one in values):
        raise InputError(f"{what}: {shown(values)} was given; give a list of {needed}")


def check_position(value: Any, what: str) -> None:
    """Refuse what is no position of three coordinates (mm).

    Parameters
    ----------
    value
        What was given.
    what : str
        What it is of, for the message.

    Raises
    ------
    InputError
        Unless it is three possible numbers.
    """
    if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != 3:
        raise InputError(f"{what} is {shown(value)}; give three coordinates (mm)")
    for coordinate in value:
        within("coordinate", coordinate, f"{what}: a coordinate")


def check_array(name: str, values: Floats, what: str) -> None:
    """Refuse an array that holds an impossible number; what is not finite is left to others.

    Parameters
    ----------
    name : str
        Of their kind in `RANGES`.
    values : array
        What was given.
    what : str
        What each is, for the message.

    Raises
    ------
    InputError
        With the one that is furthest out.
    """
    import numpy as np  # the command line must not load it

    finite = values[np.isfinite(values)]
    if finite.size:
        within(name, finite[np.abs(finite).argmax()], what)


def check_text(value: Any, what: str) -> None:
    """Refuse what is no text that fits into a line."""
    if not isinstance(value, str) or not value.isprintable() or len(value) > LONGEST_TEXT:
        raise InputError(f"{what} is {shown(value)}; give a text, of one line")


def digits(value: float) -> str:
    """A number in four digits, or as many as it has before the point up to six."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e6 else f"{value:.4g}"


def shown(value: object) -> str:
    """What was given, short enough for a message."""
    if isinstance(value, float):
        return digits(value)
    if isinstance(value, int) and abs(value) >= 10**7:  # Python refuses to write the longest
        return f"a whole number of {int(value.bit_length() * math.log10(2)) + 1} digits"
    if hasattr(value, "shape") and value.shape:
        return f"an array of shape {value.shape}"
    written = " ".join(repr(value).split())
    if not isinstance(value, str):
        written = ADDRESS.sub("", written)
    return written if len(written) <= LONGEST else f"{written[:LONGEST]}…"
