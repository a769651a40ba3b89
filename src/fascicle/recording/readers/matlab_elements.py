"""The elements of a MATLAB 5 to 7.2 file, checked before anything is made of them.

scipy trusts the types, sizes and nesting that a file declares: a few damaged bytes can make it ask
for any amount of memory, or end the process.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from fascicle.core.errors import InputError

LARGEST = 512 * 2**20  # bytes of a file when decompressed
_HEADER = 128  # bytes before the first element
_DEEPEST = 8  # structures and cells within each other
_MOST_AXES = 32
_BLANKS = 1000  # characters that may be stored as nothing, because all are blank
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # of numeric elements
_INTEGERS = (5, 6)
_NAMES = (1, 16)
_TEXTS = (1, 2, 3, 4, 16, 17, 18)
_CELL, _STRUCT, _CHAR = 1, 2, 4  # classes of matrices
_NUMERIC = range(6, 16)
_REFUSED = {
    3: "an object",
    5: "a sparse matrix",
    16: "a function",
    17: "an object such as a string, table or datetime",
}
_COMPLEX = 1 << 11  # flag of a matrix


class _Element(NamedTuple):
    kind: int
    data: memoryview


class _DamagedError(Exception):
    """An element does not hold what it declares."""


def checked_elements(path: Path) -> bytes:
    """Return a MATLAB 5 to 7.2 file with its elements decompressed and checked.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    bytes
        A MATLAB 5 file in which no element declares more than it holds.

    Raises
    ------
    InputError
        When the file is damaged or too large, or holds objects, functions or sparse matrices.

    References
    ----------
    The MathWorks, MAT-File Format, chapter 1: level 5 MAT-file format.
    """
    data = path.read_bytes()
    order = "<" if data[126:128] == b"IM" else ">"
    parts = [data[:_HEADER]]
    try:
        for element in _elements(memoryview(data)[_HEADER:], order, padded=False):
            if element.kind == _COMPRESSED:
                room = LARGEST - sum(map(len, parts))
                element = _only(_elements(_decompressed(path, element.data, room), order))
            if element.kind != _MATRIX:
                raise _DamagedError(f"element of type {element.kind}")
            _check_matrix(path, element.data, order, _DEEPEST)
            parts.append(struct.pack(order + "II", _MATRIX, len(element.data)) + element.data)
    except (struct.error, zlib.error, _DamagedError) as error:
        raise InputError(f"{path}: damaged MATLAB file ({error}); save it again") from error
    return b"".join(parts)


def _elements(data: memoryview, order: str, padded: bool = True) -> Iterator[_Element]:
    """Yield the elements one after another; only those at the top may be unpadded."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        start = at + 8
        if kind >> 16:  # small elements have both numbers in four bytes, and four bytes of data
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise _DamagedError(f"small element of {size} bytes")
        if start + size > len(data):
            raise _DamagedError(f"{len(data) - start} of {size} bytes")
        yield _Element(kind, data[start : start + size])
        at = start + size
        if padded:
            at += -at % 8


def _decompressed(path: Path, data: memoryview, room: int) -> memoryview:
    """Return the bytes of a compressed element, refusing more than `room`."""
    inflater = zlib.decompressobj()
    whole = inflater.decompress(data, max(room, 1))
    if inflater.unconsumed_tail:
        raise InputError(
            f"{path}: more than {LARGEST / 2**20:.0f} MB when decompressed; cut the recording, "
            "10 s are enough"
        )
    if not inflater.eof:
        raise _DamagedError("compressed data end early")
    return memoryview(whole)


def _only(elements: Iterator[_Element]) -> _Element:
    found = list(elements)
    if len(found) != 1:
        raise _DamagedError(f"{len(found)} compressed elements in place of one")
    return found[0]


def _check_matrix(path: Path, data: memoryview, order: str, depth: int) -> None:
    """Check what a matrix declares against what it holds, and so for all in it."""
    if not data:
        return  # an empty matrix within a cell or structure
    elements = _elements(data, order)
    flags = _integers(next(elements, None), order)[0]
    name_of_class = _REFUSED.get(flags & 0xFF)
    if name_of_class is not None:
        raise InputError(
            f"{path}: holds {name_of_class}; save plain arrays of numbers, and names as a cell "
            "array of texts (cellstr)"
        )
    shape = _integers(next(elements, None), order)
    if not 2 <= len(shape) <= _MOST_AXES or min(shape) < 0:
        raise _DamagedError(f"array of shape {shape[:4]}")
    if (name := next(elements, None)) is None or name.kind not in _NAMES:
        raise _DamagedError("array without a name")
    _check_content(path, list(elements), flags, math.prod(shape), order, depth)


def _check_content(
    path: Path, content: list[_Element], flags: int, count: int, order: str, depth: int
) -> None:
    """Check what follows the name of a matrix of `count` entries."""
    kind = flags & 0xFF
    if kind in _NUMERIC:
        whole = len(content) == 1 + bool(flags & _COMPLEX) and all(
            len(part.data) == count * _BYTES.get(part.kind, -1) for part in content
        )
    elif kind == _CHAR:
        whole = len(content) == 1 and content[0].kind in _TEXTS
        whole = whole and count <= max(len(content[0].data), _BLANKS)
    elif kind in (_CELL, _STRUCT):
        if kind == _STRUCT:
            count, content = count * _field_count(content[:2], order), content[2:]
        if depth == 0:
            raise _DamagedError("arrays nested too deep")
        whole = len(content) == count and all(part.kind == _MATRIX for part in content)
    else:
        whole = False
    if not whole:
        raise _DamagedError(f"array of class {kind} does not hold the {count} entries it declares")
    if kind in (_CELL, _STRUCT):
        for part in content:
            _check_matrix(path, part.data, order, depth - 1)


def _field_count(elements: Sequence[_Element], order: str) -> int:
    """Return the number of fields of a structure, from the length of a name and all names."""
    if len(elements) != 2 or elements[1].kind not in _NAMES:
        raise _DamagedError("structure without fields")
    length = _integers(elements[0], order)[0]
    if length < 1:
        raise _DamagedError(f"field names of {length} bytes")
    return len(elements[1].data) // length


def _integers(element: _Element | None, order: str) -> tuple[int, ...]:
    if element is None or element.kind not in _INTEGERS or len(element.data) < 4:
        raise _DamagedError("array without flags or shape")
    count = len(element.data) // 4
    return struct.unpack(f"{order}{count}i", element.data[: 4 * count])
