"""WFDB records (PhysioNet): a .hea header and its signal files."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.errors import InputError
from fascicle.io.recordings.contents import Channel, Contents, Given
from fascicle.io.recordings.names import first_line

_LEADING_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
# What wfdb raises on files that are not what they claim to be
_PARSE_ERRORS = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    ZeroDivisionError,
)


def read_wfdb(path: Path, given: Given) -> Contents:
    """Read the record of a ``.hea`` header; extra signals such as Frank leads are left out."""
    import wfdb

    stem = str(path.absolute().with_suffix(""))
    try:
        header = wfdb.rdheader(stem)
    except _PARSE_ERRORS as error:
        raise InputError(
            f"{path}: not a readable WFDB header ({first_line(error)}); download or export it again"
        ) from error
    _check_header(path, header)
    try:
        record = wfdb.rdrecord(stem)
    except _PARSE_ERRORS as error:
        raise InputError(
            f"{path}: its signal file is truncated or damaged ({first_line(error)}); download or "
            "export the record again"
        ) from error
    if record.p_signal is None or not record.p_signal.size:
        raise InputError(f"{path}: header without samples; give a record that has signals")
    gains = getattr(record, "adc_gain", None) or [None] * record.n_sig
    channels = [
        Channel(name or "", np.asarray(values, dtype=np.float64), unit, digits_per_millivolt=gain)
        for name, unit, values, gain in zip(
            record.sig_name, record.units, record.p_signal.T, gains, strict=True
        )
    ]
    return Contents(channels, float(record.fs), "WFDB", notes=_signal_hash(path, header))


def _check_header(path: Path, header: Any) -> None:
    """Refuse headers without signals, without a rate, without their files, or uncalibrated."""
    if not header.n_sig or header.sig_len == 0:
        raise InputError(
            f"{path}: header without data ({header.n_sig or 0} signals of {header.sig_len or 0} "
            "samples); give a record that has signals"
        )
    if not header.fs:
        raise InputError(f"{path}: sampling rate is 0 Hz; correct the first line of the header")
    for name in _signal_files(header):
        if not (path.parent / name).is_file():
            raise InputError(
                f"{path}: its signal file {name} is missing; put it in the same folder"
            )
    if _signal_files(header):
        _check_calibrated(path)


def _signal_files(header: Any) -> list[str]:
    """Name the signal files of a record; none for records of several segments."""
    return sorted(set(getattr(header, "file_name", None) or []))


def _check_calibrated(path: Path) -> None:
    """Refuse signals whose gain is absent or 0, which by the WFDB standard means not calibrated."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    for number, line in enumerate(lines[1:], start=1):
        fields = line.split()
        gain = _LEADING_NUMBER.match(fields[2]) if len(fields) > 2 else None
        if gain is None or float(gain[0]) == 0:
            raise InputError(
                f"{path}: unknown units, signal {number} has no gain; write the units per mV as "
                "the third field of its line, such as 1000/mV"
            )


def _signal_hash(path: Path, header: Any) -> dict[str, str]:
    names = _signal_files(header)
    if not names:
        return {}
    data = b"".join((path.parent / name).read_bytes() for name in names)
    return {"signal_files": ", ".join(names), "signal_sha256": hashlib.sha256(data).hexdigest()}
