"""Files whose samples are certain although a writer deviates from the standard of its format.

ecgdatakit refuses such files and gets a copy in which the deviation is mended; a remark says so.
"""

from __future__ import annotations

import base64
import binascii
import re
import struct
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator
from pathlib import Path

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.names import PER_SECOND, lead_name, plain_unit

NO_RHYTHM = "the file holds no rhythm but an averaged beat, which is read"
UNKNOWN_RATE = 1.0  # Hz; what stands for a rate that the file does not state


def mended(data: bytes) -> tuple[bytes, ET.Element | None, list[str]]:
    """File as ecgdatakit accepts it, its root if it is XML, and a remark on each deviation."""
    content, remarks = data, list[str]()
    if data[16:22] == b"SCPECG":
        content, remarks = _mended_scp(data)
    elif data[:8].strip(b" \0") == b"0" and data[252:256].strip(b" \0").isdigit():
        content, remarks = _mended_edf(data)
    elif data.lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n\0").startswith(b"<"):
        return _mended_xml(data)
    return content, None, remarks


def _point(number: str) -> str:
    """Number with a point for its decimal comma; 2,500 stays as it is, since it may be 2500."""
    ambiguous = re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", number)
    return number if ambiguous or "." in number else number.replace(",", ".", 1)


def _mended_edf(data: bytes) -> tuple[bytes, list[str]]:
    """EDF with blanks, points and whole numbers where its header must have them."""
    n = int(data[252:256].strip(b" \0"))
    if len(data) < 256 * (n + 1):
        return data, []
    head = bytearray(data[: 256 * (n + 1)].replace(b"\0", b" "))
    remarks: list[str] = []
    ends = [(256 + offset * n, 8 * n) for offset in (104, 112, 120, 128, 216)]
    places = [(place, k >= 2) for k, (at, size) in enumerate(ends)
              for place in range(at, at + size, 8)]  # fmt: skip
    for at, is_integer in [(184, True), (236, True), (244, False), *places]:
        text = head[at : at + 8].decode("latin-1").strip()
        new = _point(text) or ("-1" if at == 236 else "")  # -1: number of records not stated
        new = re.sub(r"\.0*$", "", new) if is_integer else new
        head[at : at + 8] = new.encode("latin-1").ljust(8)
        if new != text:
            remarks = [f"deviates from EDF: '{printable(text)}' in its header is read as {new}"]
    return bytes(head) + data[len(head) :], remarks


def _mended_xml(data: bytes) -> tuple[bytes, ET.Element | None, list[str]]:
    """Well-formed XML that holds the rhythm alone or, in its place, an averaged beat."""
    from ecgdatakit.exceptions import ECGDataKitError
    from ecgdatakit.parsing.helpers.xml import parse_xml_root

    remarks: list[str] = []
    try:
        root: ET.Element = parse_xml_root(data)
    except ECGDataKitError:
        return data, None, []
    except ET.ParseError as error:
        try:
            root = parse_xml_root(_well_formed(data))
        except (ET.ParseError, ECGDataKitError):
            return data, None, []
        remarks.append(f"is not well-formed XML ({error}), but its samples are")
    parents = {child: parent for parent in root.iter() for child in parent}
    for notes in list(root.iter("annotationSet")):
        parents[notes].remove(notes)
    rhythms, averaged = _waves(root)
    if rhythms:
        for beat in averaged:
            parents[beat].remove(beat)
    elif averaged:
        beat, dummy = averaged[0], {"dataencoding": "Plain", "durationperchannel": "4"}
        if beat.tag == "Waveform":
            beat.find("WaveformType").text = "Rhythm"  # type: ignore[union-attr]
        elif beat.tag == "series":
            beat.find("code").set("code", "RHYTHM")  # type: ignore[union-attr]
        elif beat.tag == "repbeats":  # Philips XML keeps it apart, and needs a rhythm
            rhythm = ET.SubElement(parents[beat], "parsedwaveforms", dummy | {"leadlabels": "I"})
            rhythm.text = "0 " * 100
        remarks.append(NO_RHYTHM)
    for sequences in root.iter("sequenceSet"):
        remarks += _mend_aecg(sequences)
    for lead in root.iter("LeadData"):
        remarks += _mend_muse(lead)
    for wave in root.findall("Waveform"):
        if wave.find("SampleBase") is None:
            ET.SubElement(wave, "SampleBase").text = f"{UNKNOWN_RATE:g}"
    return ET.tostring(root), root, list(dict.fromkeys(remarks))


def _well_formed(data: bytes) -> bytes:
    """XML without faults of encoding, comments or trailing text, which hold no samples."""
    wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    text = data.decode("utf-16" if wide else "utf-8", "replace")
    text = re.sub(r"<\?xml.*?\?>|<!--.*?-->|[\0-\x08\x0b\x0c\x0e-\x1f]", "", text, flags=re.DOTALL)
    text = re.sub(r"&(?!#?\w{1,20};)", "&amp;", text[: text.rfind(">") + 1])
    # prefixes that no namespace is declared for
    return re.sub(r"(</?|\s)(?!xmlns:)\w{1,20}:(?=[A-Za-z])", r"\1", text).encode()


def _waves(root: ET.Element) -> tuple[list[ET.Element], list[ET.Element]]:
    """Elements that hold a rhythm, and those that hold averaged beats."""
    if root.tag == "restingecgdata":  # Philips
        return list(root.iter("parsedwaveforms")), list(root.iter("repbeats"))
    if root.tag == "ECG":  # Mortara
        return list(root.iter("CHANNEL")), list(root.iter("TYPICAL_CYCLE"))
    waves: list[ET.Element] = root.findall("Waveform")  # MUSE
    kinds = [(wave.findtext("WaveformType") or "").strip().lower() for wave in waves]
    if root.tag == "AnnotatedECG":
        waves = root.findall("component/series")
        codes = [wave.find("code") for wave in waves]
        kinds = ["" if code is None else code.get("code", "").lower() for code in codes]
    averaged = [kind in ("median", "representative_beat") for kind in kinds]
    of_kind = [[w for w, flag in zip(waves, averaged, strict=True) if flag == a] for a in (0, 1)]
    return of_kind[0], [*of_kind[1], *root.iter("derivation")]


def _mend_aecg(sequences: ET.Element) -> list[str]:
    """Rename leads and units to those of HL7 aECG, and add a rate, unknown if it is missing."""
    remarks, steps = [], list(sequences.iter("increment"))
    for number in [*steps, *sequences.iter("scale"), *sequences.iter("origin")]:
        text = number.get("value", "")
        if (new := _point(text)) != text:
            number.set("value", new)
            mend = f"'{printable(text[:40])}' is read as {new[:40]}"
            remarks.append(f"deviates from HL7 aECG: {mend}")
    for code in sequences.iterfind("component/sequence/code"):
        if lead := lead_name(code.get("code", "")):
            code.set("code", f"MDC_ECG_LEAD_{lead.upper()}")
    for step in steps:
        per_second = PER_SECOND.get(plain_unit(step.get("unit", "")), 0.0)
        step.set("unit", {1.0: "s", 1e3: "ms", 1e6: "us"}.get(per_second, ""))
    if not any(step.get("unit") and step.get("value") for step in steps):
        increment = f'<increment value="{1 / UNKNOWN_RATE:g}" unit="s"/>'
        sequence = f'<sequence><code code="TIME_RELATIVE"/><value>{increment}</value></sequence>'
        sequences.insert(0, ET.fromstring(f"<component>{sequence}</component>"))  # the first counts
    return remarks


def _mend_muse(lead: ET.Element) -> list[str]:
    """Pad Base64 data to complete groups; if the checksum is right, correct the stated counts."""
    data = lead.find("WaveFormData")
    if data is None:
        return []
    text = "".join((data.text or "").split())
    data.text = text + "=" * (-len(text) % 4)
    try:
        samples = base64.b64decode(data.text, validate=True)
    except binascii.Error:
        return []
    if (lead.findtext("LeadDataCRC32") or "").strip() != str(zlib.crc32(samples)):
        return []
    remarks = []
    for tag, count in (
        ("LeadByteCountTotal", len(samples)),
        ("LeadSampleCountTotal", len(samples) // int(lead.findtext("LeadSampleSize") or 2)),
    ):
        stated = lead.find(tag)
        if stated is not None and (stated.text or "").strip() != str(count):
            stated.text = str(count)
            remarks.append(f"deviates from MUSE XML: {tag} is wrong, checksums are right")
    return remarks


def wfdb_lines(header: Path) -> list[list[str]]:
    """Words of the lines of a WFDB header that are no comments."""
    text = header.read_text("latin-1").removeprefix("\xef\xbb\xbf")
    return [line.split() for line in text.splitlines() if line.strip() and line.strip()[0] != "#"]


def mended_wfdb(header: Path) -> tuple[str, list[Path], list[str]]:
    """Header of one segment in standard WFDB, the signal files that it names, and remarks.

    A signal file is the one in the header's folder of that name, whatever its case and the folder
    in the header; or the one named like the header, where the header names a single file.
    """
    record, *signals = wfdb_lines(header)
    time, date = r"\d\d?(:\d\d?){0,2}(\.\d*)?", r"\d\d?/\d\d?/\d{4}"
    new = [header.stem, record[1], *(re.sub("(?i)hz$", "", rate) for rate in record[2:3])]
    right = all(map(re.fullmatch, (time, date), record[4:6]))
    lines, files = [new + record[3 : 6 if right else 4]], []
    for signal in signals:
        files.append(_signal_file(header, signal[0], len({line[0] for line in signals}) == 1))
        gain = re.sub(r"^[-+\d]+,\d+", lambda number: _point(number[0]), "".join(signal[2:3]))
        gain = re.sub(r"(/[^\s(]+)(\([^)]*\))$", r"\2\1", gain)
        gain = re.sub(r"(?<=\d)\.0*(?=\))", "", gain)
        integers = [re.sub(r"(?<=\d)\.0*$", "", number) for number in signal[3:8]]
        lines.append(
            [files[-1].name, *signal[1:2], *[gain][: len(signal) - 2], *integers, *signal[8:]]
        )
    words = [pair for old, new in zip([record, *signals], lines, strict=True)
             for pair in zip(old, new, strict=False)]  # fmt: skip
    changed = {written: repaired for written, repaired in words[1:] if written != repaired}
    remarks = [
        f"'{printable(written)}' in its header is read as {repaired}"
        for written, repaired in changed.items()
    ]
    if not right:
        remarks.append(f"'{printable(' '.join(record[4:]))}' is left out, it is no time and date")
    remarks = [f"deviates from WFDB: {remark}" for remark in remarks]
    return "\n".join(map(" ".join, lines)) + "\n", files, remarks


def _signal_file(header: Path, name: str, alone: bool) -> Path:
    base_name = re.split(r"[\\/]", name)[-1]
    files = sorted(header.parent.iterdir(), key=lambda file: file.name != base_name)
    alike = [file for file in files if file.name.casefold() == base_name.casefold()]
    alike += [header.with_suffix(Path(base_name).suffix)] * alone
    if not Path(base_name).suffix:  # left out, as by tools of the PhysioNet challenges
        alike += [file for file in files if file.stem == base_name and file.suffix == ".mat"]
    signal_file = next((file for file in alike if file.is_file() and file != header), None)
    if signal_file is None:
        raise InputError(
            f"{header}: names '{printable(name[:40])}', which is no file in its folder; put all "
            "files of the record in one folder"
        )
    return signal_file


def _mended_scp(data: bytes) -> tuple[bytes, list[str]]:
    """SCP-ECG with sample ranges that count from 1, and only the sections that samples need.

    Its stated size is at most that of the file, and section 5 replaces a missing section 6.
    """
    content, remarks = bytearray(data), []
    right = {place for place, stated, computed in scp_checksums(data) if stated == computed}
    # section: its pointer, its first byte and length
    sections = {number: places for number, *places in _scp_sections(data)}
    entries = {number: pointer for number, (pointer, _, _) in sections.items()}
    places = {number: (start, n) for number, (_, start, n) in sections.items() if n > 0}
    if 3 not in places:
        return data, []
    if int.from_bytes(data[2:6], "little") > len(data):
        struct.pack_into("<I", content, 2, len(data))
        remarks.append("deviates from SCP-ECG: the size of the record is stated wrongly")
    dropped = [number for number in places if number > 6]
    leads = range(places[3][0] + 18, places[3][0] + 18 + 9 * data[places[3][0] + 16], 9)
    if 6 not in places and 6 in entries and {4, 5} <= set(places):
        start, length = places[5]
        beat = int.from_bytes(data[places[4][0] + 16 :][:2], "little")  # ms
        interval = int.from_bytes(data[start + 18 :][:2], "little")  # us
        struct.pack_into("<H", content, start + 2, 6)
        for lead in leads:
            struct.pack_into("<II", content, lead, 1, round(1000 * beat / interval))
        content[places[3][0] + 17] &= 0xFE  # flag: no reference beat was subtracted
        struct.pack_into("<HII", content, entries[6], 6, length, start + 1)
        dropped += [4, 5]
        remarks.append(NO_RHYTHM)
    elif min(firsts := [int.from_bytes(data[at : at + 4], "little") for at in leads]) == 0:
        if 1 in firsts:  # some ranges count from 0, some from 1
            return data, []
        for lead, first in zip(leads, firsts, strict=True):
            struct.pack_into("<I", content, lead, first + 1)
        remarks.append(
            "deviates from SCP-ECG: its sample ranges count from 0; the last sample may be left out"
        )
    for number in dropped:
        struct.pack_into("<II", content, entries[number] + 2, 0, 0)
    # checksums that were right are set right again, that of the whole record last
    for place, _, _ in reversed(list(scp_checksums(data))):
        sums = {at: computed for at, _, computed in scp_checksums(bytes(content))}
        if place in right and place in sums:
            struct.pack_into("<H", content, place, sums[place])
    return bytes(content), remarks


def samples_are_right(source_format: str, data: bytes, root: ET.Element | None) -> bool:
    """True if all checksums of the samples are right; a checksum of 0 was not written."""
    if source_format == "ge_muse_xml" and root is not None:
        return not any((sum_.text or "").strip().strip("0") for sum_ in root.iter("LeadDataCRC32"))
    if source_format != "scp_ecg":
        return source_format == "ishne_holter" and data[8:10] == bytes(2)
    sections = (0, 2, 3, 4, 5, 6)  # sections that samples depend on
    samples = {start for number, _, start, n in _scp_sections(data) if n and number in sections}
    return all(
        stated in (0, computed)
        for place, stated, computed in scp_checksums(data)
        if place in samples
    )


def scp_checksums(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Place, stated and computed value of each checksum: of the record, then of each section."""
    spans = [(0, int.from_bytes(data[2:6], "little"))]
    spans += [(start, length) for _, _, start, length in _scp_sections(data) if length > 0]
    for start, length in spans:
        stated = int.from_bytes(data[start : start + 2], "little")
        yield start, stated, binascii.crc_hqx(data[start + 2 : start + length], 0xFFFF)


def _scp_sections(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Number, place of the pointer, first byte and length of the sections; those absent have 0."""
    length = int.from_bytes(data[10:14], "little")
    yield 0, 0, 6, length
    for pointer in range(22, min(6 + length, len(data)) - 9, 10):
        number, size, index = struct.unpack_from("<HII", data, pointer)
        if number and index - 1 + size <= len(data):
            yield number, pointer, max(index - 1, 0), size
