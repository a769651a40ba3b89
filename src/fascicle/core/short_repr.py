"""Short texts of objects that hold arrays, for notebooks and messages."""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Sized
from typing import Any

from fascicle.core.ranges import digits

LONGEST_TEXT = 40


def short_repr(self: Any) -> str:
    """Name and fields of a dataclass on one line: numbers and names as they are, arrays by shape.

    To be a class's ``__repr__``.
    """
    shown = (
        f"{field.name}={_shown(getattr(self, field.name))}"
        for field in dataclasses.fields(self)
        if field.repr
    )
    return f"{type(self).__name__}({', '.join(shown)})"


def _shown(value: Any) -> str:
    if isinstance(value, str):
        text = value if len(value) <= LONGEST_TEXT else f"{value[:LONGEST_TEXT]}…"
        return repr(text)
    if value is None or isinstance(value, bool | int):
        return repr(value)
    if isinstance(value, numbers.Real):
        return digits(float(value))
    shape = getattr(value, "shape", None)
    if shape is not None:
        return " × ".join(map(str, shape)) or "scalar"
    if isinstance(value, Sized) and not dataclasses.is_dataclass(value):
        return f"{len(value)} {'item' if len(value) == 1 else 'items'}"
    return type(value).__name__
