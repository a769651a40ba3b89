"""The clinics' own formats: HL7 aECG and GE MUSE (XML), SCP-ECG."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.readers import clinical_xml
from fascicle.recording.readers.declared import agreed_rate
from fascicle.recording.readers.names import first_line, lead_name
from fascicle.recording.readers.raw_recording import Channel, Contents, gain_of
from fascicle.recording.readers.read_options import Given
from fascicle.recording.readers.scp import MICROSECONDS, check_scp, scp_remarks
from fascicle.recording.recording import Filters

# What the parsers raise, besides their own kind, on files that are not what they claim to be
_PARSE_ERRORS = (ValueError, ArithmeticError, RecursionError)
LONGEST_REASON = 160  # characters of a library's message


def read_xml(path: Path, given: Given) -> Contents:
    """Read an HL7 aECG or GE MUSE XML file.

    Every value is ``scale * digit + origin`` with the scale and the unit that the file states.
    A file without a scale is refused whatever the user says its unit is.

    Parameters
    ----------
    path : Path
        The file; its root element decides which of the two it is.
    given : Given
        What the user says; its unit serves later, where a file states a scale without a unit.

    Returns
    -------
    Contents
        Leads with the unit as the file spells it.

    Raises
    ------
    InputError
        When the file is another format, damaged, of two patients, or states no scale.

    References
    ----------
    ANSI/HL7 V3 ECG R1-2004; restecg.dtd of GE Healthcare.
    """
    root = clinical_xml.open_xml(path)
    if root.tag == "AnnotatedECG":
        return _read_aecg(path, root, given)
    if root.tag.lower() == "restingecg":
        return _read_muse(path, root, given)
    maker = ", Philips" if root.tag == "restingecgdata" else ""
    raise InputError(
        f"{path}: XML of this kind (<{root.tag[:40]}>{maker}) is not read; export the recording as "
        "HL7 aECG, GE MUSE XML or DICOM"
    )


def _read_aecg(path: Path, root: Any, given: Given) -> Contents:
    from ecgdatakit.parsing.parsers.hl7_aecg import HL7aECGParser

    clinical_xml.check_aecg(path, root)
    record, remarks = _parse(HL7aECGParser, path)
    rate = float(record.raw_metadata["rhythm_time"]["sampling_rate_exact"])
    return _contents(path, record, agreed_rate(path, rate, given), "HL7 aECG", remarks)


def _read_muse(path: Path, root: Any, given: Given) -> Contents:
    from ecgdatakit.parsing.parsers.ge_muse_xml import GEMuseXMLParser

    clinical_xml.check_muse(path, root)
    record, remarks = _parse(GEMuseXMLParser, path, clinical_xml.has_checksums(root))
    clinical_xml.check_simultaneous(path, record.leads)
    remarks += clinical_xml.leads_off(record.leads)
    rate = agreed_rate(path, clinical_xml.muse_sampling_rate(root), given)
    return _contents(path, record, rate, "GE MUSE XML", remarks)


def read_scp(path: Path, given: Given) -> Contents:
    """Read an SCP-ECG file, as `read_xml` does; leads that start later than others are NaN before.

    Parameters
    ----------
    path : Path
        The file.
    given : Given
        What the user says.

    Returns
    -------
    Contents
        Leads with the unit of the format.

    Raises
    ------
    InputError
        When the file is damaged, compressed in a way that is not read, or states no scale.

    References
    ----------
    EN 1064:2005+A1:2007 (ISO 11073-91064).
    """
    from ecgdatakit.parsing.parsers.scp_ecg import SCPECGParser

    check_scp(path)
    record, remarks = _parse(SCPECGParser, path)
    remarks += scp_remarks(record)
    rate = MICROSECONDS / record.raw_metadata["rhythm_sample_interval_us"]
    return _contents(path, record, agreed_rate(path, rate, given), "SCP-ECG", remarks)


def _parse(parser: Any, path: Path, checksums: bool = True) -> tuple[Any, list[str]]:
    """Run one parser; return its record and its warnings, of which failed checksums are errors."""
    from ecgdatakit.exceptions import ChecksumWarning, ECGDataKitError, UnsupportedFormatError

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            record = parser().parse(path)
    except UnsupportedFormatError as error:
        raise InputError(
            f"{path}: cannot be read ({_reason(error, path)}); export it without "
            "compression, or as HL7 aECG or DICOM"
        ) from error
    except (ECGDataKitError, *_PARSE_ERRORS) as error:
        raise InputError(
            f"{path}: damaged file ({_reason(error, path)}); export it again"
        ) from error
    remarks = []
    for warning in caught:
        reason = _reason(Warning(warning.message), path)
        if not issubclass(warning.category, ChecksumWarning):
            remarks.append(reason)
        elif checksums:
            raise InputError(
                f"{path}: its checksum does not fit its content ({reason}), so the file is "
                "damaged; export it again"
            )
    return record, remarks


def _reason(error: BaseException, path: Path) -> str:
    """Return one short line about an error or a warning; the file is named elsewhere."""
    line = first_line(error)
    for word in (" in ", " of "):
        line = line.replace(f"{word}{path}", "").replace(f"{word}{path.name}", "")
    return line[:LONGEST_REASON]


def _contents(path: Path, record: Any, rate: float, kind: str, remarks: Sequence[str]) -> Contents:
    """Turn a record into channels over one common time."""
    notes = {"parser": f"ecgdatakit {version('ecgdatakit')}"}
    if remarks:
        notes["remarks"] = "; ".join(remarks)
    channels = [_channel(path, lead) for lead in record.leads]
    starts = [int(lead.annotations.get("start_sample", 1)) for lead in record.leads]
    filters = record.recording.acquisition.filters
    return Contents(
        _placed(channels, starts),
        rate,
        kind,
        Filters(*(_frequency(f) for f in (filters.highpass, filters.lowpass, filters.notch))),
        notes,
    )


def _channel(path: Path, lead: Any) -> Channel:
    """Turn the digits of a lead into physical values; channels that are no leads stay digits."""
    name = _own_name(lead.label)
    digits = np.asarray(lead.samples, dtype=np.float64)
    if lead_name(name) is None:
        return Channel(name, digits, None)
    # as written in the file: 0 where it is absent, and `resolution` then is a guess of 1
    scale = lead.adc_resolution
    if not math.isfinite(scale) or scale <= 0:
        found = "none" if scale == 0 else f"{scale:g}"
        raise InputError(
            f"{path}: unknown amplitude of lead {name} (its scale is {found}); export the "
            "recording with the amplitude of one digit"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        values = lead.resolution * digits + lead.offset
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        raise InputError(
            f"{path}: lead {name} holds {wrong.size} samples that are no finite numbers (first: "
            f"sample {wrong[0]}); export the recording again"
        )
    unit = lead.resolution_unit or lead.adc_resolution_unit or None
    return Channel(name, values, unit, digits_per_millivolt=gain_of(lead.resolution, unit))


def _own_name(label: str) -> str:
    """Take off the number that the library adds to a repeated name, so that it shows as one."""
    name, _, number = label.rpartition("_")
    return name if name and number.isdigit() else label


def _placed(channels: Sequence[Channel], starts: Sequence[int]) -> list[Channel]:
    """Put every lead where it starts on the common time axis; NaN where it has no samples."""
    leads = [k for k, channel in enumerate(channels) if lead_name(channel.name) is not None]
    if len({starts[k] for k in leads}) <= 1:
        return list(channels)
    first = min(starts[k] for k in leads)
    n = max(starts[k] + len(channels[k].values) for k in leads) - first
    placed = list(channels)
    for k in leads:
        placed[k] = channels[k].placed(starts[k] - first, n)
    return placed


def _frequency(value: float | None) -> float | None:
    """Return a frequency (Hz), or None where the file states none that can be."""
    return value if value is not None and math.isfinite(value) and value > 0 else None
