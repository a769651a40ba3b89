"""HDF5 recordings, netCDF-4 and MATLAB 7.3 among them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.content import refuse_damaged
from fascicle.recording.readers.metadata import MOST_WORDS, Entry, entry_of, key_of
from fascicle.recording.readers.named_arrays import Array, Group, raw_recording_of
from fascicle.recording.readers.raw_recording import RawRecording, ReadOptions

if TYPE_CHECKING:
    import h5py

_DEEPEST = 3  # groups within groups; more may be a circle
_MATLAB_TEXTS = ("char", "cell")
_MATLAB_NUMBERS = (
    "",
    "double",
    "single",
    *(f"{s}int{b}" for s in ("", "u") for b in (8, 16, 32, 64)),
)


def read_hdf5(path: Path, options: ReadOptions) -> RawRecording:
    """Read a file with one dataset a lead, or with a matrix and the names of its leads.

    Data outside the file are not read.
    """
    import h5py

    kind = "MATLAB 7.3" if path.suffix.lower() == ".mat" else "HDF5"

    with refuse_damaged(path, kind):
        file = h5py.File(path, "r", locking=False)
    with file:
        with refuse_damaged(path, kind):
            if str(file.attrs.get("format", "")) == "fascicle target":
                raise InputError(f"{path}: is a target already; give the recording it is made of")
            groups = list(_groups(file, "", []))
        return raw_recording_of(groups, path, options, kind)


def _groups(node: h5py.Group, where: str, around: Sequence[Entry]) -> Iterator[Group]:
    """Yield a group and the groups in it."""
    import h5py

    found = Group(where or "/", [*_attributes(node), *around])
    within: dict[str, h5py.Group] = {}
    for key in node:
        name = printable(key if isinstance(key, str) else key.decode("latin-1"))
        stored = isinstance(node.get(key, getlink=True), h5py.HardLink)
        item: Any = node[key] if stored else None  # a link is not followed
        if isinstance(item, h5py.Group):
            within[name] = item
        elif reason := _unusable(item):
            found.unusable[name] = reason
        elif key_of(name) is not None and item.size <= MOST_WORDS:
            entry = entry_of(name, _content(item))
            found.metadata.extend([] if entry is None else [entry])
        elif item.dtype.kind not in "iuf" or _matlab_class(item) in _MATLAB_TEXTS:
            found.unusable[name] = "holds no numbers; save it as an array of numbers"
        else:
            found.arrays[name] = Array(item, _attributes(item))
    yield found
    if where.count("/") < _DEEPEST:
        for name, inner in within.items():
            if not name.startswith("#"):  # MATLAB's own
                yield from _groups(inner, f"{where}/{name}", found.metadata)


def _unusable(item: Any) -> str:
    """Say why a dataset cannot be read; empty when it can."""
    import h5py

    if not isinstance(item, h5py.Dataset):
        return "is a link, or no dataset; copy the data into the file"
    if item.is_virtual or item.external:
        return "has its data in other files; copy them into the file"
    if item.shape is None or "MATLAB_empty" in item.attrs:
        return "is empty"
    if _matlab_class(item) not in _MATLAB_NUMBERS + _MATLAB_TEXTS:
        return f"is a MATLAB {_matlab_class(item)}; save numbers as double and names by cellstr"
    text = h5py.check_string_dtype(item.dtype) is not None
    if item.dtype.kind not in "iuf" and not text and _matlab_class(item) != "cell":
        return f"holds {item.dtype.name} values; save it as an array of numbers"
    if item.size and not item.id.get_storage_size():
        return f"declares {item.size} values and holds none; export it again"
    return ""


def _matlab_class(item: h5py.Dataset) -> str:
    """Return the type that MATLAB 7.3 notes at what it writes; empty in other files."""
    noted = item.attrs.get("MATLAB_class", b"")
    return printable(noted.decode("latin-1")) if isinstance(noted, bytes) else ""


def _attributes(item: Any) -> list[Entry]:
    """Return the metadata that the attributes of a group or dataset hold."""
    known = [key for key in item.attrs if isinstance(key, str) and key_of(key) is not None]
    entries = [entry_of(key, item.attrs[key]) for key in known]
    return [entry for entry in entries if entry is not None]


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
