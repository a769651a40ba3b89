"""The one error type that a user is meant to see, and how texts of files stand in it."""

from __future__ import annotations

from typing import Any

LONGEST = 900  # characters of a message; a longer one quotes a damaged file


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that names the file, the thing, the value found and what to do. The
    command line prints it and exits with status 2. Anything else that is raised is a bug. What is
    not printable in it, such as a line break in the name of a file, is written out, and what is too
    long is cut.
    """

    def __init__(self, message: str) -> None:
        text = printable(message)
        super().__init__(text if len(text) <= LONGEST else f"{text[:LONGEST]}…")

    def __reduce__(self) -> tuple[Any, ...]:
        """How a process hands it over: whatever arguments a subclass takes."""
        return _restored, (type(self), self.args, vars(self))


def _restored(kind: type[InputError], args: tuple[Any, ...], state: dict[str, Any]) -> InputError:
    error = kind.__new__(kind, *args)
    vars(error).update(state)
    return error


def printable(text: str) -> str:
    """Return a text of a file with line breaks and the like written out, fit for a message."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(error: object) -> str:
    """What a library says of an error, in one short line."""
    text = " ".join(str(error).split())[:160] or type(error).__name__
    return printable(text)
