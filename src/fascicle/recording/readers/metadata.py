"""What files without a standard say beside their signals: names, rate, unit, gain."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.readers.declared import same_unit
from fascicle.recording.recording import LOWEST_RATE

MOST_WORDS = 1000  # entries of a text or a small array beside the signals
# Names of what goes with the signals, in small letters without anything else
_RATES = frozenset({
    "fs", "sfreq", "srate", "samplingrate", "samplingfrequency", "samplingfreq", "samplerate",
    "samplefrequency", "samplefreq", "frequency", "freq",
})  # fmt: skip
_UNITS = frozenset({"unit", "units", "physicalunit", "physicalunits", "signalunits", "sigunits"})
_NAMES = frozenset({
    "lead", "leads", "leadname", "leadnames", "channel", "channels", "channelname", "channelnames",
    "chname", "chnames", "signame", "signames", "signalname", "signalnames", "label", "labels",
    "name", "names", "columns",
})  # fmt: skip
# What turns stored digits into physical values: conventions differ, so none is applied
_FACTORS = frozenset(
    {"gain", "gains", "adcgain", "adcgains", "scale", "scaling", "scalefactor", "lsb"}
)
_OFFSETS = frozenset({"addoffset", "offset", "baseline", "adczero"})
_FILLS = frozenset({"fillvalue", "missingvalue"})
_RATE_TEXT = re.compile(r"(\d+(?:\.\d*)?)\s*(?:(k?)(?:Hz|sps))?", re.IGNORECASE)


@dataclass(frozen=True)
class Remarks:
    """Texts and numbers that go with signals, by the names they have in the file.

    A number that is several different ones is NaN.
    """

    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)


def is_remark(name: str) -> bool:
    """Tell whether a small array, text or attribute of this name says something about signals."""
    key = _key(name)
    return _hertz(name) is not None or key in _UNITS | _NAMES | _FACTORS | _OFFSETS | _FILLS


def one_number(values: Any) -> float:
    """Return the number that a small array is, as `Remarks` keep it; NaN for several."""
    different = np.unique(np.asarray(values, dtype=np.float64))
    return float(different[0]) if different.size == 1 else math.nan


def name_lists(said: Sequence[Remarks]) -> list[tuple[str, ...]]:
    """Return the texts that may list the names of signals."""
    return [
        _split(words)
        for remarks in said
        for name, words in remarks.texts.items()
        if _key(name) in _NAMES
    ]


def fill_values(remarks: Remarks) -> list[float]:
    """Return the values that stand for missing samples."""
    return [value for name, value in remarks.numbers.items() if _key(name) in _FILLS]


def check_physical(said: Sequence[Remarks], path: Path) -> None:
    """Refuse digits that a factor or an offset would have to turn into volts."""
    for remarks in said:
        for name, value in remarks.numbers.items():
            neutral = 0.0 if _key(name) in _OFFSETS else 1.0
            if _key(name) in _OFFSETS | _FACTORS and value != neutral:
                found = "of several values" if math.isnan(value) else f"of {value:g}"
                raise InputError(
                    f"{path}: '{name}' {found} says that the leads are not in physical units; "
                    "apply it, state the unit and leave it out"
                )


def stated_rate(said: Sequence[Remarks], path: Path) -> float | None:
    """Return the stated sampling rate (Hz), None where there is none."""
    stated = {}
    for remarks in said:
        for name, value in remarks.numbers.items():
            if (hertz := _hertz(name)) is not None:
                stated[value * hertz] = f"'{name}' is {value:g}"
        for name, words in remarks.texts.items():
            if (hertz := _hertz(name)) is not None:
                stated[_parsed_rate(name, words, hertz, path)] = f"'{name}' is '{words[0]}'"
    if len(stated) > 1:
        raise InputError(
            f"{path}: sampling rates contradict each other ({', '.join(list(stated.values())[:3])}"
            "); keep one"
        )
    for value, text in stated.items():
        if not value >= LOWEST_RATE:
            raise InputError(
                f"{path}: sampling rate {text}; state one rate in Hz, of at least {LOWEST_RATE:g}"
            )
        return value
    return None


def stated_unit(
    said: Sequence[Remarks], signal: str, index: int, count: int, path: Path
) -> str | None:
    """Return the stated unit of one of `count` signals, None where there is none."""
    stated = []
    for remarks in said:
        for name, words in remarks.texts.items():
            if _key(name) in _UNITS:
                if len(words) not in (1, count):
                    raise InputError(
                        f"{path}: '{name}' lists {len(words)} units for {count} signals; state "
                        "one, or one for each"
                    )
                stated.append(words[index] if len(words) > 1 else words[0])
    units = [unit.strip() for unit in stated if unit.strip()]
    for unit in units[1:]:
        if not same_unit(units[0], unit):
            raise InputError(
                f"{path}: units of lead '{signal}' contradict each other ('{units[0]}' and "
                f"'{unit}'); keep one"
            )
    return units[0] if units else None


def _key(name: str) -> str:
    return re.sub("[^a-z0-9]", "", name.lower())


def _hertz(name: str) -> float | None:
    """Return the Hz in one unit of the sampling rate of this name, or None for other names."""
    key = _key(name)
    if key.removesuffix("khz") in _RATES:
        return 1.0 if key in _RATES else 1000.0
    return 1.0 if key.removesuffix("hz") in _RATES else None


def _split(words: tuple[str, ...]) -> tuple[str, ...]:
    """Split a single text into the names it lists."""
    if len(words) != 1:
        return words
    separator = r"[,;|]" if re.search(r"[,;|]", words[0]) else r"\s+"
    return tuple(word.strip() for word in re.split(separator, words[0].strip()))


def _parsed_rate(name: str, words: tuple[str, ...], hertz: float, path: Path) -> float:
    """Return the rate (Hz) in a text such as ``500``, ``500 Hz`` or ``0.5 kHz``."""
    match = _RATE_TEXT.fullmatch(words[0].strip()) if len(words) == 1 else None
    if match is None:
        raise InputError(
            f"{path}: sampling rate '{name}' is '{', '.join(words[:3])}'; state a number of Hz"
        )
    return float(match[1]) * {"k": 1000.0, "": 1.0, None: hertz}[match[2] and match[2].lower()]
