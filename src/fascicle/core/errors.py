"""The errors that a user is meant to see, by family, and how texts of files stand in them."""

from __future__ import annotations

import copyreg
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that names the file, the thing, the value found and what to do. The
    command line prints it and exits with status 2. Anything else that is raised is a bug. What is
    not printable in it, such as a line break in the name of a file, is written out; what is too
    long, since it quotes a damaged file, is cut.

    Options of the command line (``--digits-per-mv 1000``) are written as arguments of Python
    (``digits_per_mv=1000``) unless `names_options`, which the command line sets.
    """

    names_options: ClassVar[bool] = False

    def __init__(self, message: str, longest: int = 900) -> None:
        text = printable(message)
        super().__init__(text if len(text) <= longest else f"{text[:longest]}…")

    def __str__(self) -> str:
        message = str(self.args[0])
        return message if InputError.names_options else as_arguments(message)

    def __reduce__(self) -> tuple[Any, ...]:
        """How a process hands it over: whatever arguments a subclass takes."""
        new = copyreg.__newobj__  # type: ignore[attr-defined]
        return new, (type(self), *self.args), vars(self)


class FileError(InputError):
    """A file that is to be read is missing, not of the needed format, or must not be read."""


class OutputError(InputError):
    """What is to be written has no place there, or something would be lost."""


class ValueRefusedError(InputError):
    """A number, a name or an object is not one that is possible there."""


@contextmanager
def given_in(where: object) -> Iterator[None]:
    """Begin the message of a refusal in the block with where the thing was given, as a file."""
    try:
        yield
    except InputError as error:
        error.args = (f"{where}: {error.args[0]}",)
        raise


def as_arguments(message: str) -> str:
    """A message with arguments of Python for options of the command line, but not of a command."""
    others = {"class": "beat_class", "exclude-beat": "exclude", "shared-gain": "shared_gain=True"}

    def argument(match: re.Match[str]) -> str:
        option, value = match["option"], match["value"]
        if option is None:
            return match[0]
        name = others.get(option, option.replace("-", "_"))
        if value is None:
            return name if "=" in name else f"{name}="
        if name in ("leads", "invert", "swap"):
            return f"{name}={value.split(',')}"
        return f"{name}='{value}'" if name in ("unit", "beat_class") else f"{name}={value}"

    value = r"(?: (?P<value>(?=\S*[A-Z\d])[\w.+-]+(?:,[\w.+-]+)*)(?=[;:,.)\s]|$))?"
    commands = r"'(?:fascicle|heart) [^']*'"
    return re.sub(rf"{commands}|(?<![\w-])--(?P<option>[a-z][a-z-]*){value}", argument, message)


def printable(text: str) -> str:
    """Return a text of a file with line breaks and the like written out, fit for a message."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(error: object) -> str:
    """What a library says of an error, in one short line."""
    text = " ".join(str(error).split())[:160] or type(error).__name__
    return printable(text)
