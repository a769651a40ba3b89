"""Recordings kept as named arrays: one array a lead, or a matrix and the names of its rows.

HDF5 and MATLAB files have no standard for ECGs. Nothing in them is guessed: leads, rate and unit
must be declared under the names in `metadata`, once, or by the user.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.recording.readers.content import refuse_damaged
from fascicle.recording.readers.metadata import (
    Entry,
    Key,
    check_physical,
    declared_rate,
    declared_unit,
    key_of,
    missing_values,
    name_lists,
)
from fascicle.recording.readers.names import lead_name
from fascicle.recording.readers.raw_recording import Channel, RawRecording, ReadOptions
from fascicle.recording.recording import check_extent

_FEWEST = 2  # names that must be leads, so that a stray variable `i` makes no recording


@dataclass(frozen=True)
class Array:
    """A numeric array: `stored` is a dataset of a file, which is read by ``stored[()]``, or memory.

    `shape` leaves out axes of length one, `metadata` is what the file says about this array alone.
    """

    stored: Any
    metadata: Sequence[Entry] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes that are longer than one."""
        return tuple(length for length in self.stored.shape if length != 1)

    @property
    def size(self) -> str:
        """The shape as messages show it."""
        return " x ".join(map(str, self.shape))

    @cached_property
    def values(self) -> Floats:
        """The numbers; those that stand for missing samples are NaN."""
        values = np.array(self.stored[()], dtype=np.float64).reshape(self.shape)
        values[np.isin(values, missing_values(self.metadata))] = np.nan
        return values


@dataclass(frozen=True)
class Group:
    """A file, or a group or structure in it.

    Attributes
    ----------
    name : str
        What messages call it.
    metadata : sequence of Entry
        What is said here and in the groups around it.
    arrays : dict
        Numeric arrays by name.
    unusable : dict
        Name to why what stands there is no array of numbers.
    """

    name: str
    metadata: list[Entry]
    arrays: dict[str, Array] = field(default_factory=dict)
    unusable: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Signal:
    """One vector, or row `index` along `axis` of a matrix."""

    name: str
    array: Array
    axis: int = 0
    index: int | None = None

    @property
    def place(self) -> tuple[int, int]:
        """Index among the signals of its array, and their number."""
        return (0, 1) if self.index is None else (self.index, self.array.shape[self.axis])

    @property
    def length(self) -> int:
        return self.array.shape[0 if self.index is None else 1 - self.axis]

    @property
    def values(self) -> Floats:
        values = self.array.values
        return values if self.index is None else np.asarray(values.take(self.index, axis=self.axis))


def raw_recording_of(
    groups: Sequence[Group], path: Path, options: ReadOptions, kind: str
) -> RawRecording:
    """Make a raw recording of the one group that holds leads.

    Parameters
    ----------
    groups : sequence of Group
        All groups of a file.
    path : path
        What messages begin with.
    options : ReadOptions
        What the user says; it must agree with the file.
    kind : str
        Name of the format.

    Raises
    ------
    InputError
        When no group or several hold leads, or what goes with them is missing or contradictory.
    """
    found = [(group, signals) for group in groups if (signals := _signals(group, path))]
    if not found:
        raise _nothing_found(groups, path)
    _check_one([group.name for group, _ in found], path)
    group, signals = found[0]
    leads = [signal for signal in signals if lead_name(signal.name) is not None]
    for name, reason in group.unusable.items():
        if lead_name(name) is not None:
            raise InputError(f"{path}: lead '{name}' {reason}")
    said = [entry for signal in leads for entry in signal.array.metadata] + group.metadata
    check_physical(said, path)
    rate = options.agreed_rate(path, declared_rate(said, path))
    for signal in leads:
        check_extent(signal.length, rate, str(path))
    channels = []
    for signal in leads:
        with refuse_damaged(path, kind):
            values = signal.values
        about = [*signal.array.metadata, *group.metadata]
        unit = declared_unit(about, path, signal.name, signal.place)
        channels.append(Channel(signal.name, values, unit))
    others = [signal.name for signal in signals if lead_name(signal.name) is None]
    channels += [Channel(name, np.empty(0), None) for name in others]
    return RawRecording(channels, rate, kind)


def _signals(group: Group, path: Path) -> Sequence[_Signal]:
    """Find the signals of a group: vectors named after leads, or one matrix with names."""
    vectors = [
        _Signal(name, array) for name, array in group.arrays.items() if len(array.shape) == 1
    ]
    found = {
        f"'{name}'": rows
        for name, array in group.arrays.items()
        if len(array.shape) == 2 and (rows := _rows(group, name, path))
    }
    if _are_leads([vector.name for vector in vectors]):
        found = {"arrays named after leads": vectors} | found
    _check_one(list(found), path)
    return next(iter(found.values()), [])


def _check_one(places: Sequence[str], path: Path) -> None:
    if len(places) > 1:
        raise InputError(
            f"{path}: leads in {' and '.join(places[:3])}; keep one recording in the file"
        )


def _rows(group: Group, name: str, path: Path) -> list[_Signal]:
    """Return the rows of a matrix by the lead names that go with it; none where none fit."""
    array = group.arrays[name]
    fitting = {
        names
        for names in name_lists([*array.metadata, *group.metadata])
        if len(names) in array.shape and _are_leads(names)
    }
    if not fitting:
        return []
    if len(fitting) > 1 or array.shape[0] == array.shape[1]:
        raise InputError(
            f"{path}: lead names of '{name}' ({array.size}) are ambiguous; keep one list of names, "
            "as long as one side of the matrix only"
        )
    names = fitting.pop()
    axis = array.shape.index(len(names))
    return [_Signal(lead, array, axis, row) for row, lead in enumerate(names)]


def _are_leads(names: Sequence[str]) -> bool:
    return sum(lead_name(name) is not None for name in names) >= _FEWEST


def _nothing_found(groups: Sequence[Group], path: Path) -> InputError:
    """Say what is there instead of leads, and what to add."""
    arrays = {name: array for group in groups for name, array in group.arrays.items()}
    unusable = {name: reason for group in groups for name, reason in group.unusable.items()}
    matrix = next((name for name, array in arrays.items() if len(array.shape) == 2), None)
    lists = [name for name in unusable if key_of(name) is Key.NAMES]
    if lists or (unusable and matrix is None):
        name = lists[0] if lists else next(iter(unusable))
        return InputError(f"{path}: no leads, and '{name}' {unusable[name]}")
    if matrix is not None:
        # the record of a PhysioNet challenge
        header = " or give the WFDB header (.hea) of the record" * (matrix == "val")
        return InputError(
            f"{path}: '{matrix}' ({arrays[matrix].size}) has no lead names; add a list 'leads' of "
            f"the {min(arrays[matrix].shape)} names in its order{header}"
        )
    there = [f"'{name}' ({array.size})" for name, array in arrays.items()]
    return InputError(
        f"{path}: no leads (found: {', '.join(there[:4]) or 'no numeric arrays'}); name the arrays "
        "I, II, V1 to V6, or add a list 'leads' to one matrix"
    )
