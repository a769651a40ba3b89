"""HDF5 recordings, netCDF-4 and MATLAB 7.3 among them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.declared import DAMAGED, damage
from fascicle.recording.readers.hdf5_heaps import check_heaps, longest_text
from fascicle.recording.readers.metadata import MOST_WORDS, Remarks, is_remark, one_number
from fascicle.recording.readers.named_arrays import Array, Level, contents_of
from fascicle.recording.readers.raw_recording import Contents
from fascicle.recording.readers.read_options import Given

if TYPE_CHECKING:
    import h5py

_LONGEST_TEXT = 2**20  # bytes
_DEEPEST = 3  # groups within groups
LARGEST = 2**26  # values of one block of a dataset, which is read whole
_MOST_ENTRIES = 1000  # datasets and groups that are looked at
# Filters that come with HDF5 and h5py; others are libraries that would be loaded from somewhere
_FILTERS = {1: "deflate", 2: "shuffle", 3: "fletcher32", 32000: "lzf"}
_MATLAB_NUMBERS = (
    "", "double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32",
    "uint64",
)  # fmt: skip
_MATLAB_TEXTS = ("char", "cell")
_PARSE_ERRORS = (*DAMAGED, RuntimeError)  # of h5py


def read_hdf5(path: Path, given: Given) -> Contents:
    """Read a file with one dataset a lead, or with a matrix and the names of its leads.

    Parameters
    ----------
    path : path
        The file.
    given : Given
        What the user says; it must agree with the file.

    Returns
    -------
    Contents
        Leads in the unit that an attribute or dataset ``units`` states.

    Raises
    ------
    InputError
        When leads, rate or unit are missing, contradictory or ambiguous, or when the data lie
        outside the file or need a filter that is not HDF5's own.
    """
    return read_levels(path, given, "HDF5")


def read_levels(path: Path, given: Given, kind: str) -> Contents:
    """Read the contents of an HDF5 file, which messages and provenance call `kind`."""
    import h5py

    with damage(path, kind, _PARSE_ERRORS):
        file = h5py.File(path, "r", locking=False)
    with file:
        check_heaps(path)
        with damage(path, kind, _PARSE_ERRORS):
            if str(file.attrs.get("format", "")) == "fascicle target":
                raise InputError(f"{path}: is a target already; give the recording it is made of")
            levels = list(_levels(file, "", None, _Reading(path, kind)))
        return contents_of(levels, path, given, kind)


class _Reading:
    """The file, and how many of its entries have been looked at."""

    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind, self.entries = path, kind, 0

    def count(self) -> None:
        self.entries += 1
        if self.entries > _MOST_ENTRIES:
            raise InputError(
                f"{self.path}: more than {_MOST_ENTRIES} datasets and groups; put one recording "
                "into a file of its own"
            )


def _levels(
    group: h5py.Group, where: str, above: Level | None, reading: _Reading
) -> Iterator[Level]:
    """Yield a group and the groups in it."""
    import h5py

    arrays: dict[str, Array] = {}
    unusable: dict[str, str] = {}
    texts, numbers = _attributes(group)
    groups: dict[str, h5py.Group] = {}
    for key in group:
        reading.count()
        name = printable(key if isinstance(key, str) else key.decode("latin-1"))
        item = _stored_here(group, key)
        if isinstance(item, h5py.Group):
            groups[name] = item
        elif reason := _unusable(item):
            unusable[name] = reason
        elif is_remark(name) and item.size <= MOST_WORDS:
            _sort(name, item.dtype, _content(item), texts, numbers)
        elif item.dtype.kind not in "iuf" or _matlab_class(item) in _MATLAB_TEXTS:
            unusable[name] = "holds no numbers; save it as an array of numbers"
        else:
            arrays[name] = _array(item, reading)
    level = Level(where or "/", arrays, Remarks(texts, numbers), unusable, above)
    yield level
    if where.count("/") < _DEEPEST:
        for name, inner in groups.items():
            if not name.startswith("#"):  # MATLAB's own
                yield from _levels(inner, f"{where}/{name}", level, reading)


def _stored_here(group: h5py.Group, key: str | bytes) -> Any:
    """Return what lies in the file itself; None for a link, which is not followed."""
    from h5py import h5l

    name = key if isinstance(key, bytes) else key.encode("utf-8", "surrogateescape")
    return group[key] if group.id.links.get_info(name).type == h5l.TYPE_HARD else None


def _unusable(item: Any) -> str:
    """Say why a dataset cannot be read safely; empty when it can."""
    import h5py

    if not isinstance(item, h5py.Dataset):
        return "is a link, or no dataset; copy the data into the file"
    if item.is_virtual or item.external:
        return "has its data in other files; copy them into the file"
    if item.shape is None or "MATLAB_empty" in item.attrs:
        return "is empty"
    try:
        kind = item.dtype.kind
    except TypeError:
        return "is of a type unknown to numpy; save it as an array of numbers"
    text = h5py.check_string_dtype(item.dtype) is not None
    if kind not in "iuf" and not text and _matlab_class(item) != "cell":
        return f"holds {item.dtype.name} values; save it as an array of numbers"
    if kind == "O" and text and longest_text(item) > _LONGEST_TEXT:
        return f"declares a text of {longest_text(item)} bytes"
    if _matlab_class(item) not in _MATLAB_NUMBERS + _MATLAB_TEXTS:
        return f"is a MATLAB {_matlab_class(item)}; save numbers as double and names by cellstr"
    if item.size and not item.id.get_storage_size():
        return f"declares {item.size} values and holds none; export it again"
    if item.chunks is not None and math.prod(item.chunks) > LARGEST:
        return f"is stored in blocks of {math.prod(item.chunks)} values; export it in smaller ones"
    return _unknown_filter(item)


def _unknown_filter(item: h5py.Dataset) -> str:
    """Say which filter of a dataset is not HDF5's own; empty when none."""
    settings = item.id.get_create_plist()
    for number in range(settings.get_nfilters()):
        code, _, _, name = settings.get_filter(number)
        if code not in _FILTERS:
            shown = printable(name.decode("latin-1")) or "unnamed"
            return f"is compressed by filter {code} ({shown}); save it with gzip or uncompressed"
    return ""


def _matlab_class(item: h5py.Dataset) -> str:
    """Return the type that MATLAB 7.3 notes at what it writes; empty in other files."""
    noted = item.attrs.get("MATLAB_class", b"")
    return printable(noted.decode("latin-1")) if isinstance(noted, bytes) else ""


def _attributes(item: Any) -> tuple[dict[str, tuple[str, ...]], dict[str, float]]:
    """Return the texts and numbers that the attributes of a group or dataset hold."""
    texts: dict[str, tuple[str, ...]] = {}
    numbers: dict[str, float] = {}
    for key in item.attrs:
        if isinstance(key, str) and is_remark(key):
            attribute = item.attrs.get_id(key)
            if attribute.shape is not None and math.prod(attribute.shape) <= MOST_WORDS:
                _sort(printable(key), attribute.dtype, item.attrs[key], texts, numbers)
    return texts, numbers


def _content(item: h5py.Dataset) -> Any:
    """Read a small dataset; texts of MATLAB, which are character codes, become texts."""
    kind = _matlab_class(item)
    if kind == "char":
        return _lines(item)
    if kind == "cell":
        cells = [item.file[reference] for reference in np.ravel(item[()])]
        return [" ".join(_lines(cell)) for cell in cells]
    return item[()]


def _lines(item: Any) -> list[str]:
    """Return the rows of a text of MATLAB 7.3, which stores arrays transposed."""
    if _unusable(item) or _matlab_class(item) != "char" or item.size > MOST_WORDS:
        return []
    return ["".join(chr(code) for code in row) for row in np.atleast_2d(item[()]).T]


def _sort(
    name: str,
    dtype: np.dtype[Any],
    content: Any,
    texts: dict[str, tuple[str, ...]],
    numbers: dict[str, float],
) -> None:
    """Keep a remark with the texts or the numbers; several different numbers are NaN."""
    if isinstance(content, list) or dtype.kind in "SO":
        words = np.ravel(np.asarray(content, dtype=object))
        texts[name] = tuple(
            printable(
                (word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word))
                .rstrip("\0")
                .strip()
            )
            for word in words
        )
    elif dtype.kind in "iuf":
        numbers[name] = one_number(content)


def _array(item: h5py.Dataset, reading: _Reading) -> Array:
    """Describe a dataset, which is read later."""
    shape = tuple(length for length in item.shape if length != 1)

    def read() -> NDArray[np.float64]:
        with damage(reading.path, reading.kind, _PARSE_ERRORS):
            return np.array(item[()], dtype=np.float64).reshape(shape)

    return Array(shape, read, Remarks(*_attributes(item)))
