"""Tables of a file that are declared once: keys, types, ranges, defaults and meanings.

A class derived from `Table` is a frozen dataclass. Its fields are the keys of one TOML table; from
their types follow the checks, whether it is made in Python or read from a file, and from the texts
in their `Annotated` types the reference of the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from functools import wraps
from typing import Annotated, Any, ClassVar, Self, dataclass_transform, get_args, get_type_hints

from pydantic import BeforeValidator, ConfigDict, ValidationError, ValidationInfo
from pydantic.dataclasses import dataclass as checked_dataclass

from fascicle.core.errors import InputError, ValueRefusedError
from fascicle.core.ranges import RANGES, Range, check_position, check_text, shown, within


def _within(name: str) -> BeforeValidator:
    def limited(value: Any, info: ValidationInfo) -> float:
        return within(name, value, f"'{info.field_name}'")

    return BeforeValidator(limited)


def _whole(value: Any, info: ValidationInfo) -> int:
    number = within("label", value, f"'{info.field_name}'")
    if number != int(number):
        raise InputError(f"'{info.field_name}' is {shown(value)}; give a whole number")
    return int(number)


def _text(value: Any, info: ValidationInfo) -> str:
    check_text(value, f"'{info.field_name}'")
    return str(value)


def _point(value: Any, info: ValidationInfo) -> tuple[float, ...]:
    check_position(value, f"'{info.field_name}'")
    return tuple(map(float, value))


Time = Annotated[float, RANGES["time"], _within("time")]
FiringTime = Annotated[float, RANGES["firing time"], _within("firing time")]
Radius = Annotated[float, RANGES["radius"], _within("radius")]
CaptureRadius = Annotated[float, RANGES["capture radius"], _within("capture radius")]
SpeedFactor = Annotated[float, RANGES["speed factor"], _within("speed factor")]
Conductivity = Annotated[float, RANGES["conductivity factor"], _within("conductivity factor")]
Fraction = Annotated[float, RANGES["fraction"], _within("fraction")]
Label = Annotated[int, RANGES["label"], BeforeValidator(_whole)]
Delay = Annotated[float, RANGES["delay"], _within("delay")]
Name = Annotated[str, BeforeValidator(_text)]
Point = Annotated[tuple[float, float, float], RANGES["coordinate"], BeforeValidator(_point)]


@dataclass_transform(frozen_default=True)
class Table:
    """Base of the tables: ``class Stimulus(Table, table="stimulus")`` declares ``[[stimulus]]``.

    A file may hold any number of these; with `once` it holds one, ``[his]``.
    """

    table: ClassVar[str]
    once: ClassVar[bool]

    def __init_subclass__(cls, table: str, once: bool = False) -> None:
        cls.table, cls.once = table, once
        config = ConfigDict(extra="forbid", strict=True)
        checked_dataclass(frozen=True, config=config)(cls)
        checked = cls.__init__

        @wraps(checked)
        def init(self: Table, *values: Any, **named: Any) -> None:
            keys = cls.key_names()
            if len(values) > len(keys):
                raise TypeError(f"{cls.__name__} takes {len(keys)} values, {len(values)} given")
            arguments = dict(**dict(zip(keys, values, strict=False)), **named)
            try:
                checked(self, **arguments)
            except ValidationError as error:
                raise ValueRefusedError(f"{table}: {_complaint(error, arguments)}") from None

        setattr(cls, "__init__", init)  # noqa: B010  mypy forbids the assignment

    @classmethod
    def header(cls) -> str:
        """First line of a table in a file: ``[his]``, or ``[[stimulus]]``."""
        return f"[{cls.table}]" if cls.once else f"[[{cls.table}]]"

    @classmethod
    def key_names(cls) -> list[str]:
        """Keys of the table as declared; fields that are not compared are not keys of the file."""
        return [field.name for field in fields(cls) if field.compare]  # type: ignore[arg-type]

    @classmethod
    def of(cls, values: Any, number: int | None = None) -> Self:
        """Make an instance from a table of a file, the `number`-th of its kind."""
        if not isinstance(values, Mapping):
            problem = f"'{cls.table}' is {shown(values)}"
            raise InputError(f"{problem}; it must be a table: {cls.header()}")
        which = f"{cls.table} {number}" if number is not None else cls.table
        for key in values:
            if key not in cls.key_names():
                names = ", ".join(cls.key_names())
                raise ValueRefusedError(f"{which}: unknown key '{key}'; known: {names}")
        try:
            return cls(**values)
        except InputError as error:
            raise ValueRefusedError(f"{which}{str(error).removeprefix(cls.table)}") from None

    @classmethod
    def reference(cls) -> str:
        """Markdown table of the keys: their meanings, ranges and defaults."""
        summary = (cls.__doc__ or "").partition("\n")[0]
        rows = [f"`{cls.header()}`: {summary}", "", "| key | meaning | values | default |"]
        rows.append("|---|---|---|---|")
        hints = get_type_hints(cls, include_extras=True)
        for field in fields(cls):  # type: ignore[arg-type]
            if not field.compare:
                continue
            default = {MISSING: "must be given", None: ""}.get(field.default, field.default)
            annotations = [*_annotations(hints[field.name])]
            meaning = " ".join(part for part in annotations if isinstance(part, str))
            values = ", ".join(str(part) for part in annotations if isinstance(part, Range))
            rows.append(f"| `{field.name}` | {meaning} | {values} | {default} |")
        return "\n".join(rows)


def _annotations(hint: Any) -> Iterator[Any]:
    """Annotations of a type and of the types that it is composed of."""
    parts = getattr(hint, "__metadata__", ())
    yield from parts
    for inner in [hint.__origin__] if parts else get_args(hint):
        yield from _annotations(inner)


def _complaint(error: ValidationError, values: Mapping[str, Any]) -> str:
    """First problem that pydantic found, in words."""
    first = error.errors(include_url=False)[0]
    key = str(first["loc"][0]) if first["loc"] else ""
    if first["type"] == "missing":
        return f"'{key}' is missing"
    if "error" in first.get("ctx", {}):
        return str(first["ctx"]["error"])
    return f"'{key}' is {shown(values.get(key))}: {first['msg'].lower()}"
