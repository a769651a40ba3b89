"""The errors that a user is meant to see, by family, and how texts of files stand in them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that names the file, the thing, the value found and what to do. The
    command line prints it and exits with status 2. Anything else that is raised is a bug. What is
    not printable in it, such as a line break in the name of a file, is written out; what is too
    long, since it quotes a damaged file, is cut.
    """

    def __init__(self, message: str, longest: int = 900) -> None:
        text = printable(message)
        super().__init__(text if len(text) <= longest else f"{text[:longest]}…")

    def __reduce__(self) -> tuple[Any, ...]:
        """How a process hands it over: whatever arguments a subclass takes."""
        return _restored, (type(self), self.args, vars(self))


def _restored(kind: type[InputError], args: tuple[Any, ...], state: dict[str, Any]) -> InputError:
    error = kind.__new__(kind, *args)
    vars(error).update(state)
    return error


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
        error.args = (f"{where}: {error}",)
        raise


def printable(text: str) -> str:
    """Return a text of a file with line breaks and the like written out, fit for a message."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(error: object) -> str:
    """What a library says of an error, in one short line."""
    text = " ".join(str(error).split())[:160] or type(error).__name__
    return printable(text)
