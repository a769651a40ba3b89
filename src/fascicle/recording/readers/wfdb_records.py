"""WFDB records (PhysioNet): a .hea header and its signal files.

wfdb-python takes from a header what it understands and fills in the rest: a rate of -500 becomes
250 Hz, a gain of 0 becomes 200 per mV, a unit of µV becomes V. So headers are checked here first.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.content import refuse_damaged, sha256_of
from fascicle.recording.readers.names import lead_name, millivolts
from fascicle.recording.readers.raw_recording import Channel, RawRecording, ReadOptions
from fascicle.recording.recording import CHECKSUMS_AGREE, check_extent

# Bytes that a sample takes in each signal format (signal(5) of the WFDB applications guide), at
# least; in FLAC formats (500 and above) only the library can tell
_BYTES = {
    "8": 1, "16": 2, "24": 3, "32": 4, "61": 2, "80": 1, "160": 2, "212": 3 / 2, "310": 4 / 3,
    "311": 4 / 3, "508": 0, "516": 0, "524": 0,
}  # fmt: skip
_LARGEST_HEADER = 2**20  # bytes
_MOST_SAMPLES = 2**27  # of all signals together; 1 GB as float64
# Fields of header(5); names of files are within the folder of the header
_FIRST = re.compile(
    r"[-\w]{1,200}(/(?P<segments>\d{1,3}))?\s+(?P<signals>\d{1,4})"
    r"(\s+(?P<rate>\d{1,9}\.?\d*|\.\d+)(/-?[\d.]+)?(\(-?[\d.]+\))?"
    r"(\s+(?P<frames>\d{1,12})(\s.*)?)?)?",
    re.ASCII,
)
_SIGNAL = re.compile(
    r"(?P<file>~|[-\w]{0,200}\.?\w{1,40})\s+(?P<format>\d+)(x(?P<per_frame>[1-9]\d{0,5}))?"
    r"(:(?P<skew>\d{1,9}))?(\+(?P<offset>\d{1,9}))?(\s+(?P<gain>\S+))?(\s.*)?",
    re.ASCII,
)
_GAIN = re.compile(
    r"(?P<gain>-?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,2})?)(\(-?\d+\))?(/(?P<unit>[\w^\-?%/]+))?", re.ASCII
)
_SEGMENT = re.compile(r"(?P<name>[-\w]{1,200}|~)\s+(?P<frames>\d{1,12})", re.ASCII)
_MICROVOLT = re.compile("/[\u00b5\u03bc]V")  # micro sign or Greek mu
_TOO_MANY_DIGITS = re.compile(r"(?<![.\d])\d{13}")  # wfdb takes numbers of any length


@dataclass(frozen=True)
class _Stored:
    """What a header says about how one signal is stored, and its unit."""

    file: str
    format: str
    per_frame: int
    skew: int
    offset: int
    unit: str


@dataclass(frozen=True)
class _Header:
    """A header; `rate` (frames/s) and `frames` are None where it does not say them.

    A record holds either signals or, by name and length in frames, segments. `source` is what
    messages begin with.
    """

    path: Path
    source: str
    rate: float | None
    frames: int | None
    signals: Sequence[_Stored] = ()
    segments: Sequence[tuple[str, int]] = ()

    @property
    def files(self) -> set[str]:
        return {signal.file for signal in self.signals}


@dataclass(frozen=True)
class _Signal:
    """One signal: values in `unit`, `per_frame` of them in each frame."""

    name: str
    unit: str
    values: Floats
    per_frame: int
    gain: float
    checksum_agrees: bool | None


def read_wfdb(path: Path, options: ReadOptions) -> RawRecording:
    """Read a record of one or several segments from its ``.hea`` header.

    Samples that a segment lacks, and those that are marked invalid, are NaN. Skewed signals are
    aligned, which shortens the record by the largest skew. Signals are at their own rate, so that
    a lead with four samples in a frame has four times the frame rate.

    The signal files and segments are in the folder of the header. A header without a rate means
    250 Hz by the standard, but the user must say so. Checksums that disagree are in the provenance:
    many converters write wrong ones.

    References
    ----------
    G. B. Moody, WFDB Applications Guide, header(5) and signal(5), physionet.org.
    """
    source = str(path)
    if "::" in str(path.absolute()) or path.suffix != ".hea":
        # fsspec, which wfdb opens files with, takes what is joined by :: for addresses
        raise InputError(f"{source}: rename it so that the name ends in .hea and has no '::'")
    header = _read_header(path, source)
    # by the standard a header without a rate means 250 Hz, but most such headers lost theirs
    rate = header.rate if header.rate is not None else options.agreed_rate(path, None)
    parts = _segments(header, rate) if header.segments else [header]
    lengths = [_checked_frames(part) for part in parts]
    per_frame = [[s.per_frame for s in part.signals] for part in parts]
    most = max(max(counts, default=0) for counts in per_frame)
    if most == 0:
        raise InputError(f"{source}: its segments have no signals; give a record that has some")
    check_extent(sum(lengths) * most, rate * most, source)
    if sum(lengths) * max(map(sum, per_frame)) > _MOST_SAMPLES:
        raise InputError(f"{source}: more than {_MOST_SAMPLES} samples; cut it, 10 s are enough")
    frames = sum(lengths) - max((stored.skew for stored in parts[-1].signals), default=0)
    signals = _joined([_read(part) for part in parts], lengths, frames, source)
    leads_per_frame = max((s.per_frame for s in signals if lead_name(s.name)), default=1)
    rate = options.agreed_rate(path, rate * leads_per_frame)
    names = {name for part in parts for name in part.files}
    names |= {part.path.name for part in parts if part.signals} if header.segments else set()
    provenance = _checksums(signals) | {
        "signal_files": ", ".join(sorted(names)),
        "signal_sha256": sha256_of([path.with_name(name) for name in sorted(names)]),
    }
    return RawRecording([_channel(s) for s in signals], rate, "WFDB", provenance=provenance)


def _read_header(path: Path, source: str) -> _Header:
    """Read a header and check the fields that bear on the samples."""
    lines = _lines(path, source)
    first = _FIRST.fullmatch(lines[0]) if lines else None
    if first is None or (first["rate"] and float(first["rate"]) == 0):
        raise InputError(
            f"{source}: not a readable WFDB header (first line {_quoted(lines[0] if lines else '')}"
            "); it must give the name of the record, in letters, digits, - and _, the number of "
            "signals, the sampling rate in Hz and the number of samples, such as rec 12 500 5000"
        )
    rate = float(first["rate"]) if first["rate"] else None
    frames = int(first["frames"]) if first["frames"] else None
    what = "signals" if first["segments"] is None else "segments"
    count = int(first[what])
    if count == 0 or frames == 0:
        raise InputError(
            f"{source}: header without data ({count} {what} of {frames or 0} samples); give a "
            "record that has signals"
        )
    if len(lines) != 1 + count:
        raise InputError(
            f"{source}: its first line says {count} {what}, but {len(lines) - 1} lines follow; "
            "download or export the record again"
        )
    if what == "signals":
        signals = [_signal(line, k, source) for k, line in enumerate(lines[1:], start=1)]
        return _Header(path, source, rate, frames, signals)
    segments = []
    for number, line in enumerate(lines[1:], start=1):
        if (segment := _SEGMENT.fullmatch(line)) is None:
            raise InputError(
                f"{source}: segment {number} is {_quoted(line)}; its line must hold the name of a "
                "record in the same folder and its length"
            )
        segments.append((segment["name"], int(segment["frames"])))
    return _Header(path, source, rate, frames, segments=segments)


def _lines(path: Path, source: str) -> list[str]:
    """Return the lines that are no comments, in ASCII; wfdb drops what is not, as in µV."""
    content = path.read_bytes() if path.stat().st_size <= _LARGEST_HEADER else b""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    text = _MICROVOLT.sub("/uV", text).encode("ascii", "replace").decode("ascii")
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    for line in lines:
        if any(map(_TOO_MANY_DIGITS.search, line.split()[1:8])):
            raise InputError(
                f"{source}: not a readable WFDB header (line {_quoted(line)}); download or export "
                "the record again"
            )
    return lines


def _quoted(text: str) -> str:
    """Return the beginning of a text in quotes, fit for a message."""
    return f"'{printable(text[:40])}'"


def _signal(line: str, number: int, source: str) -> _Stored:
    """Read what matters of a signal line; its other fields and its name are wfdb's to read."""
    match = _SIGNAL.fullmatch(line)
    if match is None or match["format"] not in _BYTES:
        raise InputError(
            f"{source}: signal {number} is {_quoted(line)}; its line must begin with a file in the "
            "folder of the header, named in letters, digits, - and _ with one dot at most, and a "
            f"signal format of {', '.join(_BYTES)}"
        )
    gain = _GAIN.fullmatch(match["gain"] or "")
    # by the standard, without a gain or with 0 a signal is not calibrated
    if gain is None or float(gain["gain"]) == 0:
        raise InputError(
            f"{source}: unknown unit, the gain of signal {number} is "
            f"{_quoted(match['gain'] or 'absent')}; write the digits per mV as the third field of "
            "its line, such as 1000/mV"
        )
    return _Stored(
        file=match["file"],
        format=match["format"],
        per_frame=int(match["per_frame"] or 1),
        skew=int(match["skew"] or 0),
        offset=int(match["offset"] or 0),
        unit=gain["unit"] or "mV",
    )


def _segments(header: _Header, rate: float) -> list[_Header]:
    """Return the segments; gaps, and a layout, which has no samples, have no signals."""
    parts = []
    for name, frames in header.segments:
        source = f"{header.path}: segment {name}"
        file = header.path.with_name(f"{name}.hea")
        part = _Header(file, source, None, frames)
        if name != "~" and frames > 0:
            if not file.is_file():
                raise InputError(f"{source} has no header; put {file.name} in the same folder")
            part = _read_header(file, source)
            if part.segments:
                raise InputError(f"{source} consists of segments itself; give that record")
            if part.rate not in (None, rate) or part.frames != frames:
                raise InputError(
                    f"{source} has {part.frames} samples at {part.rate or rate:g} Hz, the record "
                    f"expects {frames} at {rate:g} Hz; download or export it again"
                )
        parts.append(part)
    total = sum(frames for _, frames in header.segments)
    if header.frames not in (None, total):
        raise InputError(
            f"{header.path}: its segments hold {total} samples, its first line says "
            f"{header.frames}; download or export the record again"
        )
    return parts


def _checked_frames(part: _Header) -> int:
    """Return the length of a part; refuse signal files that are missing or shorter than it."""
    frames = part.frames
    for name in sorted(part.files):
        file, signals = part.path.with_name(name), [s for s in part.signals if s.file == name]
        if not file.is_file():
            raise InputError(
                f"{part.source}: its signal file {name} is missing; put it in the same folder"
            )
        if len({(s.format, s.offset) for s in signals}) > 1:
            raise InputError(
                f"{part.source}: the signals of {name} have different formats or offsets; export "
                "the record again"
            )
        size = sum(s.per_frame * _BYTES[s.format] for s in signals)
        if frames is None and not size:
            raise InputError(
                f"{part.source}: number of samples is absent, but FLAC needs it; write it as the "
                "fourth field of the first line, such as 5000"
            )
        found = int((file.stat().st_size - signals[0].offset) / size) if size else int(frames or 0)
        frames = found if frames is None else frames
        if found < max(frames, 1):
            raise InputError(
                f"{part.source}: its signal file {name} is truncated or empty: {frames} samples of "
                f"each signal are expected, {found} found; download it again"
            )
    skew = max((signal.skew for signal in part.signals), default=0)
    if frames is None or skew >= frames > 0:
        raise InputError(f"{part.source}: a signal is skewed by {skew} samples; export it again")
    return frames


def _read(part: _Header) -> list[_Signal]:
    """Read the signals of a part and align them; what skew leaves over at the end is NaN."""
    import wfdb

    if not part.signals:
        return []
    with refuse_damaged(part.source, "WFDB"):
        record = wfdb.rdrecord(
            str(part.path.absolute().with_suffix("")), smooth_frames=False, ignore_skew=True
        )
    signals = []
    for k, stored in enumerate(part.signals):
        skew = stored.skew * stored.per_frame
        values = np.concatenate([record.e_p_signal[k][skew:], np.full(skew, np.nan)])
        name = printable(record.sig_name[k] or f"signal {k + 1}")
        agrees = _checksum_agrees(record, k)
        gain = record.adc_gain[k]
        signals.append(_Signal(name, stored.unit, values, stored.per_frame, gain, agrees))
    return signals


def _checksum_agrees(record: Any, k: int) -> bool | None:
    """Hold the checksum of a signal against its digits; None where there is none.

    The checksum is the sum of all digits modulo 2^16 (header(5)). Writers that do not compute it
    put 0.
    """
    digits = np.rint(record.e_p_signal[k] * record.adc_gain[k] + record.baseline[k])
    if not record.checksum[k] or not np.isfinite(digits).all():
        return None
    return bool((int(digits.sum()) - record.checksum[k]) % 2**16 == 0)


def _joined(
    parts: Sequence[Sequence[_Signal]], lengths: Sequence[int], frames: int, source: str
) -> list[_Signal]:
    """Put segments one after another by the names of their signals; NaN where there is none."""
    several = len(parts) > 1
    named = [{s.name if several else str(k): s for k, s in enumerate(part)} for part in parts]
    if any(len(names) < len(part) for names, part in zip(named, parts, strict=True)):
        raise InputError(f"{source}: a segment has signals of the same name; rename them")
    whole = []
    for name in dict.fromkeys(name for part in named for name in part):
        pieces = [part.get(name) for part in named]
        there = [signal for signal in pieces if signal is not None]
        unit, per_frame = there[0].unit, there[0].per_frame
        if any((s.unit, s.per_frame) != (unit, per_frame) for s in there):
            raise InputError(
                f"{source}: signal {name} differs in unit or rate between segments; give one "
                "segment"
            )
        gaps = (np.full(length * per_frame, np.nan) for length in lengths)
        values = [gap if s is None else s.values for s, gap in zip(pieces, gaps, strict=True)]
        known = [s.checksum_agrees for s in there if s.checksum_agrees is not None]
        signal = replace(
            there[0],
            values=np.concatenate(values)[: frames * per_frame],
            gain=there[0].gain if len({s.gain for s in there}) == 1 else np.nan,
            checksum_agrees=all(known) if known else None,
        )
        whole.append(signal)
    return whole


def _channel(signal: _Signal) -> Channel:
    scale = millivolts(signal.unit)
    gain = abs(signal.gain) / scale if scale is not None and not np.isnan(signal.gain) else None
    return Channel(signal.name, signal.values, signal.unit, digits_per_millivolt=gain)


def _checksums(signals: Sequence[_Signal]) -> dict[str, str]:
    """Say whether the checksums agree with the samples, where there are any."""
    known = [signal for signal in signals if signal.checksum_agrees is not None]
    wrong = [signal.name for signal in known if not signal.checksum_agrees]
    if not known:
        return {}
    return {"checksums": f"differ for {', '.join(wrong)}" if wrong else CHECKSUMS_AGREE}
