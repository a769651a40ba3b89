"""Errors of libraries on damaged files, as the one line that the user sees."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fascicle.core.errors import InputError, one_line

# What libraries that trust their files raise on damaged ones
LIBRARY_ERRORS: tuple[type[Exception], ...] = (
    ValueError, OSError, EOFError, LookupError, NameError, TypeError, AttributeError,
    ArithmeticError, MemoryError, RuntimeError, struct.error, zlib.error,
)  # fmt: skip


@contextmanager
def refuse_damaged(source: Path | str, kind: str, *more: type[Exception]) -> Iterator[None]:
    """Turn what a library raises on a damaged file into an InputError.

    Parameters
    ----------
    source : path or str
        What the message begins with, usually the file.
    kind : str
        What messages call its format.
    *more : exception classes
        What the library raises besides `LIBRARY_ERRORS`.
    """
    try:
        yield
    except InputError:
        raise
    except (*LIBRARY_ERRORS, *more) as error:
        raise InputError(
            f"{source}: damaged or truncated {kind} file ({one_line(error)}); export it again"
        ) from error
