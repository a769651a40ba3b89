"""HDF5 (netCDF-4 among them) and MATLAB files: named arrays, one a lead, or a matrix with names."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, printable
from fascicle.recording.readers import names
from fascicle.recording.readers.read import Channel, RawRecording

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True)
class _Array:
    """Numbers of a file, and the metadata about them alone."""

    numbers: Any
    metadata: Sequence[names.Entry] = ()

    @property
    def values(self) -> Floats:
        """Numbers without axes of length one."""
        return np.array(self.numbers, dtype=np.float64).squeeze()


@dataclass(frozen=True)
class _Group:
    """A file, or a group or structure in it; `metadata` are its own and those of its parents."""

    name: str
    metadata: list[names.Entry]
    arrays: dict[str, _Array] = field(default_factory=dict)
    textual: list[str] = field(default_factory=list)


def read_hdf5(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read a file with one dataset a lead, or with a matrix and the names of its leads.

    Links are not followed, data in other files are not read.
    """
    import h5py

    with h5py.File(path, "r", locking=False) as file:
        if str(file.attrs.get("format", "")) == "fascicle target":
            raise InputError(f"{path}: is a target already; give the recording it is made of")
        stored = _stored(file)
    return _raw_recording(stored, path, "MATLAB 7.3" if path.suffix.lower() == ".mat" else "HDF5")


def read_matlab(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read variables or the fields of a structure, of a file of MATLAB 4 to 7.3, which is HDF5."""
    from scipy.io import loadmat

    with path.open("rb") as file:
        start = file.read(128)
    if b"HDF5" in start:
        return read_hdf5(path, sampling_rate)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # such as a warning of a duplicate variable
        variables = loadmat(path, appendmat=False, simplify_cells=True)
    stored = {name: value for name, value in variables.items() if not name.startswith("__")}
    # MATLAB 4 has no header
    return _raw_recording(stored, path, "MATLAB 4" if 0 in start[:4] else "MATLAB 5")


def _stored(node: h5py.Group, depth: int = 0) -> dict[str, Any]:
    import h5py

    members: dict[str, Any] = _attributes(node)
    for key in node:
        linked = not isinstance(node.get(key, getlink=True), h5py.HardLink)
        item: Any = None if linked else node[key]
        if isinstance(item, h5py.Group) and depth < 4:  # deeper nesting may be circular
            members[key] = {} if key.startswith("#") else _stored(item, depth + 1)  # MATLAB's own
        elif isinstance(item, h5py.Dataset) and not item.is_virtual and not item.external:
            entries = (names.entry_of(name, value) for name, value in _attributes(item).items())
            content = _content(item)
            numeric = isinstance(content, np.ndarray) and content.dtype.kind in "iuf"
            metadata = [entry for entry in entries if entry is not None]
            members[key] = _Array(content, metadata) if numeric else content
        else:
            members[key] = None
    return members


def _attributes(item: Any) -> dict[str, Any]:
    return {key: item.attrs[key] for key in item.attrs if names.key_of(key) is not None}


def _content(item: h5py.Dataset) -> Any:
    """Read a dataset; the character codes that MATLAB 7.3 stores become text."""
    kind = item.attrs.get("MATLAB_class", b"")
    if kind == b"cell":
        cells = [_content(item.file[reference]) for reference in np.ravel(item[()])]
        return [cell for cell in cells if isinstance(cell, str)]
    if item.shape is None or "MATLAB_empty" in item.attrs:
        return None
    if kind == b"char":
        return "".join(chr(code) for code in np.ravel(item[()].T))
    return item[()]


def _groups(at: str, stored: Mapping[str, Any], around: Sequence[names.Entry]) -> Iterator[_Group]:
    """Yield a file or structure, sorted into metadata and arrays, and then those inside it."""
    group = _Group(at or "/", list(around))
    for key, value in stored.items():
        name, array = printable(key), value if isinstance(value, _Array) else _Array(value)
        if isinstance(value, Mapping):
            continue
        if (entry := names.entry_of(name, array.numbers)) is not None:
            group.metadata.append(entry)
        elif isinstance(array.numbers, np.ndarray) and array.numbers.dtype.kind in "iuf":
            group.arrays[name] = array
        else:
            group.textual.append(name)
    yield group
    for name, value in stored.items():
        if isinstance(value, Mapping):
            yield from _groups(f"{at}/{printable(name)}", value, group.metadata)


def _raw_recording(stored: Mapping[str, Any], path: Path, format: str) -> RawRecording:
    """Make a raw recording of the only place in a file that holds leads."""
    groups = list(_groups("", stored, []))
    places = {where: leads for group in groups for where, leads in _leads(group, path).items()}
    if not places:
        contents = [
            f"'{name}' ({_size(a)})" for group in groups for name, a in group.arrays.items()
        ]
        contents += [f"'{name}' (no numbers)" for group in groups for name in group.textual]
        # a record of a PhysioNet challenge
        header = ", or give the WFDB header (.hea) of the record" * ("val" in groups[0].arrays)
        raise InputError(
            f"{path}: no leads (found: {', '.join(contents[:4]) or 'nothing'}); name the arrays I, "
            f"II, V1 to V6, or add a list 'leads' of names to one matrix{header}"
        )
    if len(places) > 1:
        raise InputError(
            f"{path}: leads in {' and '.join(list(places)[:3])}; keep one recording in the file"
        )
    ((channels, metadata),) = places.values()
    names.check_physical(metadata, path)
    return RawRecording(channels, names.declared_rate(metadata, path), format)


def _leads(group: _Group, path: Path) -> dict[str, tuple[list[Channel], list[names.Entry]]]:
    """Leads of a group and their metadata, by place: arrays named after leads, named matrices."""
    vectors, vector_metadata, places = [], list(group.metadata), {}
    for name, array in group.arrays.items():
        values, metadata = array.values, [*array.metadata, *group.metadata]
        if values.ndim == 1:
            named = names.lead_name(name) or names.additional_lead_name(name)
            unit = None if named is None else names.declared_unit(metadata, path, name)
            vectors.append(Channel(name, values, unit, missing=names.fill_values(metadata)))
            vector_metadata += [] if names.lead_name(name) is None else array.metadata
        lists = [n for n in names.name_lists(metadata) if len(n) in values.shape and _are_leads(n)]
        if values.ndim != 2 or not lists:
            continue
        if len(set(lists)) > 1 or values.shape[0] == values.shape[1]:
            raise InputError(
                f"{path}: lead names of '{name}' ({_size(array)}) are ambiguous; keep one list of "
                "names, as long as one side of the matrix only"
            )
        rows, count = values if len(lists[0]) == len(values) else values.T, len(lists[0])
        units = [
            names.declared_unit(metadata, path, lead, (k, count)) for k, lead in enumerate(lists[0])
        ]
        leads = zip(lists[0], rows, units, strict=True)
        channels = [Channel(*lead, missing=names.fill_values(metadata)) for lead in leads]
        places[f"'{name}' of {group.name}"] = (channels, metadata)
    if _are_leads([vector.name for vector in vectors]):
        places[f"arrays named after leads of {group.name}"] = (vectors, vector_metadata)
    return places


def _are_leads(spelt: Sequence[str]) -> bool:
    """True if two names at least are leads: one alone may be a variable named `i`."""
    return sum(names.lead_name(name) is not None for name in spelt) > 1


def _size(array: _Array) -> str:
    return " x ".join(str(length) for length in np.shape(array.numbers) if length != 1)
