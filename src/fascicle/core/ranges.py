"""Checks of input: possible numbers, and the kinds of objects; text of values in messages.

The quantities of the model have their ranges in `fascicle.core.quantities`. A value outside is
a slip of units or of a key, and would make a simulation take hours, or simulate nothing.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
import re
from collections.abc import Iterable, Sized
from typing import TYPE_CHECKING, Any

from fascicle.core.errors import ValueRefusedError

if TYPE_CHECKING:
    from fascicle.core.arrays import Floats


@dataclasses.dataclass(frozen=True)
class Range:
    """Valid range of one kind of number, with its unit, if any, and its meaning.

    `also` is one more possible value: 0, which blocks, or infinity, which is never.
    """

    unit: str
    low: float
    high: float
    meaning: str
    also: float | None = None

    def __contains__(self, value: float) -> bool:
        """True if a number is possible."""
        return self.low <= value <= self.high or value == self.also

    def __str__(self) -> str:
        """Text of the range, such as ``0.01 to 100 mm, or 0``."""
        other = f", or {self.also:g}" if self.also is not None else ""
        return f"{digits(self.low)} to {digits(self.high)}{self._suffix}{other}"

    @property
    def _suffix(self) -> str:
        return f" {self.unit}" if self.unit else ""

    def check(self, value: Any, label: str) -> float:
        """Check a number and return it as a float; `label` is its name in the message."""
        as_float = number(value, label)
        if as_float not in self:
            raise ValueRefusedError(f"{label} is {digits(as_float)}{self._suffix}; give {self}")
        return as_float


# Numbers that are given with hearts, recordings and scenarios
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
    "delay": Range("ms", 0.0, 10_000.0, "delay of a junction; inf blocks", math.inf),
    "fraction": Range("", 0.0, 1.0, "a ventricular coordinate of a site"),
    "age": Range("years", 18.0, 100.0, "an adult's age"),
    "height": Range("cm", 130.0, 220.0, "an adult's height"),
    "weight": Range("kg", 30.0, 200.0, "an adult's weight"),
    "label": Range("", -(2.0**31), 2.0**31 - 1, "number of a region of a mesh"),
}


def number(value: Any, label: str) -> float:
    """Number of Python or NumPy as a float; `label` names it in the message."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ValueRefusedError(f"{label} is {shown(value)}; give a number")
    try:
        return float(value)
    except OverflowError:  # a whole number of hundreds of digits
        raise ValueRefusedError(f"{label} is {shown(value)}; give a smaller number") from None


def within(name: str, value: Any, label: str) -> float:
    """A number as a float, if it lies in the range of this name in `RANGES`."""
    return RANGES[name].check(value, label)


def check_count(value: Any, label: str, least: int = 1) -> None:
    """Refuse a value that is not an integer, or is less than `least`."""
    is_integer = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not is_integer or value < least:
        raise ValueRefusedError(f"{label} is {shown(value)}; give a whole number, {least} or more")


def plain_name(name: str) -> str:
    """A name in small letters, without blanks, hyphens and underscores."""
    return re.sub(r"[\W_]+", "", name.casefold())


def did_you_mean(
    name: str, names: Iterable[str], aliases: Iterable[tuple[str, str]] = ()
) -> str | None:
    """Question for a message whether a similar known name was meant; None without one.

    `aliases` are pairs of another name, as `plain_name` gives it, and the known one.
    """
    meant: dict[str, list[str]] = {}
    for key, candidate in (*((plain_name(candidate), candidate) for candidate in names), *aliases):
        meant.setdefault(key, []).append(candidate)
    plain = plain_name(name)
    near = [plain] if plain in meant else difflib.get_close_matches(plain, meant, 1, cutoff=0.75)
    return f"did you mean {' or '.join(map(repr, meant[near[0]]))}?" if near else None


def check_kind(value: object, kind: type | tuple[type, ...], label: str, needed: str) -> None:
    """Refuse a value of another class; the message has its `label` and what is `needed`."""
    if not isinstance(value, kind):
        raise ValueRefusedError(f"{label} is {shown(value)}; give {needed}")


def check_items(values: object, kind: type | tuple[type, ...], label: str, needed: str) -> None:
    """Refuse a value that is not a list or tuple of such objects; see `check_kind`."""
    if not isinstance(values, list | tuple) or not all(isinstance(v, kind) for v in values):
        raise ValueRefusedError(f"{label}: {shown(values)} was given; give a list of {needed}")


def check_position(value: Any, label: str) -> None:
    """Refuse a value that is not a position of three coordinates (mm) in range."""
    if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != 3:
        raise ValueRefusedError(f"{label} is {shown(value)}; give three coordinates (mm)")
    for coordinate in value:
        within("coordinate", coordinate, f"{label}: a coordinate")


def check_array(name: str, values: Floats, label: str) -> None:
    """Refuse an array with a number outside a range of `RANGES`; non-finite ones are left out."""
    import numpy as np  # the command line must not load it

    finite = values[np.isfinite(values)]
    if finite.size:
        within(name, finite[np.abs(finite).argmax()], label)


def check_text(value: Any, label: str) -> None:
    """Refuse a value that is not a text of one line of at most 200 characters."""
    if not isinstance(value, str) or not value.isprintable() or len(value) > 200:
        raise ValueRefusedError(f"{label} is {shown(value)}; give a text, of one line")


def digits(value: float) -> str:
    """A number in four digits, or as many as it has before the point up to six."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e6 else f"{value:.4g}"


def shown(value: object) -> str:
    """Value in about 40 characters, for a message."""
    if isinstance(value, float):
        return digits(value)
    if isinstance(value, int) and abs(value) >= 10**7:  # Python refuses to write the longest
        return f"a whole number of {int(value.bit_length() * math.log10(2)) + 1} digits"
    if hasattr(value, "shape") and value.shape:
        return f"an array of shape {value.shape}"
    written = " ".join(repr(value).split())
    if not isinstance(value, str):  # without the address of an object in memory
        written = re.sub(r" at 0x[0-9A-Fa-f]+", "", written)
    return written if len(written) <= 40 else f"{written[:40]}…"


def short_repr(self: Any) -> str:
    """Serve as the ``__repr__`` of a dataclass: its fields in one line, arrays by their shape."""
    fields = (
        f"{field.name}={_short(getattr(self, field.name))}"
        for field in dataclasses.fields(self)
        if field.repr and getattr(self, field.name) is not None
    )
    return f"{type(self).__name__}({', '.join(fields)})"


def _short(value: Any) -> str:
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else f"{value[:40]}…")
    if isinstance(value, bool | int):
        return repr(value)
    if isinstance(value, numbers.Real):
        return digits(float(value))
    shape = getattr(value, "shape", None)
    if shape is not None:
        return " × ".join(map(str, shape)) or "scalar"
    if isinstance(value, Sized) and not dataclasses.is_dataclass(value):
        return f"{len(value)} {'item' if len(value) == 1 else 'items'}"
    return type(value).__name__
