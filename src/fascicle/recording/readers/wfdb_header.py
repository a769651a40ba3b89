"""Headers of WFDB records, checked before a sample is read.

wfdb-python takes from a header what it understands and fills in the rest: a rate of -500 becomes
250 Hz, a gain of 0 becomes 200 per mV, a unit of µV becomes V. Here such headers are refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from fascicle.core.errors import InputError, printable

# Bytes that a sample takes in each signal format (signal(5) of the WFDB applications guide)
BYTES_PER_SAMPLE = {
    "8": Fraction(1), "16": Fraction(2), "24": Fraction(3), "32": Fraction(4), "61": Fraction(2),
    "80": Fraction(1), "160": Fraction(2), "212": Fraction(3, 2), "310": Fraction(4, 3),
    "311": Fraction(4, 3),
}  # fmt: skip
FLAC_FORMATS = ("508", "516", "524")

_LARGEST_HEADER = 2**20  # bytes
_LONGEST_LINE = 1000  # characters
_MOST_SEGMENTS = 1000
# Names of files, with .hea, must be shorter than the 255 characters of file systems
_RECORD_NAME = re.compile(r"[-\w]{1,200}(/(?P<segments>\d{1,9}))?", re.ASCII)
_RATE = re.compile(r"(?P<rate>\d+\.?\d*|\.\d+)(/-?[\d.]+)?(\(-?[\d.]+\))?")
_FILE_NAME = re.compile(r"~|[-\w]{0,200}\.?\w{1,40}", re.ASCII)
_FORMAT = re.compile(r"(?P<format>\d+)(x(?P<per_frame>\d+))?(:(?P<skew>\d+))?(\+(?P<offset>\d+))?")
_GAIN = re.compile(
    r"(?P<gain>-?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,2})?)(\(-?\d+\))?(/(?P<unit>[\w^\-?%/]+))?", re.ASCII
)
_SEGMENT = re.compile(r"(?P<name>[-\w]{1,200}|~)\s+(?P<frames>\d+)", re.ASCII)
_MICROVOLT = re.compile("/[\u00b5\u03bc]V")  # micro sign or Greek mu
_TOO_MANY_DIGITS = re.compile(r"(?<![.\d])\d{13}")


@dataclass(frozen=True)
class SignalLine:
    """What a header says about how one signal is stored, and its unit."""

    file: str
    format: str
    per_frame: int
    skew: int
    offset: int
    unit: str


@dataclass(frozen=True)
class Header:
    """A header; `rate` (frames/s) and `frames` are None where it does not say them.

    A record holds either signals or, by name and length in frames, segments.
    """

    rate: float | None
    frames: int | None
    signals: tuple[SignalLine, ...]
    segments: tuple[tuple[str, int], ...] = ()

    @property
    def files(self) -> list[str]:
        """Names of the signal files, each once."""
        return list(dict.fromkeys(signal.file for signal in self.signals))


def read_header(path: Path, source: str) -> Header:
    """Read and check a header.

    Parameters
    ----------
    path : path
        The ``.hea`` file.
    source : str
        What messages begin with.

    Returns
    -------
    Header

    Raises
    ------
    InputError
        When a field that bears on the samples is not as header(5) of the WFDB applications guide
        has it, or a signal is not calibrated.
    """
    lines = _lines(path, source)
    first = lines[0].split()
    name = _RECORD_NAME.fullmatch(first[0])
    if name is None or len(first) < 2 or not first[1].isdecimal():
        raise InputError(
            f"{source}: not a readable WFDB header (first line {_quoted(lines[0])}); it must begin "
            "with the name of the record, in letters, digits, - and _, and the number of signals"
        )
    rate = _rate(first, source)
    frames = _frames(first, source)
    if name["segments"] is not None:
        segments = _segments(lines[1:], int(name["segments"]), source)
        return Header(rate, frames, (), segments)
    if int(first[1]) == 0 or frames == 0:
        raise InputError(
            f"{source}: header without data ({first[1]} signals of {frames or 0} samples); give a "
            "record that has signals"
        )
    _check_count(lines[1:], int(first[1]), "signals", source)
    signals = tuple(_signal(line, k, source) for k, line in enumerate(lines[1:], start=1))
    return Header(rate, frames, signals)


def _lines(path: Path, source: str) -> list[str]:
    """Return the lines that are no comments, in ASCII; wfdb drops what is not, as in µV."""
    if path.stat().st_size > _LARGEST_HEADER:
        raise InputError(
            f"{source}: {path.stat().st_size / 2**20:.0f} MB; a WFDB header is a text of a few "
            "lines, give that"
        )
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    text = _MICROVOLT.sub("/uV", text).encode("ascii", "replace").decode("ascii")
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if not lines:
        raise InputError(f"{source}: empty WFDB header; download or export the record again")
    for line in lines:
        if len(line) > _LONGEST_LINE or any(map(_TOO_MANY_DIGITS.search, line.split()[1:8])):
            raise InputError(
                f"{source}: not a readable WFDB header (line {_quoted(line)}); download or export "
                "the record again"
            )
    return lines


def _quoted(text: str) -> str:
    """Return the beginning of a text in quotes, fit for a message."""
    return f"'{printable(text[:40])}'"


def _rate(first: Sequence[str], source: str) -> float | None:
    if len(first) < 3:
        return None
    match = _RATE.fullmatch(first[2])
    if match is None or float(match["rate"]) == 0:
        raise InputError(
            f"{source}: sampling rate is {_quoted(first[2])}; write it in Hz as the third field of "
            "the first line, such as 500"
        )
    return float(match["rate"])


def _frames(first: Sequence[str], source: str) -> int | None:
    if len(first) < 4:
        return None
    if not first[3].isdecimal():
        raise InputError(
            f"{source}: number of samples is {_quoted(first[3])}; write it as the fourth field of "
            "the first line, such as 5000"
        )
    return int(first[3])


def _check_count(lines: Sequence[str], stated: int, what: str, source: str) -> None:
    if len(lines) != stated:
        raise InputError(
            f"{source}: its first line says {stated} {what}, but {len(lines)} lines follow; "
            "download or export the record again"
        )


def _segments(lines: Sequence[str], stated: int, source: str) -> tuple[tuple[str, int], ...]:
    _check_count(lines, stated, "segments", source)
    if not 0 < stated <= _MOST_SEGMENTS:
        raise InputError(
            f"{source}: record of {stated} segments; give one of its segments, 10 s are enough"
        )
    segments = []
    for number, line in enumerate(lines, start=1):
        match = _SEGMENT.fullmatch(line)
        if match is None:
            raise InputError(
                f"{source}: segment {number} is {_quoted(line)}; its line must hold the name of a "
                "record in the same folder and its length"
            )
        segments.append((match["name"], int(match["frames"])))
    return tuple(segments)


def _signal(line: str, number: int, source: str) -> SignalLine:
    """Read what matters of a signal line; its other fields and its name are wfdb's to read."""
    fields = line.split()
    if _FILE_NAME.fullmatch(fields[0]) is None:
        raise InputError(
            f"{source}: signal {number} is in {_quoted(fields[0])}; it must be a file in the "
            "folder of the header, named in letters, digits, - and _ with one dot at most"
        )
    stored = _FORMAT.fullmatch(fields[1]) if len(fields) > 1 else None
    if stored is None or stored["format"] not in (*BYTES_PER_SAMPLE, *FLAC_FORMATS):
        found = _quoted(fields[1]) if len(fields) > 1 else "missing"
        raise InputError(
            f"{source}: signal format of signal {number} is {found}; known are "
            f"{', '.join((*BYTES_PER_SAMPLE, *FLAC_FORMATS))}, export the record again"
        )
    per_frame = int(stored["per_frame"] or 1)
    if per_frame == 0:
        raise InputError(
            f"{source}: signal {number} has 0 samples in a frame; export the record again"
        )
    return SignalLine(
        file=fields[0],
        format=stored["format"],
        per_frame=per_frame,
        skew=int(stored["skew"] or 0),
        offset=int(stored["offset"] or 0),
        unit=_unit(fields, number, source),
    )


def _unit(fields: Sequence[str], number: int, source: str) -> str:
    """Return the unit of a signal; without a gain, or with 0, it is not calibrated."""
    match = _GAIN.fullmatch(fields[2]) if len(fields) > 2 else None
    if match is None or float(match["gain"]) == 0:
        found = _quoted(fields[2]) if len(fields) > 2 else "absent"
        raise InputError(
            f"{source}: unknown unit, the gain of signal {number} is {found}; write the digits per "
            "mV as the third field of its line, such as 1000/mV"
        )
    return match["unit"] or "mV"
