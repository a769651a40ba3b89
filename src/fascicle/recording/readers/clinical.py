"""The clinics' own formats: HL7 aECG and GE MUSE (XML), SCP-ECG."""

from __future__ import annotations

import math
import struct
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, one_line
from fascicle.recording.readers.content import LIBRARY_ERRORS, refuse_damaged
from fascicle.recording.readers.names import lead_name
from fascicle.recording.readers.raw_recording import Channel, RawRecording, ReadOptions, gain_of
from fascicle.recording.recording import Filters

LARGEST_XML = 64 * 2**20  # bytes; 30 min of 12 leads at 500 Hz, in digits
MOST_MARKS = 1_000_000  # tags and attributes; a 10 s recording has some 5000
_MICROSECONDS = 1e6  # of the sampling interval, per second
# Whether leads begin together; their meaning is not published, but it is one for all leads or none
_OFFSETS = ("LeadTimeOffset", "LeadOffsetFirstSample")


def read_xml(path: Path, options: ReadOptions) -> RawRecording:
    """Read an HL7 aECG or GE MUSE XML file.

    Every value is ``scale * digit + origin`` with the scale and the unit that the file states.
    A file without a scale is refused whatever the user says its unit is.

    References
    ----------
    ANSI/HL7 V3 ECG R1-2004; restecg.dtd of GE Healthcare.
    """
    root = _open_xml(path)
    if root.tag == "AnnotatedECG":
        return _read_aecg(path, root, options)
    if root.tag.lower() == "restingecg":
        return _read_muse(path, root, options)
    maker = ", Philips" if root.tag == "restingecgdata" else ""
    raise InputError(
        f"{path}: XML of this kind (<{root.tag[:40]}>{maker}) is not read; export the recording as "
        "HL7 aECG, GE MUSE XML or DICOM"
    )


def _open_xml(path: Path) -> ET.Element:
    """Parse an XML file without following anything; tags have no namespace.

    A document type is ignored, entities are refused, nothing else is opened.
    """
    from ecgdatakit.exceptions import ECGDataKitError
    from ecgdatakit.parsing.helpers.xml import parse_xml_root

    content = path.read_bytes() if path.stat().st_size <= LARGEST_XML else None
    # every element, and every attribute, has such a byte in every encoding the parser knows
    if content is None or content.count(b"<") + content.count(b"=") > MOST_MARKS:
        raise InputError(
            f"{path}: XML of {path.stat().st_size / 2**20:.0f} MB is not opened; export 10 s, "
            "which take about 1 MB"
        )
    with refuse_damaged(path, "XML", ECGDataKitError, ET.ParseError):
        root: ET.Element = parse_xml_root(content)
        return root


def _read_aecg(path: Path, root: ET.Element, options: ReadOptions) -> RawRecording:
    from ecgdatakit.parsing.parsers.hl7_aecg import HL7aECGParser

    subjects = []
    for subject in root.iter("trialSubject"):
        identity = subject.find("id")
        number = () if identity is None else (identity.get("root"), identity.get("extension"))
        subjects.append((*number, _text(subject.find(".//name"))))
    _check_one(path, "subjects", subjects)
    record, remarks = _parse(HL7aECGParser, path)
    rate = float(record.raw_metadata["rhythm_time"]["sampling_rate_exact"])
    return _raw_recording(path, record, options.agreed_rate(path, rate), "HL7 aECG", remarks)


def _read_muse(path: Path, root: ET.Element, options: ReadOptions) -> RawRecording:
    from ecgdatakit.parsing.parsers.ge_muse_xml import GEMuseXMLParser

    if len(list(root.iter(root.tag))) > 1:
        raise InputError(f"{path}: holds several recordings; give a file of one")
    _check_one(
        path, "patients", (_child(found, "PatientID") for found in root.iter("PatientDemographics"))
    )
    # programs other than MUSE write 0 for every checksum
    checksums = any(_text(element).strip("0") for element in root.iter("LeadDataCRC32"))
    record, remarks = _parse(GEMuseXMLParser, path, checksums)
    for tag in _OFFSETS:
        offsets = {lead.label: _number(lead.annotations.get(tag, "0")) for lead in record.leads}
        if len(set(offsets.values())) > 1:
            late = max(offsets, key=lambda name: abs(offsets[name]))
            raise InputError(
                f"{path}: {tag} of lead {late} is {offsets[late]:g}, not that of the other leads; "
                "export all leads over the same time"
            )
    off = [lead.label for lead in record.leads if "LeadOff" in lead.annotations]
    remarks += [f"lead off: {', '.join(off)}"] if off else []
    # of the rhythm, not rounded to an integer as the library does
    waves = root.findall("Waveform")
    rhythm = next(w for w in waves if _child(w, "WaveformType").lower() in ("rhythm", ""))
    base, exponent = _number(_child(rhythm, "SampleBase")), _child(rhythm, "SampleExponent")
    rate = options.agreed_rate(path, float(base * 10 ** _number(exponent or "0")))
    return _raw_recording(path, record, rate, "GE MUSE XML", remarks)


def read_scp(path: Path, options: ReadOptions) -> RawRecording:
    """Read an SCP-ECG file, as `read_xml` does; leads that start later than others are NaN before.

    References
    ----------
    EN 1064:2005+A1:2007 (ISO 11073-91064).
    """
    from ecgdatakit.parsing.parsers.scp_ecg import SCPECGParser

    data = path.read_bytes()
    with refuse_damaged(path, "SCP-ECG"):
        (size,) = struct.unpack_from("<I", data, 2)
    if data[size:].strip(b"\0"):
        raise InputError(
            f"{path}: {len(data) - size} bytes follow its record; give a file of one recording"
        )
    record, remarks = _parse(SCPECGParser, path)
    compression = record.recording.acquisition.signal.compression
    remarks += [f"compression: {compression}"] if compression != "none" else []
    together = record.raw_metadata["simultaneous_leads"]
    if 0 < together < len(record.leads):
        remarks.append(f"{together} of {len(record.leads)} leads are said to be simultaneous")
    rate = _MICROSECONDS / record.raw_metadata["rhythm_sample_interval_us"]
    return _raw_recording(path, record, options.agreed_rate(path, rate), "SCP-ECG", remarks)


def _parse(parser: Any, path: Path, checksums: bool = True) -> tuple[Any, list[str]]:
    """Run one parser; return its record and its warnings, of which failed checksums are errors."""
    from ecgdatakit.exceptions import ChecksumWarning, ECGDataKitError, UnsupportedFormatError

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            record = parser().parse(path)
    except UnsupportedFormatError as error:
        raise InputError(
            f"{path}: cannot be read ({_reason(error, path)}); export it without compression, or "
            "as HL7 aECG or DICOM"
        ) from error
    except (ECGDataKitError, *LIBRARY_ERRORS) as error:
        raise InputError(
            f"{path}: damaged file ({_reason(error, path)}); export it again"
        ) from error
    remarks = []
    for warning in caught:
        reason = _reason(warning.message, path)
        if not issubclass(warning.category, ChecksumWarning):
            remarks.append(reason)
        elif checksums:
            raise InputError(
                f"{path}: its checksum does not fit its content ({reason}), so the file is "
                "damaged; export it again"
            )
    return record, remarks


def _reason(error: object, path: Path) -> str:
    """Return one short line about an error or a warning; the file is named elsewhere."""
    text = str(error)
    for word in (" in ", " of "):
        text = text.replace(f"{word}{path}", "").replace(f"{word}{path.name}", "")
    return one_line(text).rstrip(".")


def _raw_recording(
    path: Path, record: Any, rate: float, kind: str, remarks: Sequence[str]
) -> RawRecording:
    """Turn a record into channels over one common time."""
    provenance = {"parser": f"ecgdatakit {version('ecgdatakit')}"}
    if remarks:
        provenance["remarks"] = "; ".join(remarks)
    channels = [_channel(path, lead) for lead in record.leads]
    starts = [int(lead.annotations.get("start_sample", 1)) for lead in record.leads]
    found = record.recording.acquisition.filters
    filters = (_frequency(f) for f in (found.highpass, found.lowpass, found.notch))
    return RawRecording(_placed(channels, starts), rate, kind, Filters(*filters), provenance)


def _channel(path: Path, lead: Any) -> Channel:
    """Turn the digits of a lead into physical values; channels that are no leads stay digits."""
    # the library adds a number to a repeated name; without it, the name shows as one
    first, _, number = lead.label.rpartition("_")
    name = first if first and number.isdigit() else lead.label
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


def _placed(channels: Sequence[Channel], starts: Sequence[int]) -> list[Channel]:
    """Put every lead where it starts on the common time axis; NaN where it has no samples."""
    leads = [k for k, channel in enumerate(channels) if lead_name(channel.name) is not None]
    placed = list(channels)
    if len({starts[k] for k in leads}) > 1:
        first = min(starts[k] for k in leads)
        n = max(starts[k] + len(channels[k].values) for k in leads) - first
        for k in leads:
            placed[k] = channels[k].placed(starts[k] - first, n)
    return placed


def _frequency(value: float | None) -> float | None:
    """Return a frequency (Hz), or None where the file states none that can be."""
    return value if value is not None and math.isfinite(value) and value > 0 else None


def _check_one(path: Path, what: str, found: Iterable[object]) -> None:
    """Refuse more than one person, without naming any."""
    number = len(set(found))
    if number > 1:
        raise InputError(f"{path}: belongs to {number} different {what}; give a file of one")


def _child(element: ET.Element, tag: str) -> str:
    """Text of a child, whatever the case of its tag."""
    return next((_text(child) for child in element if child.tag.lower() == tag.lower()), "")


def _text(element: ET.Element | None) -> str:
    return "" if element is None else " ".join("".join(element.itertext()).split())


def _number(text: str) -> float:
    """Return a number as the parser reads it, with a comma for a point; 0 where there is none."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return 0.0
