"""Names of leads, units and pieces of metadata as they are spelt in files.

Files that follow no standard (HDF5, MATLAB, tables) hold rate, unit and lead names under names that
their authors chose; those of `Key` and ``docs/recordings.md`` are understood.
"""

from __future__ import annotations

import contextlib
import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.core.leads import ADDITIONAL_LEADS, LEADS

# Prefixes are those of ISO/IEEE 11073 and EDF+, and inventors of leads. A hyphen separates words
# only without blanks or between two: in "ECG -aVR" it is the minus of an inverted lead.
_LEAD = re.compile(
    r"""
    (?:
        (?:mdc|ecg[12]?|ekg|einthoven|goldberger|wilson|lead)(?:[ _:.]+(?!-)|-(?![ -])|[ ]-[ ])
        |lead
    )*
    (?:
        (?:l[ _]?|d[ _-]?)?(?P<roman>i{1,3})
        |(?:lead[ _-]?|l[ _]?|d[ _-]?)(?P<arabic>[123])
        |a[ _-]?v[ _-]?(?P<augmented>[rlf])
        |[vc][ _-]?0?(?P<chest>[1-6])
    )
    (?:[ _-]?lead)?
    (?:
        [ ]?[(\[]
        (?:einthoven|goldberger|wilson|unipolar|bipolar|limb|chest|precordial|augmented|standard)
        [)\]]
    )?
    """,
    re.VERBOSE,
)

PER_SECOND = (  # units of time per second
    dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0)
    | dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e3)
    | dict.fromkeys(("us", "microsecond", "microseconds"), 1e6)
)


def lead_name(text: str) -> str | None:
    """Return the lead of the standard twelve (`fascicle.core.leads.LEADS`) that a text names.

    Understands ``aVR``, ``AVR``, ``Lead I``, ``DII``, ``L1``, ``V01``, ``C1``,
    ``MDC_ECG_LEAD_V1``, ``ECG-I``, ``Lead I (Einthoven)`` and the like, without a unit. None for
    other texts, such as an inverted ``-aVR``, the unaugmented ``VR``, ``MLII``, ``V7``, ``V4R``,
    Frank's X, Y and Z, and ``II rhythm``, which repeats a lead.
    """
    if len(text) > 64:  # characters, as in DICOM; bounds the time of matching
        return None
    # compatible letters without accents; a dotless i is a lower-case I of Turkish software
    letters = unicodedata.normalize("NFKD", text).casefold().replace("ı", "i")
    name = " ".join("".join(c for c in letters if not unicodedata.combining(c)).split())
    match = _LEAD.fullmatch(name)
    if match is None:
        return None
    if match["roman"] or match["arabic"]:
        return LEADS[int(match["arabic"] or len(match["roman"])) - 1]
    return f"V{match['chest']}" if match["chest"] else f"aV{match['augmented'].upper()}"


def additional_lead_name(text: str) -> str | None:
    """Return the lead of `fascicle.core.leads.ADDITIONAL_LEADS` that a text names, None if none.

    Understands ``V7``, ``v3r``, ``MDC_ECG_LEAD_V8``, ``Lead X``, Frank's ``vx``, ``Frank Y`` and a
    bare ``Z``.
    """
    name = re.sub(r"^(mdc[ _])?(ecg[ _])?(lead[ _])?(frank[ _]?)?", "", text.strip().casefold())
    name = re.sub(r"^v([xyz])$", r"\1", name).upper()
    return name if name in ADDITIONAL_LEADS else None


def lead_of_code(code: str) -> str | None:
    """Return the lead of an MDC (``2:1``, ISO/IEEE 11073) or SCP-ECG (``5.6.3-9-1``) code."""
    match = re.fullmatch(r"(?:2:|5\.6\.3-9-)(\d+)", code)
    codes = (1, 2, 61, 62, 63, 64, 3, 4, 5, 6, 7, 8, 9, 66, 67, 10, 11, 12, 13, 14, 16, 17, 18)
    coded_leads = zip(codes, (*LEADS, *ADDITIONAL_LEADS), strict=True)
    return dict(coded_leads).get(int(match[1])) if match else None


def millivolts(unit: str) -> float | None:
    """Return the size (mV) of a unit of voltage, None if it is unknown.

    Understands nV, uV (with u or either code point of the Greek letter), mV, V and the words
    (``microvolts``, ``uVolt``), in any case: ``MV`` is mV, as no ECG is in megavolts.
    """
    sizes = {"n": 1e-6, "nano": 1e-6, "u": 1e-3, "micro": 1e-3, "m": 1.0, "milli": 1.0, "": 1e3}
    match = re.fullmatch(r"\[?([a-z]*)v(?:olts?)?\]?", plain_unit(unit))
    return sizes.get(match[1]) if match else None


def same_unit(unit: str, other: str) -> bool:
    """Tell whether two spellings mean the same unit."""
    return unit == other or millivolts(unit) == millivolts(other) is not None


def plain_unit(unit: str) -> str:
    """Return a unit in lower case, with u for either code point of the Greek letter."""
    return unit.strip().lower().replace("µ", "u").replace("μ", "u")


class Key(Enum):
    """Kind of metadata; the value lists names that files have for it, separated by blanks."""

    RATE = (
        "fs sfreq srate samplingrate samplingfrequency samplingfreq samplerate samplefrequency "
        "samplefreq frequency freq"
    )
    UNIT = "unit units physicalunit physicalunits signalunits sigunits"
    NAMES = (
        "lead leads leadname leadnames channel channels channelname channelnames chname chnames "
        "signame signames signalname signalnames label labels name names columns"
    )
    # Factors and offsets of stored digits: conventions differ, so none is applied
    GAIN = "gain gains adcgain adcgains scale scaling scalefactor lsb"
    OFFSET = "addoffset offset baseline adczero"
    MISSING = "fillvalue missingvalue"


@dataclass(frozen=True)
class Entry:
    """A piece of metadata: its kind, its name in the file, and its value.

    The value is a tuple of texts, or a number, which is NaN if the file holds different ones.
    """

    key: Key
    name: str
    value: tuple[str, ...] | float

    @property
    def numbers(self) -> list[float]:
        """Number of the entry, or the numbers among its texts."""
        numbers = []
        for value in (self.value,) if isinstance(self.value, float) else self.value:
            with contextlib.suppress(ValueError):
                numbers.append(float(value))
        return numbers

    @property
    def text(self) -> str:
        """Value of the entry, in a line."""
        return repr(self.value) if isinstance(self.value, float) else ", ".join(self.value[:3])


def key_of(name: str) -> Key | None:
    """Return the kind of metadata that a name in a file stands for, None if unknown."""
    plain = re.sub("[^a-z0-9]", "", name.lower()).removesuffix("hz")
    return next((key for key in Key if plain in key.value.split()), None)


def entry_of(name: str, content: Any) -> Entry | None:
    """Entry of texts or numbers; None if the content is neither, or its name is unknown."""
    key, values = key_of(name), np.ravel(np.asarray(content))
    if key is None or not 0 < values.size <= 1000:
        return None
    if values.dtype.kind in "iuf":
        different = np.unique(values.astype(np.float64))
        return Entry(key, printable(name), float(different[0]) if different.size == 1 else math.nan)
    words = [w.decode("utf-8", "replace") if isinstance(w, bytes) else w for w in values.tolist()]
    if not all(isinstance(word, str) for word in words):
        return None
    return Entry(key, printable(name), tuple(printable(w.rstrip("\0").strip()) for w in words))


def name_lists(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return the lists that may be names of the signals; a single text is split into names."""
    lists = []
    for entry in entries:
        if entry.key is Key.NAMES and isinstance(entry.value, tuple):
            text = entry.value[0] if len(entry.value) == 1 else ""
            names = re.split(r"\s*[,;|]\s*" if re.search("[,;|]", text) else r"\s+", text)
            lists.append(tuple(names) if text else entry.value)
    return lists


def fill_values(entries: Sequence[Entry]) -> tuple[float, ...]:
    """Return the numbers that mark missing samples."""
    return tuple(x for entry in entries if entry.key is Key.MISSING for x in entry.numbers)


def check_physical(entries: Sequence[Entry], path: Path) -> None:
    """Refuse raw integer samples, to which a gain or an offset would have to be applied."""
    neutral = {Key.GAIN: 1.0, Key.OFFSET: 0.0}
    for entry in entries:
        if entry.key in neutral and any(x != neutral[entry.key] for x in entry.numbers):
            raise InputError(
                f"{path}: '{entry.name}' of {entry.text} says that the leads are not in physical "
                "units; apply it, state the unit and leave it out"
            )


def declared_rate(entries: Sequence[Entry], path: Path) -> float | None:
    """Return the sampling rate (Hz) that the metadata declare, None where they do not."""
    stated = [entry for entry in entries if entry.key is Key.RATE]
    spelt = r"(\d{1,9}\.?\d{0,20})\s*(?:Hz|sps)?"
    matches = [re.fullmatch(spelt, entry.text, re.IGNORECASE) for entry in stated]
    rates = {float(match[1]) for match in matches if match is not None}
    if None in matches or len(rates) > 1:
        listing = ", ".join(f"'{entry.name}' is {entry.text}" for entry in stated)
        raise InputError(f"{path}: unclear sampling rate ({listing}); state one, in Hz")
    return next(iter(rates), None)


def declared_unit(
    entries: Sequence[Entry], path: Path, signal: str, place: tuple[int, int] = (0, 1)
) -> str | None:
    """Return the unit that the metadata declare for a signal, None where they do not.

    `place` is the index of the signal among those that the entries describe, and their number.
    """
    index, count = place
    stated = [
        (e.name, e.value) for e in entries if e.key is Key.UNIT and isinstance(e.value, tuple)
    ]
    lists = [units * count if len(units) == 1 else units for _, units in stated]
    units = [units[index] for units in lists if len(units) == count and units[index]]
    one_each = all(len(units) == count for units in lists)
    if not one_each or not all(same_unit(units[0], unit) for unit in units):
        listing = ", ".join(f"'{name}' is {', '.join(units[:3])}" for name, units in stated)
        raise InputError(
            f"{path}: unclear unit of lead '{signal}' ({listing}); state one, or one for each of "
            f"the {count} signals"
        )
    return units[0] if units else None
