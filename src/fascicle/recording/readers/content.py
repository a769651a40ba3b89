"""The file of a recording: its kind, its hash, and what it means when a library fails on it."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from fascicle.core.errors import InputError, one_line

LARGEST_FILE = 512 * 2**20  # bytes; ten times what a recording of the longest length takes

# What libraries that trust their files raise on damaged ones
LIBRARY_ERRORS: tuple[type[Exception], ...] = (
    ValueError, OSError, EOFError, LookupError, NameError, TypeError, AttributeError,
    ArithmeticError, MemoryError, RuntimeError, struct.error, zlib.error,
)  # fmt: skip


def kind_of_content(path: Path) -> str | None:
    """Kind of file from marks that are unmistakable; None where there is none."""
    with path.open("rb") as file:
        start = file.read(512)
    if start[128:132] == b"DICM":
        return "DICOM"
    if start.startswith(b"\x89HDF\r\n\x1a\n"):
        return "HDF5"
    if start.startswith(b"MATLAB "):
        return "MAT" if b"HDF5" not in start[:128] else "HDF5"
    if start.startswith(b"0       ") and len(start) >= 256:
        return "EDF"
    if start[16:22] == b"SCPECG":
        return "SCP-ECG"
    if start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<?xml", b"<")):
        return "XML"
    return None


def sha256_of(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of files, one after another."""
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            hashlib.file_digest(file, lambda: digest)  # goes on with what is hashed already
    return digest.hexdigest()


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
