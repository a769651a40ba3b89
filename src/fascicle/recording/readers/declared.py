"""What a file states about its recording, held against what the user says."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.names import first_line, millivolts
from fascicle.recording.readers.read_options import Given

# What libraries that trust their files raise on damaged ones
DAMAGED = (
    ValueError, OSError, EOFError, KeyError, IndexError, TypeError, AttributeError,
    NotImplementedError, OverflowError, MemoryError,
)  # fmt: skip
_ROUNDING = 1e-6  # by which two spellings of one sampling rate may differ


def agreed_rate(path: Path, stated: float | None, given: Given) -> float:
    """Return the sampling rate (Hz) of the file or the user, who must not contradict each other."""
    if stated is None and given.sampling_rate is None:
        raise InputError(
            f"{path}: no sampling rate in the file; give it in Hz with --sampling-rate"
        )
    if stated is None or given.sampling_rate is None:
        return float(given.sampling_rate if stated is None else stated)  # type: ignore[arg-type]
    if not math.isclose(stated, given.sampling_rate, rel_tol=_ROUNDING):
        raise InputError(
            f"{path}: its sampling rate is {stated:g} Hz, --sampling-rate says "
            f"{given.sampling_rate:g} Hz; leave the option out or correct the file"
        )
    return stated


def same_unit(one: str, other: str) -> bool:
    """Tell whether two spellings mean the same unit."""
    if millivolts(one) is None or millivolts(other) is None:
        return one == other
    return millivolts(one) == millivolts(other)


@contextmanager
def damage(path: Path, kind: str, errors: tuple[type[Exception], ...]) -> Iterator[None]:
    """Turn what a library raises on a damaged file into the one line that the user sees."""
    try:
        yield
    except InputError:
        raise
    except errors as error:
        raise InputError(
            f"{path}: damaged {kind} file ({printable(first_line(error))}); export it again"
        ) from error
