"""WFDB records (PhysioNet): a .hea header and its signal files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.declared import agreed_rate
from fascicle.recording.readers.names import first_line, lead_name, millivolts
from fascicle.recording.readers.raw_recording import Channel, Contents
from fascicle.recording.readers.read_options import Given
from fascicle.recording.readers.wfdb_files import (
    Part,
    check_files,
    check_lengths,
    frames_in,
    hash_note,
)
from fascicle.recording.readers.wfdb_header import FLAC_FORMATS, Header, SignalLine, read_header
from fascicle.recording.recording import CHECKSUMS_AGREE, check_extent


@dataclass(frozen=True)
class _Signal:
    """One signal of a part: values in `unit`, `per_frame` of them in each frame."""

    name: str
    unit: str
    values: NDArray[np.float64]
    per_frame: int
    gain: float
    sum_agrees: bool | None


def read_wfdb(path: Path, given: Given) -> Contents:
    """Read a record of one or several segments from its ``.hea`` header.

    Samples that a segment lacks, and those that are marked invalid, are NaN. Skewed signals are
    aligned, which shortens the record by the largest skew. Signals are at their own rate, so that
    a lead with four samples in a frame has four times the frame rate.

    Parameters
    ----------
    path : path
        The header; its signal files and segments are in the same folder.
    given : Given
        What the user says; it must agree with the header. Its sampling rate serves where the
        header has none, which by the standard means 250 Hz.

    Returns
    -------
    Contents
        All signals. Checksums that disagree are told in the notes: many converters write wrong
        ones.

    Raises
    ------
    InputError
        When the header or a file is missing, damaged, truncated or too long, or a signal is not
        calibrated.

    References
    ----------
    G. B. Moody, WFDB Applications Guide, header(5) and signal(5), physionet.org.
    """
    source = str(path)
    if "::" in str(path.absolute()) or path.suffix != ".hea":
        # fsspec, which wfdb opens files with, takes what is joined by :: for addresses
        raise InputError(f"{source}: rename it so that the name ends in .hea and has no '::'")
    header = read_header(path, source)
    # by the standard a header without a rate means 250 Hz, but most such headers lost theirs
    rate = header.rate if header.rate is not None else agreed_rate(path, None, given)
    parts = _segments(path, header, rate) if header.segments else [_single(path, header, source)]
    check_lengths(parts, rate, source)
    for part in parts:
        check_files(part)
    signals, frames = _joined([_read(part) for part in parts], parts, source)
    leads_per_frame = max((s.per_frame for s in signals if lead_name(s.name)), default=1)
    check_extent(frames * leads_per_frame, rate * leads_per_frame, source)
    rate = agreed_rate(path, rate * leads_per_frame, given)
    notes = _checksum_note(signals) | hash_note(path, header, parts)
    return Contents([_channel(s) for s in signals], rate, "WFDB", notes=notes)


def _single(path: Path, header: Header, source: str) -> Part:
    if header.frames is not None:
        return Part(path, header, header.frames, source)
    if header.signals[0].format in FLAC_FORMATS:
        raise InputError(
            f"{source}: number of samples is absent, but FLAC needs it; write it as the fourth "
            "field of the first line, such as 5000"
        )
    frames = frames_in(path, header, header.files[0], source)
    if frames == 0:
        raise InputError(f"{source}: its signal file {header.files[0]} is empty; download it again")
    return Part(path, header, frames, source)


def _segments(path: Path, header: Header, rate: float) -> list[Part]:
    """Return the segments; gaps, and a layout, which has no samples, have no signals."""
    parts = []
    for name, frames in header.segments:
        source = f"{path}: segment {name}"
        segment = Header(None, frames, ())
        file = path.with_name(f"{name}.hea")
        if name != "~" and frames > 0:
            if not file.is_file():
                raise InputError(f"{source} has no header; put {file.name} in the same folder")
            segment = read_header(file, source)
            _check_segment(segment, frames, rate, source)
        parts.append(Part(file, segment, frames, source))
    total = sum(part.frames for part in parts)
    if header.frames is not None and header.frames != total:
        raise InputError(
            f"{path}: its segments hold {total} samples, its first line says {header.frames}; "
            "download or export the record again"
        )
    return parts


def _check_segment(segment: Header, frames: int, rate: float, source: str) -> None:
    if segment.segments:
        raise InputError(f"{source} consists of segments itself; give that record")
    if segment.rate is not None and segment.rate != rate:
        raise InputError(
            f"{source} is sampled at {segment.rate:g} Hz, the record at {rate:g} Hz; give one "
            "segment"
        )
    if segment.frames != frames:
        found = "an unstated number of" if segment.frames is None else segment.frames
        raise InputError(
            f"{source} has {found} samples, the record expects {frames}; download or export it "
            "again"
        )


def _read(part: Part) -> list[_Signal]:
    """Read the signals of a part and align them; what skew leaves over at the end is NaN."""
    import wfdb

    if not part.header.signals:
        return []
    try:
        record = wfdb.rdrecord(
            str(part.path.absolute().with_suffix("")),
            smooth_frames=False,
            ignore_skew=True,
        )
    except (ValueError, OSError, OverflowError, RuntimeError) as error:
        found = printable(first_line(error))
        raise InputError(
            f"{part.source}: its header or signal files are damaged ({found}); download or export "
            "the record again"
        ) from error
    return [
        _Signal(
            name=printable(record.sig_name[k] or f"signal {k + 1}"),
            unit=line.unit,
            values=_aligned(record.e_p_signal[k], line),
            per_frame=line.per_frame,
            gain=record.adc_gain[k],
            sum_agrees=_sum_agrees(record, k),
        )
        for k, line in enumerate(part.header.signals)
    ]


def _sum_agrees(record: Any, k: int) -> bool | None:
    """Hold the checksum of a signal against its digits; None where there is none.

    The checksum is the sum of all digits modulo 2^16 (header(5)). Writers that do not compute it
    put 0.
    """
    digits = np.rint(record.e_p_signal[k] * record.adc_gain[k] + record.baseline[k])
    if not record.checksum[k] or not np.isfinite(digits).all():
        return None
    return bool((int(digits.sum()) - record.checksum[k]) % 2**16 == 0)


def _aligned(values: NDArray[np.float64], line: SignalLine) -> NDArray[np.float64]:
    skew = line.skew * line.per_frame
    return np.concatenate([values[skew:], np.full(skew, np.nan)])


def _joined(
    signals: Sequence[Sequence[_Signal]], parts: Sequence[Part], source: str
) -> tuple[list[_Signal], int]:
    """Put segments one after another by the names of their signals, and count the frames left."""
    frames = sum(part.frames for part in parts) - max(
        (line.skew for line in parts[-1].header.signals), default=0
    )
    if len(parts) == 1:
        whole = {str(k): [(0, signal)] for k, signal in enumerate(signals[0])}
    else:
        whole = {}
        starts = np.cumsum([0, *(part.frames for part in parts)])
        for start, part, found in zip(starts, parts, signals, strict=False):
            if len({signal.name for signal in found}) != len(found):
                raise InputError(f"{part.source} has signals of the same name; rename them")
            for signal in found:
                whole.setdefault(signal.name, []).append((int(start), signal))
    return [_whole(pieces, frames, source) for pieces in whole.values()], frames


def _whole(pieces: Sequence[tuple[int, _Signal]], frames: int, source: str) -> _Signal:
    """Make one signal of its pieces, which start at given frames; NaN where there is none."""
    first = pieces[0][1]
    if len({(signal.unit, signal.per_frame) for _, signal in pieces}) > 1:
        raise InputError(
            f"{source}: signal {first.name} differs in unit or rate between segments; give one "
            "segment"
        )
    values = np.full(frames * first.per_frame, np.nan)
    for start, signal in pieces:
        place = values[start * first.per_frame :][: len(signal.values)]
        place[:] = signal.values[: len(place)]
    gains = {signal.gain for _, signal in pieces}
    sums = {signal.sum_agrees for _, signal in pieces}
    return _Signal(
        name=first.name,
        unit=first.unit,
        values=values,
        per_frame=first.per_frame,
        gain=gains.pop() if len(gains) == 1 else np.nan,
        sum_agrees=False if False in sums else (True if True in sums else None),
    )


def _channel(signal: _Signal) -> Channel:
    scale = millivolts(signal.unit)
    gain = abs(signal.gain) / scale if scale is not None and not np.isnan(signal.gain) else None
    return Channel(signal.name, signal.values, signal.unit, digits_per_millivolt=gain)


def _checksum_note(signals: Iterable[_Signal]) -> dict[str, str]:
    known = [signal for signal in signals if signal.sum_agrees is not None]
    wrong = [signal.name for signal in known if not signal.sum_agrees]
    if not known:
        return {}
    return {"checksums": f"differ for {', '.join(wrong)}" if wrong else CHECKSUMS_AGREE}
