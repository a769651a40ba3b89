"""Errors for users, by family, and how messages quote the content of files."""

from __future__ import annotations

import copyreg
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, ClassVar

from fascicle.core import DISTRIBUTION


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that names the file, the thing, the value found and what to do. The
    command line prints it and exits with status 2. Anything else that is raised is a bug.
    Characters that are not printable, such as a line break in the name of a file, are escaped; a
    message that is too long, since it quotes a damaged file, is cut.

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
        """Pickle the error for another process, whatever arguments a subclass takes."""
        new = copyreg.__newobj__  # type: ignore[attr-defined]
        return new, (type(self), *self.args), vars(self)


class FileError(InputError):
    """A file that is to be read is missing, not of the needed format, or must not be read."""


class OutputError(InputError):
    """An output cannot be written to the place given, or something would be lost."""


class ValueRefusedError(InputError):
    """A number, a name or an object given as an argument is invalid."""


def check_installed(module: str, purpose: str, extra: str = "build") -> None:
    """Raise InputError if a module is missing that an extra of the installation brings."""
    if find_spec(module) is None:
        install = f"pip install '{DISTRIBUTION}[{extra}]'"
        raise InputError(f"{purpose} needs {module}; install it: {install}")


@contextmanager
def given_in(where: object) -> Iterator[None]:
    """Prefix the message of an InputError from the block with its place, such as a file."""
    try:
        yield
    except InputError as error:
        error.args = (f"{where}: {error.args[0]}",)
        raise


def as_arguments(message: str) -> str:
    """Message with Python arguments for command-line options, but not in quoted commands."""
    special = {"class": "beat_class", "exclude-beat": "exclude", "shared-gain": "shared_gain=True"}

    def argument(match: re.Match[str]) -> str:
        option, value = match["option"], match["value"]
        if option is None:
            return match[0]
        name = special.get(option, option.replace("-", "_"))
        if value is None:
            return name if "=" in name else f"{name}="
        if name in ("leads", "invert", "swap"):
            return f"{name}={value.split(',')}"
        return f"{name}='{value}'" if name in ("unit", "beat_class") else f"{name}={value}"

    value = r"(?: (?P<value>(?=\S*[A-Z\d])[\w.+-]+(?:,[\w.+-]+)*)(?=[;:,.)\s]|$))?"
    commands = r"'(?:fascicle|heart) [^']*'"
    return re.sub(rf"{commands}|(?<![\w-])--(?P<option>[a-z][a-z-]*){value}", argument, message)


def printable(text: str) -> str:
    """Return a text of a file with line breaks and the like escaped, fit for a message."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(error: object) -> str:
    """Message of a library's error, in one short line."""
    text = " ".join(str(error).split())[:160] or type(error).__name__
    return printable(text)
