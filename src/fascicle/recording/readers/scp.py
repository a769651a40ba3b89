"""What must hold of an SCP-ECG file before it is decoded (EN 1064, sections 0, 3 and 6)."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from fascicle.core.errors import InputError
from fascicle.recording.recording import check_extent

LARGEST_SCP = 4 * 2**20  # bytes; 64 KiB a lead is the most that the format can hold
MICROSECONDS = 1e6  # of the sampling interval, per second
_PREAMBLE, _HEADER = 6, 16  # bytes before section 0, and before the content of a section
_POINTER, _LEAD = struct.Struct("<HII"), struct.Struct("<IIB")


def check_scp(path: Path) -> None:
    """Refuse a file that is truncated, holds more than one record, or states absurd lengths.

    Parameters
    ----------
    path : Path
        The file. Only its size, its section table, its lead table and its sampling interval are
        looked at; nothing is decoded.

    Raises
    ------
    InputError
        When it cannot be read within bounded memory, or holds more than its one record.
    """
    if path.stat().st_size > LARGEST_SCP:
        raise InputError(
            f"{path}: {path.stat().st_size / 2**20:.0f} MB; an SCP-ECG file takes less than "
            f"{LARGEST_SCP / 2**20:.0f} MB, give one recording"
        )
    data = path.read_bytes()
    try:
        _check_record(path, data)
        _check_leads(path, _section(data, 3), _section(data, 6))
    except (struct.error, IndexError) as error:
        reason = "a section is too short" if isinstance(error, struct.error) else error
        raise InputError(
            f"{path}: damaged or truncated SCP-ECG file ({reason}); export it again"
        ) from error


def _check_record(path: Path, data: bytes) -> None:
    """Refuse a file that is shorter, or but for padding longer, than the record it holds."""
    (size,) = struct.unpack_from("<I", data, 2)
    if size > len(data):
        raise InputError(
            f"{path}: truncated, holds {len(data)} of {size} bytes; export or copy it again"
        )
    if data[size:].strip(b"\0"):
        raise InputError(
            f"{path}: {len(data) - size} bytes follow its record; give a file of one recording"
        )


def _section(data: bytes, number: int) -> bytes:
    """Content of a section, found by the pointers of section 0."""
    (length,) = struct.unpack_from("<I", data, _PREAMBLE + 4)
    content = b""
    end = min(_PREAMBLE + length, len(data))
    for at in range(_PREAMBLE + _HEADER, end - _POINTER.size + 1, _POINTER.size):
        identity, size, index = _POINTER.unpack_from(data, at)
        if identity == number and size > 0 and index > 0:
            content = data[index - 1 + _HEADER : index - 1 + size]
    if not content:
        raise IndexError(f"section {number} is missing")
    return content


def _check_leads(path: Path, definition: bytes, rhythm: bytes) -> None:
    """Refuse sample counts that no such section can hold, and a recording of unusable extent."""
    leads = [_LEAD.unpack_from(definition, 2 + _LEAD.size * k) for k in range(definition[0])]
    if not leads:
        raise IndexError("no leads")
    (interval,) = struct.unpack_from("<H", rhythm, 2)
    sizes = struct.unpack_from(f"<{len(leads)}H", rhythm, 6)
    for number, ((start, end, _), size) in enumerate(zip(leads, sizes, strict=True), start=1):
        # the shortest code is one bit
        if not 0 < start <= end or end - start + 1 > 8 * size:
            raise InputError(
                f"{path}: lead {number} is said to hold samples {start} to {end} in {size} bytes, "
                "the file is damaged; export it again"
            )
    if interval == 0:
        raise InputError(f"{path}: sampling interval is 0 us, the file is damaged; export it again")
    samples = max(end for _, end, _ in leads) - min(start for start, _, _ in leads) + 1
    check_extent(samples, MICROSECONDS / interval, str(path))


def scp_remarks(record: Any) -> list[str]:
    """Say how a record was compressed, and whether all its leads were recorded together."""
    compression = record.recording.acquisition.signal.compression
    remarks = [f"compression: {compression}"] if compression != "none" else []
    together = record.raw_metadata["simultaneous_leads"]
    if 0 < together < len(record.leads):
        remarks.append(f"{together} of {len(record.leads)} leads are said to be simultaneous")
    return remarks
