"""Metadata beside signals: names of leads, sampling rate, unit, gain, under one set of keys.

Files without a standard (HDF5, MATLAB, tables) state these under names of the user's own. The names
that are understood are listed here and in ``docs/recordings.md``; case, blanks and other signs in
them do not count.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.core.ranges import RANGES
from fascicle.recording.readers.names import same_unit

MOST_WORDS = 1000  # entries of a text or a small array beside the signals


class Key(Enum):
    """What a piece of metadata says; the values are the names it may have."""

    RATE = (
        "fs", "sfreq", "srate", "samplingrate", "samplingfrequency", "samplingfreq", "samplerate",
        "samplefrequency", "samplefreq", "frequency", "freq",
    )  # fmt: skip
    UNIT = ("unit", "units", "physicalunit", "physicalunits", "signalunits", "sigunits")
    NAMES = (
        "lead", "leads", "leadname", "leadnames", "channel", "channels", "channelname",
        "channelnames", "chname", "chnames", "signame", "signames", "signalname", "signalnames",
        "label", "labels", "name", "names", "columns",
    )  # fmt: skip
    # What turns stored digits into physical values: conventions differ, so none is applied
    GAIN = ("gain", "gains", "adcgain", "adcgains", "scale", "scaling", "scalefactor", "lsb")
    OFFSET = ("addoffset", "offset", "baseline", "adczero")
    MISSING = ("fillvalue", "missingvalue")


_KEYS = {name: key for key in Key for name in key.value}
_RATE_TEXT = re.compile(r"(\d{1,9}(?:\.\d{0,9})?)\s*(?:Hz|sps)?", re.IGNORECASE)


def key_of(name: str) -> Key | None:
    """Return what metadata of this name says, or None where it is none."""
    plain = re.sub("[^a-z0-9]", "", name.lower())
    key = _KEYS.get(plain)
    return Key.RATE if key is None and _KEYS.get(plain.removesuffix("hz")) is Key.RATE else key


@dataclass(frozen=True)
class Entry:
    """One piece of metadata: either texts or a number.

    Attributes
    ----------
    key : Key
        What it says.
    name : str
        As it is spelt in the file.
    words : tuple of str
        Texts; empty for a number.
    number : float
        NaN for texts and for several different numbers.
    """

    key: Key
    name: str
    words: tuple[str, ...] = ()
    number: float = math.nan

    @property
    def shown(self) -> str:
        """What it says, for messages."""
        return f"'{', '.join(self.words[:3])}'" if self.words else f"{self.number:g}"


def entry_of(name: str, content: Any) -> Entry | None:
    """Make an entry of texts or numbers; None where they are neither, or the name is no key."""
    key, values = key_of(name), np.ravel(np.asarray(content))
    if key is None or not 0 < values.size <= MOST_WORDS:
        return None
    if values.dtype.kind in "iuf":
        different = np.unique(values.astype(np.float64))
        number = float(different[0]) if different.size == 1 else math.nan
        return Entry(key, printable(name), number=number)
    if values.dtype.kind not in "USO":
        return None
    words = (w.decode("utf-8", "replace") if isinstance(w, bytes) else str(w) for w in values)
    return Entry(key, printable(name), tuple(printable(w.rstrip("\0").strip()) for w in words))


def name_lists(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return the texts that may list the names of signals; a single text is split."""
    lists = []
    for entry in entries:
        if entry.key is Key.NAMES and entry.words:
            separator = r"[,;|]" if re.search(r"[,;|]", entry.words[0]) else r"\s+"
            one = len(entry.words) == 1
            words = re.split(separator, entry.words[0]) if one else entry.words
            lists.append(tuple(word.strip() for word in words))
    return lists


def missing_values(entries: Sequence[Entry]) -> list[float]:
    """Return the numbers that stand for missing samples."""
    return [entry.number for entry in entries if entry.key is Key.MISSING]


def check_physical(entries: Sequence[Entry], path: Path) -> None:
    """Refuse digits that a factor or an offset would have to turn into volts."""
    neutral = {Key.GAIN: 1.0, Key.OFFSET: 0.0}
    for entry in entries:
        if entry.key in neutral and not entry.words and entry.number != neutral[entry.key]:
            found = "of several values" if math.isnan(entry.number) else f"of {entry.number:g}"
            raise InputError(
                f"{path}: '{entry.name}' {found} says that the leads are not in physical units; "
                "apply it, state the unit and leave it out"
            )


def declared_rate(entries: Sequence[Entry], path: Path) -> float | None:
    """Return the sampling rate (Hz) that the metadata declare, None where they do not."""
    declared: dict[float, Entry] = {}
    for entry in entries:
        if entry.key is not Key.RATE:
            continue
        number = entry.number
        if entry.words:
            match = _RATE_TEXT.fullmatch(entry.words[0]) if len(entry.words) == 1 else None
            number = float(match[1]) if match is not None else math.nan
        if not number >= RANGES["sampling rate"].low:
            raise InputError(
                f"{path}: sampling rate '{entry.name}' is {entry.shown}; state one rate in Hz, of "
                f"at least {RANGES['sampling rate'].low:g}"
            )
        declared[number] = entry
    if len(declared) > 1:
        found = ", ".join(f"'{entry.name}' is {entry.shown}" for entry in declared.values())
        raise InputError(f"{path}: sampling rates contradict each other ({found}); keep one")
    return next(iter(declared), None)


def declared_unit(
    entries: Sequence[Entry], path: Path, signal: str, place: tuple[int, int] = (0, 1)
) -> str | None:
    """Return the unit that the metadata declare for a signal, None where they do not.

    Parameters
    ----------
    entries : sequence of Entry
        What is said about the signal.
    path : path
        What messages begin with.
    signal : str
        Its name.
    place : (int, int)
        Its index among the signals that the entries are about, and their number.

    Raises
    ------
    InputError
        When units contradict each other, or there is not one for each signal.
    """
    index, count = place
    units: list[str] = []
    for entry in entries:
        if entry.key is Key.UNIT and entry.words:
            if len(entry.words) not in (1, count):
                raise InputError(
                    f"{path}: '{entry.name}' lists {len(entry.words)} units for {count} signals; "
                    "state one, or one for each"
                )
            units.append(entry.words[index if len(entry.words) > 1 else 0])
    units = [unit for unit in units if unit]
    for unit in units[1:]:
        if not same_unit(units[0], unit):
            raise InputError(
                f"{path}: units of lead '{signal}' contradict each other ('{units[0]}' and "
                f"'{unit}'); keep one"
            )
    return units[0] if units else None
