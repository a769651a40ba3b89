"""MATLAB recordings: .mat files of every version."""

from __future__ import annotations

import os
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.content import LARGEST_FILE, kind_of_content, refuse_damaged
from fascicle.recording.readers.hdf5 import read_hdf5
from fascicle.recording.readers.metadata import MOST_WORDS, Entry, entry_of, key_of
from fascicle.recording.readers.named_arrays import Array, Group, raw_recording_of
from fascicle.recording.readers.raw_recording import RawRecording, ReadOptions

_DEEPEST = 3  # structures within structures
_HEADER = 128  # bytes
_COMPRESSED = 15  # type of a data element
_PIECE = 2**16  # bytes, which unpack to 64 MB at most


def read_matlab(path: Path, options: ReadOptions) -> RawRecording:
    """Read variables or the fields of a structure: one a lead, or a matrix and its lead names.

    Files are of MATLAB 4 to 7.2, or of 7.3, which is HDF5.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    if kind_of_content(path) == "HDF5":
        return read_hdf5(path, options)
    with path.open("rb") as file:
        kind = "MATLAB 4" if 0 in file.read(4) else "MATLAB 5"  # MATLAB 4 has no header
    if kind == "MATLAB 5":
        _check_unpacked_size(path)
    with refuse_damaged(path, kind, MatReadError, UserWarning), warnings.catch_warnings():
        warnings.filterwarnings("error", message="Duplicate variable|Unreadable variable")
        variables = loadmat(path, appendmat=False)
        named = {name: value for name, value in variables.items() if not name.startswith("__")}
        groups = list(_groups("", named, []))
    return raw_recording_of(groups, path, options, kind)


def _check_unpacked_size(path: Path) -> None:
    """Refuse a MATLAB 5 file whose compressed variables are larger than any recording.

    scipy unpacks all of them at once. The file is a header and data elements, each with its type
    and size (MathWorks, MAT-File Format, "Level 5"). They are unpacked here piece by piece, since
    the size that a variable states may be wrong.
    """
    unpacked = 0
    with path.open("rb") as file, refuse_damaged(path, "MATLAB 5"):
        order = "<" if file.read(_HEADER).endswith(b"IM") else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != _COMPRESSED:
                file.seek(size, os.SEEK_CUR)
                continue
            unpacker = zlib.decompressobj()
            for start in range(0, size, _PIECE):
                unpacked += len(unpacker.decompress(file.read(min(_PIECE, size - start))))
                if unpacked > LARGEST_FILE:
                    raise InputError(
                        f"{path}: its variables take more than {LARGEST_FILE / 2**20:.0f} MB when "
                        "unpacked; save a part of the recording, 10 s are enough"
                    )


def _groups(where: str, variables: Mapping[str, Any], around: Sequence[Entry]) -> Iterator[Group]:
    """Yield the variables of a file or the fields of a structure, and the structures in it."""
    found = Group(where or "the variables", list(around))
    structures: dict[str, Mapping[str, Any]] = {}
    for key, value in variables.items():
        name = printable(key)
        if not isinstance(value, np.ndarray):
            found.unusable[name] = "is a sparse matrix; save it as a full one"
            continue
        entry = entry_of(name, _content(value)) if key_of(name) is not None else None
        if type(value) is np.ndarray and value.dtype.names is not None and value.size == 1:
            structures[name] = {field: value.flat[0][field] for field in value.dtype.names}
        elif entry is not None:
            found.metadata.append(entry)
        elif value.dtype.kind not in "iuf":
            found.unusable[name] = (
                "holds no real numbers; save numbers as double and names by cellstr"
            )
        else:
            found.arrays[name] = Array(value)
    yield found
    if where.count(".") < _DEEPEST:
        for name, fields in structures.items():
            yield from _groups(f"{where}.{name}" if where else name, fields, found.metadata)


def _content(value: NDArray[Any]) -> Any:
    """Return what may be metadata: numbers, rows of a text, or the texts of a cell array."""
    if value.dtype != object or value.size > MOST_WORDS:
        return value
    cells = [np.ravel(cell) if isinstance(cell, np.ndarray) else None for cell in value.ravel()]
    if any(cell is None or cell.dtype.kind != "U" or cell.size > 1 for cell in cells):
        return value[:0]
    return ["".join(cell) for cell in cells if cell is not None]
