"""Files of WFDB records, checked against their headers before a sample is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fascicle.core.errors import InputError
from fascicle.recording.readers.hashes import sha256_of
from fascicle.recording.readers.wfdb_header import BYTES_PER_SAMPLE, FLAC_FORMATS, Header
from fascicle.recording.recording import check_extent

_MOST_SAMPLES = 2**27  # of all signals together; 1 GB as float64


@dataclass(frozen=True)
class Part:
    """A header with its path, its length in frames, and what messages about it begin with."""

    path: Path
    header: Header
    frames: int
    source: str


def check_lengths(parts: Sequence[Part], rate: float, source: str) -> None:
    """Refuse what is too long, or too large for the memory, before anything is read.

    Parameters
    ----------
    parts : sequence of Part
        The segments of a record, or its only part.
    rate : float
        Frames per second (Hz).
    source : str
        What messages begin with.

    Raises
    ------
    InputError
        When that is so; the message says what to do.
    """
    per_frame = [s.per_frame for part in parts for s in part.header.signals]
    if not per_frame:
        raise InputError(f"{source}: its segments have no signals; give a record that has some")
    frames = sum(part.frames for part in parts)
    check_extent(frames * max(per_frame), rate * max(per_frame), source)
    width = max(sum(s.per_frame for s in part.header.signals) for part in parts)
    if frames * width > _MOST_SAMPLES:
        raise InputError(
            f"{source}: {frames * width} samples in all; cut the recording, 10 s are enough"
        )


def check_files(part: Part) -> None:
    """Refuse signal files that are missing or shorter than the header says.

    Parameters
    ----------
    part : Part
        Header whose files are looked at.

    Raises
    ------
    InputError
        When that is so; the message says what to do.
    """
    signals, source = part.header.signals, part.source
    for name in part.header.files:
        places = [k for k, signal in enumerate(signals) if signal.file == name]
        if len({(signals[k].format, signals[k].offset) for k in places}) > 1 or (
            places[-1] - places[0] >= len(places)
        ):
            raise InputError(
                f"{source}: the signals of {name} have different formats or offsets, or others "
                "between them; export the record again"
            )
        found = frames_in(part.path, part.header, name, source)
        if found < part.frames:
            raise InputError(
                f"{source}: its signal file {name} is truncated: {part.frames} samples of each "
                f"signal are expected, {found} found; download it again"
            )
    skew = max((signal.skew for signal in signals), default=0)
    if skew >= part.frames > 0:
        raise InputError(f"{source}: a signal is skewed by {skew} samples; export it again")


def frames_in(path: Path, header: Header, name: str, source: str) -> int:
    """Count the whole frames that a signal file holds.

    Parameters
    ----------
    path : path
        The header, which is in the same folder.
    header : Header
        What it says.
    name : str
        Name of the signal file.
    source : str
        What messages begin with.

    Raises
    ------
    InputError
        When the file is missing, or is no FLAC file but should be.
    """
    file = path.with_name(name)
    if not file.is_file():
        raise InputError(f"{source}: its signal file {name} is missing; put it in the same folder")
    signals = [signal for signal in header.signals if signal.file == name]
    first = signals[0]
    if first.format in FLAC_FORMATS:
        return max(0, _flac_samples(file, source) - first.offset) // first.per_frame
    samples = max(0, file.stat().st_size - first.offset) / BYTES_PER_SAMPLE[first.format]
    return int(samples / sum(signal.per_frame for signal in signals))


def _flac_samples(file: Path, source: str) -> int:
    """Return the samples of each channel, from the STREAMINFO block (RFC 9639, section 8.2)."""
    with file.open("rb") as stream:
        start = stream.read(26)
    if len(start) < 26 or not start.startswith(b"fLaC"):
        raise InputError(f"{source}: its signal file {file.name} is not FLAC; download it again")
    return int.from_bytes(start[18:26], "big") % 2**36


def hash_note(path: Path, header: Header, parts: Sequence[Part]) -> dict[str, str]:
    """Name the further files of the record and give the SHA-256 of all of them.

    Parameters
    ----------
    path : path
        The header of the record.
    header : Header
        What it says.
    parts : sequence of Part
        Its segments, or its only part.

    Returns
    -------
    dict
        ``signal_files``, sorted by name, and ``signal_sha256`` of them one after another.
    """
    names = {name for part in parts for name in part.header.files}
    if header.segments:
        names |= {part.path.name for part in parts if part.header.signals}
    files = [path.with_name(name) for name in sorted(names)]
    return {"signal_files": ", ".join(sorted(names)), "signal_sha256": sha256_of(files)}
