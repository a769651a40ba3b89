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
from fascicle.recording.readers.content import refuse_damaged
from fascicle.recording.readers.names import lead_name
from fascicle.recording.readers.raw_recording import (
    Channel,
    RawRecording,
    ReadOptions,
    gain_of,
    narrowest_passband,
)
from fascicle.recording.recording import Filters, check_extent

if TYPE_CHECKING:
    from edfio import EdfSignal

_BLOCK = 256  # bytes of the fixed part of the header
_RECORDS = slice(236, 244)  # of it: the number of data records
_UNKNOWN = b"-1      "  # stays there where the recorder did not close the file
_DIGITS = (-32768, 32767)  # what 16 bits hold
# Chest leads may name Wilson's terminal, the reference that makes them unipolar
_WILSON = re.compile(r"(?<=V[1-6])-(WCT|Wilson)$", re.IGNORECASE)
# "HP:0.05Hz LP:150Hz N:50Hz"; a number with another unit than Hz is not understood
_FILTER = re.compile(
    r"\b(HP|LP|N)(?:otch)?\s*:\s*(\d+(?:[.,]\d+)?|[.,]\d+)"
    r"(?:\s*Hz\b|(?=\s*(?:$|(?:HP|LP|N)(?:otch)?\s*:)))",
    re.IGNORECASE,
)


def read_edf(path: Path, options: ReadOptions) -> RawRecording:
    """Read an EDF or EDF+ file; signals that are no leads are named but not read.

    References
    ----------
    Kemp et al. 1992, Electroenceph Clin Neurophysiol 82:391-393 (EDF); Kemp and Olivan 2003, Clin
    Neurophysiol 114:1755-1761 (EDF+); https://www.edfplus.info/specs.
    """
    import edfio

    with path.open("rb") as stream:
        fixed = stream.read(_BLOCK)
    _check_kind(path, fixed)
    unclosed = fixed[_RECORDS] == _UNKNOWN
    with refuse_damaged(path, "EDF", UserWarning), warnings.catch_warnings():
        # edfio cuts a file that does not fit its header, and warns
        warnings.filterwarnings(
            "ignore" if unclosed else "error", message="EDF header indicates|Incomplete data record"
        )
        # lazily: the samples of a signal are read when they are asked for
        file = edfio.read_edf(path, lazy_load_data=True, header_encoding="latin-1")
        signals = [(signal, _lead(signal.label)) for signal in file.signals]
        lengths = {signal.label: signal.samples_per_data_record for signal, lead in signals if lead}
        rates = {signal.label: signal.sampling_frequency for signal, lead in signals if lead}
        records = file.num_data_records
    if not lengths:
        labels = ", ".join(printable(signal.label) for signal, _ in signals[:6])
        raise InputError(
            f"{path}: no leads among its {len(signals)} signals ({labels}); label them I, II, V1 "
            "to V6"
        )
    slow, fast = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
    if lengths[slow] != lengths[fast]:
        raise InputError(
            f"{path}: '{printable(slow)}' has {rates[slow]:g} samples per second, "
            f"'{printable(fast)}' {rates[fast]:g}; export all leads at one rate"
        )
    rate = options.agreed_rate(path, rates[slow])
    check_extent(records * lengths[slow], rate, str(path))
    channels = [
        Channel(printable(signal.label), np.empty(0), None)
        if lead is None
        else _channel(path, signal, lead, options)
        for signal, lead in signals
    ]
    counted = {"data_records": f"{records}, counted; the recorder did not close the file"}
    filters = _filters([signal for signal, lead in signals if lead is not None])
    return RawRecording(channels, rate, "EDF", filters, counted if unclosed else {})


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


def _channel(path: Path, signal: EdfSignal, lead: str, options: ReadOptions) -> Channel:
    """Read a lead in its physical dimension."""
    with refuse_damaged(path, "EDF"):
        digital, physical = signal.digital_range, signal.physical_range
    low, high = _DIGITS
    step = (physical.max - physical.min) / max(digital.max - digital.min, 1)
    if not low <= digital.min < digital.max <= high or step == 0 or not math.isfinite(step):
        raise InputError(
            f"{path}: lead {lead} has no calibration (digital {digital.min} to {digital.max}, "
            f"physical {physical.min:g} to {physical.max:g}); export it with its physical range"
        )
    declared = printable(signal.physical_dimension.strip()) or None
    gain = gain_of(step, declared or options.unit)
    return Channel(printable(signal.label), signal.data, declared, lead, gain)


def _filters(leads: Sequence[EdfSignal]) -> Filters:
    """Collect the filters of the leads; where leads differ, the narrowest pass band."""
    found: dict[str, list[float]] = {"HP": [], "LP": [], "N": []}
    for signal in leads:
        for kind, hertz in _FILTER.findall(signal.prefiltering):
            found[kind.upper()].append(float(hertz.replace(",", ".")))
    return narrowest_passband(found["HP"], found["LP"], found["N"])
