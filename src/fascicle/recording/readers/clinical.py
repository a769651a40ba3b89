"""Formats read by ecgdatakit: HL7 aECG, MUSE, Philips, Mortara, SCP-ECG, ISHNE, MFER, EDF, WFDB.

Its samples are those of wfdb and edfio. This module does the rest: files beyond the folder of a
WFDB header, samples that are marked invalid, leads without a scale, exact rates.
"""

from __future__ import annotations

import contextlib
import math
import re
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, one_line, printable
from fascicle.recording.readers import writer_deviations as deviations
from fascicle.recording.readers.names import lead_name
from fascicle.recording.readers.read import Channel, RawRecording, narrowest_passband, sha256_of
from fascicle.recording.recording import Filters


def read_clinical(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read a file of any format that ecgdatakit knows by its content.

    A lead without a scale is refused whatever the user says its unit is. Leads that start later
    than others (SCP-ECG) are NaN before.
    """
    from ecgdatakit.parsing.parser import FileParser

    data = path.read_bytes()
    content, root, mends = deviations.mended(data)
    if root is not None and root.tag.endswith(("SchillerEDI", "CardiologyXML")):
        return _decimal_xml(path, root)
    with _copy(path, {path.name: content} if content != data else {}) as copy:
        detected = FileParser.detect_format(path) or FileParser.detect_format(copy)
        if detected is None:
            raise InputError(
                f"{path}: damaged, or of a kind that is not read; export it as HL7 aECG or DICOM"
            )
        record, remarks, wrong = _parsed(detected["parser_class"], path, copy)
    if deviations.NO_RHYTHM in mends and record.median_beats:
        record.leads = record.median_beats
    remarks += [*mends, *_check_one_recording(record.source_format, path, data, root)]
    if wrong and not deviations.samples_are_right(record.source_format, data, root):
        raise InputError(f"{path}: damaged, a checksum is wrong ({wrong[0]}); export it again")
    if wrong and record.source_format == "scp_ecg":
        remarks.append(f"checksums differ, but not those of the samples ({wrong[0]})")
    leads = [lead for lead in record.leads if _standard_name(lead) is not None]
    for tag in ("LeadTimeOffset", "LeadOffsetFirstSample"):  # tags of MUSE whose unit is unknown
        if len({lead.annotations.get(tag) for lead in leads}) > 1:
            raise InputError(f"{path}: {tag} differs between leads; export all over the same time")
    off = [lead.label for lead in leads if "LeadOff" in lead.annotations]
    remarks += [f"lead off: {', '.join(off)}"] if off else []
    return RawRecording(
        _channels(record, path),
        _rate(record, leads, root),
        detected["name"],
        _filters(record, leads),
        provenance={"parser": f"ecgdatakit {version('ecgdatakit')}"},
        remarks=tuple(remarks),
    )


def _decimal_xml(path: Path, root: ET.Element) -> RawRecording:
    """Rhythm leads of XML in decimal digits, of Schiller (SEMA, AT-10, CS-200) and CardioSoft."""
    cardiosoft = root.tag == "CardiologyXML"
    waves = list(root.iter("StripData" if cardiosoft else "wavedata"))
    waves = [wave for wave in waves if wave.findtext("type") in (None, "ECG_RHYTHMS")]
    if len(waves) != 1:
        raise InputError(f"{path}: holds {len(waves)} rhythms; give a file of one")
    (wave,) = waves
    if cardiosoft:
        tags = ["SampleRate", "Resolution"]
        units = [element.get("units", "") for element in wave.iterfind("Resolution")]
        texts = {lead.get("lead"): lead.text or "" for lead in wave.iter("WaveformData")}
    else:
        tags = ["resolution/samplerate/value", "resolution/yres/unitperbit"]
        units = [wave.findtext("resolution/yres/units", "").replace("UV", "uV").replace("MV", "mV")]
        texts = {lead.findtext("name"): lead.findtext("data", "") for lead in wave.iter("channel")}
    try:
        rate, step = (float(wave.findtext(tag, "")) for tag in tags)
        digits = {
            n: np.array(text.strip(" ,\t\r\n").split(","), float) for n, text in texts.items()
        }
    except ValueError as error:
        raise InputError(f"{path}: damaged ({one_line(error)}); export it again") from None
    if (exponent := wave.findtext("resolution/samplerate/exponent", "1")) != "1":
        raise InputError(f"{path}: a rate of {rate:g}, exponent {printable(exponent)}, is not read")
    unit = units[0].removesuffix("perLsb")
    channels = [Channel(str(n), step * x, unit, gain=1 / step) for n, x in digits.items()]
    return RawRecording(channels, rate, f"{'CardioSoft' if cardiosoft else 'Schiller'} XML")


@contextlib.contextmanager
def _copy(path: Path, contents: Mapping[str, bytes]) -> Iterator[Path]:
    """Copy of a file, and of those that it names, with new contents; without these, the file."""
    if not contents:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        for name, content in contents.items():
            (Path(folder) / name).write_bytes(content)
        yield Path(folder) / path.name


def _parsed(parser: Any, path: Path, copy: Path) -> tuple[Any, list[str], list[str]]:
    """Run one parser; return its record, its warnings, and those that a checksum is wrong."""
    from ecgdatakit.exceptions import ChecksumWarning, ECGDataKitError, UnsupportedFormatError

    def reason(error: object) -> str:
        """Text of an error in one short line, without the name of the file."""
        file = f" (in|of) ({re.escape(str(copy))}|{re.escape(path.name)})"
        return one_line(re.sub(file, "", str(error)))

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            record = parser().parse(copy)
        except UnsupportedFormatError as error:
            raise InputError(
                f"{path}: cannot be read ({reason(error)}); export it without compression, or as "
                "HL7 aECG or DICOM"
            ) from error
        except ECGDataKitError as error:
            raise InputError(f"{path}: damaged file ({reason(error)}); export it again") from error
    # warnings that concern no sample: dates, rounding of the library, averaged beats of SCP-ECG
    technical = (
        "is not an integer; rounded|birth date|measurement time|long-term rhythm|tag length|"
        "median beat"
    )
    remarks: list[str] = []
    wrong: list[str] = []
    for warning in caught:
        is_checksum = issubclass(warning.category, ChecksumWarning)
        text = re.sub(r";? ?\(?(see )?raw_metadata.*", "", reason(warning.message))
        if is_checksum or not re.search(technical, text):
            (wrong if is_checksum else remarks).append(text)
    for remark in remarks:  # a truncated EDF file is read: its whole records are right
        if re.search("(may be|are) truncated|has gaps|shorter than the frame", remark):
            raise InputError(f"{path}: incomplete recording ({remark}); export it again")
    return record, remarks, wrong


def _check_one_recording(
    source_format: str, path: Path, data: bytes, root: ET.Element | None
) -> list[str]:
    """Refuse files of several subjects or recordings, of which the library reads only the first.

    Bytes after an SCP-ECG record that are no other record are left out; a remark says so.
    """
    several, remarks = "", []
    if source_format == "scp_ecg":
        trailing = data[int.from_bytes(data[2:6], "little") :]  # after what is stated as its size
        if trailing[16:22] == b"SCPECG":
            several = f"{len(trailing)} bytes follow the first one"
        elif trailing.strip(b"\0"):
            remarks = [f"{len(trailing)} bytes after the end of the record are left out"]
    elif root is not None:
        elements = list(root.iter())
        nested = sum(element.tag.lower() == "restingecg" for element in elements)
        named = ("trialSubject", "PatientDemographics")
        people = set()
        for person in (element for element in elements if element.tag in named):
            identity = (person.find(tag) for tag in ("id", "PatientID", ".//name"))
            parts = [part for part in identity if part is not None]
            words = " ".join(text for p in parts for text in (*p.attrib.values(), *p.itertext()))
            people.add(" ".join(words.split()))
        if nested > 1:
            several = f"{nested} RestingECG elements"
        elif len(people) > 1:
            several = f"they belong to {len(people)} different people"
    if several:
        raise InputError(f"{path}: holds several recordings ({several}); give a file of one")
    return remarks


def _standard_name(lead: Any) -> str | None:
    """Name of the lead of a label such as ``V1-WCT``, or ``II_2`` where II is there twice."""
    # EDF+ may name the reference: of chest leads Wilson's terminal, which makes them unipolar
    label = re.sub("(?<=V[1-6])-(WCT|Wilson)$|-Ref$", "", lead.label, flags=re.IGNORECASE)
    return lead_name(label) or lead_name(re.sub(r"_\d+$", "", label))


def _channels(record: Any, path: Path) -> list[Channel]:
    """Channels, in physical units if these are stated, on a common time axis."""
    channels, starts = [], []
    for lead in record.leads:
        name, standard = printable(lead.label), _standard_name(lead)
        digits = np.array(lead.samples, dtype=np.float64)
        # `resolution` is a guess of 1 where there is none
        ends, calibrated = lead.annotations, lead.adc_resolution > 0
        if "digital_minimum" in ends:  # EDF, whose physical range may run downward
            calibrated = int(ends["digital_minimum"]) < int(ends["digital_maximum"])
            calibrated &= ends["physical_minimum"] != ends["physical_maximum"]
        calibrated &= math.isfinite(lead.resolution) and lead.resolution != 0
        if not calibrated and (standard is None or np.ptp(digits) == 0):  # 0: not recorded
            channels.append(Channel(name, digits))
            continue
        if not calibrated:
            raise InputError(
                f"{path}: unknown amplitude of lead {standard} (its scale is "
                f"{lead.adc_resolution:g}); export the recording with the amplitude of one digit"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # infinite samples are refused as gaps
            values = lead.resolution * digits + lead.offset
        is_ishne = record.source_format == "ishne_holter"  # its lowest value marks invalid samples
        missing = (lead.resolution * -(2.0**15) + lead.offset,) if is_ishne else ()
        unit = printable(lead.resolution_unit or lead.adc_resolution_unit) or None
        channels.append(Channel(name, values, unit, standard, 1 / lead.resolution, missing))
        if standard is not None:
            starts.append(int(lead.annotations.get("start_sample", 1)))
    if len(set(starts)) < 2:
        return channels
    leads = [channel for channel in channels if channel.lead is not None]
    pairs = list(zip(leads, starts, strict=True))
    length = max(start + len(lead.values) for lead, start in pairs) - min(starts)
    placed = [lead.placed(start - min(starts), length) for lead, start in pairs]
    return placed + [channel for channel in channels if channel.lead is None]


def _rate(record: Any, leads: Sequence[Any], root: ET.Element | None) -> float | None:
    """Sampling rate (Hz), which the library rounds to an integer; None where it is a guess."""
    raw, first = record.raw_metadata, (leads or record.leads)[0]
    if not raw.get("sampling_rate_stated", True):
        return None
    if record.source_format == "hl7_aecg":
        rate = float(raw["rhythm_time"]["sampling_rate_exact"])
        return None if rate == deviations.UNKNOWN_RATE else rate
    if record.source_format == "scp_ecg":
        return float(1e6 / raw["rhythm_sample_interval_us"])
    if record.source_format == "mfer":
        return float(raw["sampling_rates"][record.leads.index(first)])
    if record.source_format == "ge_muse_xml" and root is not None:
        for waveform in root.findall("Waveform"):
            texts = {e.tag.lower(): "".join(e.itertext()).strip() for e in waveform}
            if texts.get("waveformtype", "").lower() in ("rhythm", ""):
                break
        base, exponent = (
            float(texts.get(tag, "").replace(",", ".") or 0)
            for tag in ("samplebase", "sampleexponent")
        )
        # a tenth is not exact: 4883 * 10**-1.0 is not 488.3
        power = math.pow(10, abs(exponent))
        rate = base * power if exponent > 0 else base / power
        return None if rate == deviations.UNKNOWN_RATE else rate
    return float(raw.get("exact_sampling_rates", {}).get(first.label, first.sampling_rate))


def _filters(record: Any, leads: Sequence[Any]) -> Filters:
    """Filters of the recorder; of EDF, which has them for each lead, the narrowest pass band."""
    if not record.source_format.startswith("edf"):
        filters = record.recording.acquisition.filters
        hz = (filters.highpass, filters.lowpass, filters.notch)
        return Filters(*(f if f is not None and 0 < f < math.inf else None for f in hz))
    bands: dict[str, list[float]] = {"HP": [], "LP": [], "N": []}
    # "HP:0.05Hz LP:150Hz N:50Hz"; a number with another unit than Hz is not understood
    stated = r"\b(HP|LP|N)(?:otch)?\s*:\s*(\d*[.,]?\d+)(?:\s*Hz\b|(?=\s*$|\s+(?:HP|LP|N)\w*\s*:))"
    for lead in leads:
        for kind, hertz in re.findall(stated, lead.prefiltering, re.IGNORECASE):
            bands[kind.upper()].append(float(hertz.replace(",", ".")))
    return narrowest_passband(bands["HP"], bands["LP"], bands["N"])


def read_wfdb(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read a record of one or several segments from its ``.hea`` header.

    Samples that a segment lacks, and those that are marked invalid, are NaN. Skewed signals are
    aligned, which shortens the record by the largest skew. A lead with four samples in a frame has
    four times the frame rate. A header without a rate means 250 Hz by the standard, but most such
    headers lost theirs. Checksums that disagree are in the provenance: many converters write wrong
    ones.

    References
    ----------
    G. B. Moody, WFDB Applications Guide, header(5) and signal(5), physionet.org.
    """
    from ecgdatakit.parsing.parsers.wfdb import WFDBParser

    remarks: list[str] = []
    contents: dict[str, bytes] = {}
    first, *lines = deviations.wfdb_lines(path) or [[""]]
    if "/" in first[0] and all(len(line) == 2 for line in lines):  # about segments
        files = _segment_files(path)
    else:
        text, named, remarks = deviations.mended_wfdb(path)
        files = sorted(set(named))
        if remarks:
            contents = {path.name: text.encode("latin-1")}
            contents |= {file.name: file.read_bytes() for file in files}
    with _copy(path, contents) as copy:
        record, _, wrong = _parsed(WFDBParser, path, copy)
    raw = record.raw_metadata
    units = {spec["description"]: spec["units"] for spec in raw["signal_specs"]}
    for segment in (file for file in files if file.suffix == ".hea"):
        # the library joins segments whatever their rates and units, and scales marks as samples
        part = _parsed(WFDBParser, segment, segment)[0].raw_metadata
        consistent = all(units.get(s["description"]) == s["units"] for s in part["signal_specs"])
        stated = part["sampling_frequency_stated"]
        consistent &= not stated or part["sampling_frequency"] == raw["sampling_frequency"]
        if not consistent or "invalid_sample_counts" in part:
            raise InputError(
                f"{path}: {segment.name} has another rate, other signals or units, or samples that "
                "are marked invalid; give one segment"
            )
    specs, skew = raw["signal_specs"], max(spec["skew"] for spec in raw["signal_specs"])
    channels, rate = [], raw["sampling_frequency"]
    for lead, spec in zip(record.leads, specs, strict=True):
        name = printable(spec["description"] or lead.label)
        digits = lead.samples[: len(lead.samples) - skew * spec["samples_per_frame"]]
        is_lead = lead_name(name) is not None
        if not spec["gain"] and (not is_lead or np.ptp(digits) == 0):  # 0: not recorded
            channels.append(Channel(name, digits))
            continue
        if not spec["gain"]:
            raise InputError(
                f"{path}: unknown unit, the gain of lead {name} is absent or 0; write the digits "
                "per mV as the third field of its line, such as 1000/mV"
            )
        values, unit = (digits - spec["baseline"]) / spec["gain"], printable(spec["units"])
        # invalid samples have the lowest value of the format
        marked = lead.label in raw.get("invalid_sample_counts", {})
        missing = (values[np.nanargmin(digits)],) if marked else ()
        channels.append(Channel(name, values, unit, gain=spec["gain"], missing=missing))
        if is_lead:
            rate = raw["sampling_frequency"] * spec["samples_per_frame"]
    names = ", ".join(file.name for file in files)
    provenance = {"signal_files": names, "signal_sha256": sha256_of(files)}
    # writers that do not compute checksums put 0
    unsummed = {spec["description"] for spec in specs if not spec["checksum"]}
    differ = [name for name in re.findall("'(.*?)'", "".join(wrong)) if name not in unsummed]
    if raw["checksum_valid"] or differ:
        agreement = f"differ for {', '.join(differ)}" if differ else "agree"
        provenance = {"checksums": agreement} | provenance
    if differ:
        remarks.insert(0, f"checksums of the file {agreement}: it may be damaged")
    stated = rate if raw["sampling_frequency_stated"] else None
    return RawRecording(channels, stated, provenance=provenance, remarks=tuple(remarks))


def _segment_files(header: Path) -> list[Path]:
    """Files of a record of segments, sorted; all must be in its folder."""
    files: set[Path] = set()
    for name in {line[0] for line in deviations.wfdb_lines(header)[1:]} - {"~"}:
        if re.search(r"[\\/]", name):
            raise InputError(
                f"{header}: names the segment '{printable(name[:40])}', which is not in its "
                "folder; put all files of the record in one folder"
            )
        part = header.with_name(f"{name}.hea")
        if not all(line[0] == "~" for line in deviations.wfdb_lines(part)[1:]):  # as in a layout
            files |= {part, *deviations.mended_wfdb(part)[1]}
    return sorted(files)
