"""Recordings kept as named arrays: one array a lead, or a matrix and the names of its rows.

HDF5 and MATLAB files have no standard for ECGs. Nothing in them is guessed: leads, rate and unit
must be stated under one of the names below, once, or by the user.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.recording.readers.declared import agreed_rate
from fascicle.recording.readers.metadata import (
    Remarks,
    check_physical,
    fill_values,
    name_lists,
    stated_rate,
    stated_unit,
)
from fascicle.recording.readers.names import lead_name
from fascicle.recording.readers.raw_recording import Channel, Contents
from fascicle.recording.readers.read_options import Given
from fascicle.recording.recording import check_extent

_FEWEST = 2  # names that must be leads, so that a stray variable `i` makes no recording


@dataclass(frozen=True)
class Array:
    """A numeric array that is read when it is asked for.

    Attributes
    ----------
    shape : tuple of int
        Without axes of length one.
    read : callable
        Returns the values in that shape.
    remarks : Remarks
        What the file says about this array alone.
    """

    shape: tuple[int, ...]
    read: Callable[[], NDArray[np.float64]]
    remarks: Remarks = field(default_factory=Remarks)

    @property
    def ndim(self) -> int:
        """Number of axes longer than one sample."""
        return len(self.shape)


@dataclass(frozen=True)
class Level:
    """A file, or a group or structure in it.

    Attributes
    ----------
    name : str
        What messages call it.
    arrays : mapping
        Numeric arrays by name.
    remarks : Remarks
        What is said at this level.
    unusable : mapping
        Name to what stands there instead of numbers.
    above : Level, optional
        The level that this one is in; what is said there holds here.
    """

    name: str
    arrays: Mapping[str, Array]
    remarks: Remarks
    unusable: Mapping[str, str] = field(default_factory=dict)
    above: Level | None = None

    @property
    def said(self) -> list[Remarks]:
        """Remarks of this level and those above it."""
        return [self.remarks, *(self.above.said if self.above is not None else [])]


@dataclass(frozen=True)
class _Signal:
    """One vector, or row `index` along `axis` of a matrix with `count` rows."""

    name: str
    array: Array
    axis: int = 0
    index: int | None = None
    count: int = 1

    @property
    def length(self) -> int:
        return self.array.shape[0 if self.index is None else 1 - self.axis]


def contents_of(levels: Sequence[Level], path: Path, given: Given, kind: str) -> Contents:
    """Make the contents of a recording of the one level that holds leads.

    Parameters
    ----------
    levels : sequence of Level
        All levels of a file.
    path : path
        What messages begin with.
    given : Given
        What the user says; it must agree with the file.
    kind : str
        Name of the format.

    Raises
    ------
    InputError
        When no level or several hold leads, or what goes with them is missing or contradictory.
    """
    found = [(level, signals) for level in levels if (signals := _signals(level, path))]
    if not found:
        raise _nothing_found(levels, path)
    if len(found) > 1:
        raise InputError(
            f"{path}: leads in {' and '.join(level.name for level, _ in found[:3])}; keep one "
            "recording in the file"
        )
    level, signals = found[0]
    leads = [signal for signal in signals if lead_name(signal.name) is not None]
    _check_usable(level, path)
    said = _said(level, leads)
    check_physical(said, path)
    rate = agreed_rate(path, stated_rate(said, path), given)
    _check_sizes(leads, rate, path)
    units = [_unit(level, signal, path) for signal in leads]
    channels = [
        Channel(signal.name, values, unit)
        for signal, values, unit in zip(leads, _values(leads), units, strict=True)
    ]
    extra = [signal.name for signal in signals if lead_name(signal.name) is None]
    channels += [Channel(name, np.empty(0), None) for name in extra]
    return Contents(channels, rate, kind)


def _signals(level: Level, path: Path) -> list[_Signal]:
    """Find the signals of a level: vectors named after leads, or one matrix with names."""
    vectors = [_Signal(name, array) for name, array in level.arrays.items() if array.ndim == 1]
    matrices = {
        name: rows
        for name, array in level.arrays.items()
        if array.ndim == 2 and (rows := _rows(level, name, path))
    }
    found = [f"'{name}'" for name in matrices]
    if _are_leads([vector.name for vector in vectors]):
        found.insert(0, "arrays named after leads")
    if len(found) > 1:
        raise InputError(f"{path}: leads in {' and '.join(found[:3])}; keep one of them")
    if not found:
        return []
    return next(iter(matrices.values()), vectors)


def _rows(level: Level, name: str, path: Path) -> list[_Signal]:
    """Return the rows of a matrix by the lead names that go with it; none where none fit."""
    array = level.arrays[name]
    fitting = {
        names
        for names in name_lists([array.remarks, *level.said])
        if len(names) in array.shape and _are_leads(names)
    }
    if not fitting:
        return []
    if len(fitting) > 1 or array.shape[0] == array.shape[1]:
        raise InputError(
            f"{path}: lead names of '{name}' ({_by(array.shape)}) are ambiguous; keep one list of "
            "names, as long as one side of the matrix only"
        )
    names = fitting.pop()
    axis = array.shape.index(len(names))
    return [_Signal(lead, array, axis, row, len(names)) for row, lead in enumerate(names)]


def _are_leads(names: Sequence[str]) -> bool:
    return sum(lead_name(name) is not None for name in names) >= _FEWEST


def _by(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))


def _nothing_found(levels: Sequence[Level], path: Path) -> InputError:
    """Say what is there instead of leads, and what to add."""
    for level in levels:
        for name, array in level.arrays.items():
            if array.ndim == 2:
                header = " or give the WFDB header (.hea) of the record" * (name == "val")
                return InputError(
                    f"{path}: '{name}' ({_by(array.shape)}) has no lead names; add a list 'leads' "
                    f"of the {min(array.shape)} names in its order{header}"
                )
    for level in levels:
        for name, reason in level.unusable.items():
            return InputError(f"{path}: no leads, and '{name}' {reason}")
    there = [f"'{name}' ({_by(a.shape)})" for level in levels for name, a in level.arrays.items()]
    return InputError(
        f"{path}: no leads (found: {', '.join(there[:4]) or 'no numeric arrays'}); name the arrays "
        "I, II, V1 to V6, or add a list 'leads' to one matrix"
    )


def _check_usable(level: Level, path: Path) -> None:
    for name, reason in level.unusable.items():
        if lead_name(name) is not None:
            raise InputError(f"{path}: lead '{name}' {reason}")


def _check_sizes(leads: Sequence[_Signal], rate: float, path: Path) -> None:
    """Refuse leads that are too short, too long or too many, before they are read."""
    for signal in leads:
        check_extent(signal.length, rate, str(path))


def _unit(level: Level, signal: _Signal, path: Path) -> str | None:
    said = _said(level, [signal])
    return stated_unit(said, signal.name, signal.index or 0, signal.count, path)


def _said(level: Level, leads: Sequence[_Signal]) -> list[Remarks]:
    """All that is said about the leads of a level."""
    return [*({id(s.array): s.array.remarks for s in leads}.values()), *level.said]


def _values(leads: Sequence[_Signal]) -> list[NDArray[np.float64]]:
    """Read the leads, each array once; fill values become NaN."""
    read: dict[int, NDArray[np.float64]] = {}
    for signal in leads:
        if id(signal.array) not in read:
            values = signal.array.read()
            values[np.isin(values, fill_values(signal.array.remarks))] = np.nan
            read[id(signal.array)] = values
    return [
        read[id(signal.array)]
        if signal.index is None
        else np.asarray(read[id(signal.array)].take(signal.index, axis=signal.axis))
        for signal in leads
    ]
