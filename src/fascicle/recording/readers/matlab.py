"""MATLAB recordings: .mat files of every version."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import printable
from fascicle.recording.readers.content import kind_of_content
from fascicle.recording.readers.declared import DAMAGED, damage
from fascicle.recording.readers.hdf5 import read_levels
from fascicle.recording.readers.matlab_elements import checked_elements
from fascicle.recording.readers.metadata import MOST_WORDS, Remarks, is_remark, one_number
from fascicle.recording.readers.named_arrays import Array, Level, contents_of
from fascicle.recording.readers.raw_recording import Contents
from fascicle.recording.readers.read_options import Given

_DEEPEST = 3  # structures within structures
_PARSE_ERRORS = (*DAMAGED, UserWarning)  # of scipy


def read_matlab(path: Path, given: Given) -> Contents:
    """Read variables or the fields of a structure: one a lead, or a matrix and its lead names.

    Parameters
    ----------
    path : path
        The file, of MATLAB 4 to 7.2, or of 7.3, which is HDF5.
    given : Given
        What the user says; it must agree with the file.

    Returns
    -------
    Contents
        Leads in the unit that a variable or field ``units`` states.

    Raises
    ------
    InputError
        When leads, rate or unit are missing, contradictory or ambiguous, or when the file holds
        objects or functions.
    """
    if kind_of_content(path) == "HDF5":
        return read_levels(path, given, "MATLAB 7.3")
    with path.open("rb") as file:
        old = 0 in file.read(4)  # MATLAB 4, which has no header
    levels = list(_levels("", _variables(path, old), None))
    return contents_of(levels, path, given, "MATLAB 4" if old else "MATLAB 5")


def _variables(path: Path, old: bool) -> Mapping[str, Any]:
    """Return the variables of a file by name."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    content = path.read_bytes() if old else checked_elements(path)
    errors = (*_PARSE_ERRORS, MatReadError)
    with damage(path, "MATLAB", errors), warnings.catch_warnings():
        warnings.filterwarnings("error", message="Duplicate variable|Unreadable variable")
        found: Mapping[str, Any] = loadmat(io.BytesIO(content))
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _levels(where: str, variables: Mapping[str, Any], above: Level | None) -> Iterator[Level]:
    """Yield the variables of a file or the fields of a structure, and the structures in it."""
    arrays: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    numbers: dict[str, float] = {}
    unusable: dict[str, str] = {}
    structures: dict[str, Mapping[str, Any]] = {}
    for key, value in variables.items():
        name = printable(key)
        if not isinstance(value, np.ndarray):
            unusable[name] = "is a sparse matrix; save it as a full one"
            continue
        small = is_remark(name) and value.size <= MOST_WORDS
        if value.dtype.names is not None and value.size == 1:
            structures[name] = {field: value.flat[0][field] for field in value.dtype.names}
        elif small and (words := _words(value)) is not None:
            texts[name] = words
        elif value.dtype.kind not in "iuf":
            unusable[name] = "holds no real numbers; save it as double"
        elif small:
            numbers[name] = one_number(value)
        else:
            arrays[name] = _array(value)
    level = Level(where or "the variables", arrays, Remarks(texts, numbers), unusable, above)
    yield level
    if where.count(".") < _DEEPEST:
        for name, fields in structures.items():
            yield from _levels(f"{where}.{name}" if where else name, fields, level)


def _words(value: NDArray[Any]) -> tuple[str, ...] | None:
    """Return the rows of a text, or the texts of a cell array; None for anything else."""
    if value.dtype.kind == "U":
        return tuple(printable(str(row).strip()) for row in value.ravel())
    if value.dtype.kind != "O" or value.dtype.names is not None:
        return None
    cells = [_words(cell) if isinstance(cell, np.ndarray) else None for cell in value.ravel()]
    if any(cell is None or len(cell) > 1 for cell in cells):
        return None
    return tuple(cell[0] if cell else "" for cell in cells)


def _array(value: NDArray[Any]) -> Array:
    shape = tuple(length for length in value.shape if length != 1)
    return Array(shape, lambda: np.array(value, dtype=np.float64).reshape(shape))
