"""The global heaps of an HDF5 file, in which texts of variable length lie.

The HDF5 library walks a heap from object to object by the sizes it finds there; a damaged size of
zero keeps it walking for ever.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fascicle.core.errors import InputError

if TYPE_CHECKING:
    import h5py

_MARK = b"GCOL\x01\0\0\0"  # signature, version 1, reserved
_HEADER = 16  # bytes of the header of a heap, and of an object in it
_FREE = 0  # index of the object that is the unused rest of a heap; its size includes its header

# What a dataset holds of a text: its length, and where it lies
_REFERENCE = np.dtype([("length", "<u4"), ("heap", "<u8"), ("index", "<u4")])


def check_heaps(path: Path) -> None:
    """Refuse a file with a global heap whose objects do not fill it one after another.

    Parameters
    ----------
    path : path
        HDF5 file, with sizes of eight bytes as the library writes them.

    Raises
    ------
    InputError
        When an object is smaller than its header or reaches beyond its heap.

    References
    ----------
    The HDF Group, HDF5 File Format Specification version 3.0, III.E: Disk Format: Level 1E.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        start = data.find(_MARK)
        while start >= 0:
            if not _is_whole(data, start):
                raise InputError(f"{path}: damaged HDF5 file (heap of its texts); export it again")
            start = data.find(_MARK, start + _HEADER)


def _is_whole(data: mmap.mmap, start: int) -> bool:
    if start + _HEADER > len(data):
        return False
    end = start + struct.unpack_from("<Q", data, start + 8)[0]
    at = start + _HEADER
    if end > len(data):
        return False
    while at + _HEADER <= end:  # a shorter rest is unused
        index, size = struct.unpack_from("<H6xQ", data, at)
        step = size if index == _FREE else _HEADER + size + -size % 8
        if not _HEADER <= step <= end - at:
            return False
        at += step
    return True


def longest_text(dataset: h5py.Dataset) -> int:
    """Return the length (bytes) that a dataset declares for the longest of its texts.

    The library takes that much memory before it looks for the text. Lengths within chunks cannot be
    seen from outside and count as zero.
    """
    offset = dataset.id.get_offset()
    if offset is None or not dataset.size:
        return 0
    with Path(dataset.file.filename).open("rb") as file:
        file.seek(offset)
        entries = file.read(_REFERENCE.itemsize * dataset.size)
    if len(entries) < _REFERENCE.itemsize * dataset.size:
        return 0  # the library itself says so
    return int(np.frombuffer(entries, _REFERENCE)["length"].max())
