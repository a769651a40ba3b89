"""EDF and EDF+ recordings."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.declared import agreed_rate, damage
from fascicle.recording.readers.names import lead_name
from fascicle.recording.readers.raw_recording import Channel, Contents, gain_of, strictest
from fascicle.recording.readers.read_options import Given
from fascicle.recording.recording import Filters, check_extent

if TYPE_CHECKING:
    from edfio import Edf, EdfSignal

_BLOCK = 256  # bytes of the fixed part of the header, and of the header of each signal
_SAMPLES_FIELD = 216  # bytes, times the number of signals, to the samples of a data record
_BYTES_PER_SAMPLE = 2
_DIGITS = (-32768, 32767)  # what 16 bits hold
_UNKNOWN = -1  # data records; stays in the header where the recorder has not closed the file
# Chest leads may name Wilson's terminal, the reference that makes them unipolar
_WILSON = re.compile(r"(?<=V[1-6])-(WCT|Wilson)$", re.IGNORECASE)
# "HP:0.05Hz LP:150Hz N:50Hz"; a number with another unit than Hz is not understood
_FILTER = re.compile(
    r"\b(HP|LP|N)(?:otch)?\s*:\s*(\d+(?:[.,]\d+)?|[.,]\d+)"
    r"(?:\s*Hz\b|(?=\s*(?:$|(?:HP|LP|N)(?:otch)?\s*:)))",
    re.IGNORECASE,
)
# What edfio raises on header fields that are not what they should be
_PARSE_ERRORS = (ValueError, OSError, EOFError, OverflowError, TypeError)


def read_edf(path: Path, given: Given) -> Contents:
    """Read an EDF or EDF+ file; signals that are no leads are named but not read.

    Parameters
    ----------
    path : path
        The file.
    given : Given
        What the user says; it must agree with the file.

    Returns
    -------
    Contents
        Leads in the physical dimension of the header; other signals have no values.

    Raises
    ------
    InputError
        When the header is damaged, does not fit the length of the file or calls the recording
        interrupted, or when leads differ in rate or have no calibration.

    References
    ----------
    Kemp et al. 1992, Electroenceph Clin Neurophysiol 82:391-393 (EDF); Kemp and Olivan 2003, Clin
    Neurophysiol 114:1755-1761 (EDF+); https://www.edfplus.info/specs.
    """
    import edfio

    notes = _check_size(path)
    with damage(path, "EDF", _PARSE_ERRORS), warnings.catch_warnings():
        # edfio counts the records of unclosed files itself, and warns
        warnings.filterwarnings("ignore", message="EDF header indicates|Incomplete data record")
        # lazily: the samples of a signal are read when they are asked for
        file = edfio.read_edf(path, lazy_load_data=True, header_encoding="latin-1")
        signals = [(signal, _lead(signal.label)) for signal in file.signals]
    leads = [signal for signal, lead in signals if lead is not None]
    if not leads:
        labels = ", ".join(printable(signal.label) for signal, _ in signals[:6])
        raise InputError(
            f"{path}: no leads among its {len(signals)} signals ({labels}); label them I, II, V1 "
            "to V6"
        )
    rate = _rate(path, file, leads, given)
    channels = [
        Channel(printable(signal.label), np.empty(0), None)
        if lead is None
        else _channel(path, signal, lead, given)
        for signal, lead in signals
    ]
    return Contents(channels, rate, "EDF", _filters(leads), notes)


def _check_size(path: Path) -> dict[str, str]:
    """Refuse a file that is longer or shorter than its header says; note an unclosed one."""
    with path.open("rb") as file:
        fixed = file.read(_BLOCK)
        _check_kind(path, fixed)
        with damage(path, "EDF", (ValueError,)):
            header, records = int(fixed[184:192]), int(fixed[236:244])
            seconds, signals = float(fixed[244:252]), int(fixed[252:256])
            file.seek(_BLOCK + _SAMPLES_FIELD * max(signals, 0))
            samples = [int(file.read(8)) for _ in range(signals)]
    record = _BYTES_PER_SAMPLE * sum(samples)
    data = path.stat().st_size - header
    if min(samples, default=0) < 1 or header != _BLOCK * (signals + 1) or data < record:
        raise InputError(
            f"{path}: damaged EDF header ({signals} signals, {header} bytes of header, {record} a "
            f"data record, {max(data, 0)} of data); export the recording again"
        )
    if not (math.isfinite(seconds) and seconds > 0) or (records < 1 and records != _UNKNOWN):
        raise InputError(
            f"{path}: damaged EDF header ({records} data records of {seconds:g} s); export the "
            "recording again"
        )
    if records == _UNKNOWN:
        return {"data_records": f"{data // record}, counted; the recorder did not close the file"}
    if data != records * record:
        raise InputError(
            f"{path}: header declares {records} data records, the file holds {data / record:g}; "
            "truncated or damaged, copy or export it again"
        )
    return {}


def _check_kind(path: Path, fixed: bytes) -> None:
    """Refuse what is no continuous EDF by the fixed part of the header."""
    if fixed.startswith(b"\xffBIOSEMI"):
        raise InputError(f"{path}: 24-bit BDF; export the recording as EDF")
    if len(fixed) < _BLOCK or not fixed.startswith(b"0       "):
        raise InputError(f"{path}: not an EDF file (no EDF header); export the recording again")
    if fixed[192:].startswith(b"EDF+D"):
        raise InputError(
            f"{path}: interrupted recording (EDF+D), its parts may have gaps between them; export "
            "one part as continuous EDF+C"
        )


def _lead(label: str) -> str | None:
    """Return the standard name of an EDF label such as ``ECG V1``, ``EKG aVR``, ``V1-WCT``."""
    return lead_name(_WILSON.sub("", label.strip()))


def _rate(path: Path, file: Edf, leads: Sequence[EdfSignal], given: Given) -> float:
    """Return the rate (Hz) that all leads share; lengths are checked before samples are read."""
    slow, fast = (
        pick(leads, key=lambda signal: signal.samples_per_data_record) for pick in (min, max)
    )
    if slow.samples_per_data_record != fast.samples_per_data_record:
        raise InputError(
            f"{path}: '{printable(slow.label)}' has {slow.sampling_frequency:g} samples per "
            f"second, '{printable(fast.label)}' {fast.sampling_frequency:g}; export all leads at "
            "one rate"
        )
    rate = agreed_rate(path, slow.sampling_frequency, given)
    check_extent(file.num_data_records * slow.samples_per_data_record, rate, str(path))
    return rate


def _channel(path: Path, signal: EdfSignal, lead: str, given: Given) -> Channel:
    """Read a lead in its physical dimension."""
    with damage(path, "EDF", _PARSE_ERRORS):
        digital, physical = signal.digital_range, signal.physical_range
    low, high = _DIGITS
    step = (physical.max - physical.min) / max(digital.max - digital.min, 1)
    if not low <= digital.min < digital.max <= high or step == 0 or not math.isfinite(step):
        raise InputError(
            f"{path}: lead {lead} has no calibration (digital {digital.min} to {digital.max}, "
            f"physical {physical.min:g} to {physical.max:g}); export it with its physical range"
        )
    stated = printable(signal.physical_dimension.strip()) or None
    gain = gain_of(step, stated or given.unit)
    return Channel(printable(signal.label), signal.data, stated, lead, gain)


def _filters(leads: Sequence[EdfSignal]) -> Filters:
    """Collect the filters of the leads; where leads differ, the strictest."""
    found: dict[str, list[float]] = {"HP": [], "LP": [], "N": []}
    for signal in leads:
        for kind, hertz in _FILTER.findall(signal.prefiltering):
            found[kind.upper()].append(float(hertz.replace(",", ".")))
    return strictest(found["HP"], found["LP"], found["N"])
