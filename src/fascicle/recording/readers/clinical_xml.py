"""What must hold of a clinic's XML file before, and besides, what its parser looks at."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fascicle.core.errors import InputError
from fascicle.recording.readers.names import first_line

LARGEST_XML = 64 * 2**20  # bytes; 30 min of 12 leads at 500 Hz, in digits
MOST_MARKS = 1_000_000  # tags and attributes; a 10 s recording has some 5000
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
# Whether leads begin together; their meaning is not published, but it is one for all leads or none
_OFFSETS = ("LeadTimeOffset", "LeadOffsetFirstSample")


def open_xml(path: Path) -> ET.Element:
    """Parse an XML file without following or expanding anything; tags have no namespace.

    Parameters
    ----------
    path : Path
        The file. A document type is ignored, entities are refused, nothing else is opened.

    Returns
    -------
    xml.etree.ElementTree.Element
        The root.

    Raises
    ------
    InputError
        When it is too large, not XML, or declares entities.
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
    try:
        root: ET.Element = parse_xml_root(content)
    except (ECGDataKitError, ET.ParseError, ValueError, LookupError) as error:
        raise InputError(
            f"{path}: not a readable XML file ({first_line(error)[:160]}); export it again"
        ) from error
    return root


def check_aecg(path: Path, root: ET.Element) -> None:
    """Refuse an HL7 aECG of several subjects, or whose times contradict each other."""
    subjects = (
        (*_attributes(subject.find("id"), "root", "extension"), _text(subject.find(".//name")))
        for subject in root.iter("trialSubject")
    )
    _check_one(path, "subjects", subjects)
    for sequences in root.findall("component/series/component/sequenceSet")[:1]:
        steps = [
            _attributes(sequence.find("value/increment"), "value", "unit")
            for sequence in sequences.findall("component/sequence")
            if _attributes(sequence.find("code"), "code")[0].upper().startswith("TIME_")
        ]
        seconds = {round(_number(value) * _SECONDS.get(unit, 0.0), 9) for value, unit in steps}
        if len(seconds) > 1:
            found = ", ".join(" ".join(step) for step in steps)
            raise InputError(
                f"{path}: {len(seconds)} different sampling steps of the same leads ({found}); "
                "export it again with one"
            )


def check_muse(path: Path, root: ET.Element) -> None:
    """Refuse a MUSE file of several recordings or patients."""
    if len(list(root.iter(root.tag))) > 1:
        raise InputError(f"{path}: holds several recordings; give a file of one")
    patients = (
        _child(demographics, "PatientID") for demographics in root.iter("PatientDemographics")
    )
    _check_one(path, "patients", patients)


def muse_sampling_rate(root: ET.Element) -> float:
    """Sampling rate (Hz) of the rhythm as the file states it, not rounded to an integer."""
    rhythm = next(
        waveform
        for waveform in root.findall("Waveform")
        if _child(waveform, "WaveformType").lower() in ("rhythm", "")
    )
    base = _number(_child(rhythm, "SampleBase"))
    return float(base * 10 ** _number(_child(rhythm, "SampleExponent") or "0"))


def has_checksums(root: ET.Element) -> bool:
    """Whether a MUSE file has checksums; programs other than MUSE write 0 into every lead."""
    return any(_text(element).strip("0") for element in root.iter("LeadDataCRC32"))


def check_simultaneous(path: Path, leads: Sequence[Any]) -> None:
    """Refuse MUSE leads of which some begin later than others."""
    for tag in _OFFSETS:
        offsets = {lead.label: _number(lead.annotations.get(tag, "0")) for lead in leads}
        if len(set(offsets.values())) > 1:
            late = max(offsets, key=lambda name: abs(offsets[name]))
            raise InputError(
                f"{path}: {tag} of lead {late} is {offsets[late]:g}, not that of the other leads; "
                "export all leads over the same time"
            )


def leads_off(leads: Sequence[Any]) -> list[str]:
    """Say which leads a MUSE recorder found to be off the skin."""
    off = [lead.label for lead in leads if "LeadOff" in lead.annotations]
    return [f"lead off: {', '.join(off)}"] if off else []


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


def _attributes(element: ET.Element | None, *names: str) -> tuple[str, ...]:
    return tuple("" if element is None else element.get(name, "").strip() for name in names)


def _number(text: str) -> float:
    """Return a number as the parser reads it, with a comma for a point; 0 where there is none."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return 0.0
