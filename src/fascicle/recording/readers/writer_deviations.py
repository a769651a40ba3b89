"""Files whose samples are certain although a writer deviates from the standard of its format.

ecgdatakit refuses them; it is given a copy in which the deviation is mended. What was done is said.
"""

from __future__ import annotations

import binascii
import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator

NO_RHYTHM = "the file holds no rhythm but an averaged beat, which is read"
SCP_SAMPLES = (0, 2, 3, 4, 5, 6)  # sections of SCP-ECG that the samples rest on


def mended_xml(root: ET.Element) -> tuple[bytes, str] | None:
    """MUSE or HL7 aECG with only its rhythm, or with its averaged beat in the place of one."""
    if root.tag.lower() == "restingecg":
        waves = root.findall("Waveform")
        names = [wave.find("WaveformType") for wave in waves]
        averaged = [name is not None and (name.text or "").strip() == "Median" for name in names]
    elif root.tag == "AnnotatedECG":
        parents = [each for each in root.findall("component") if each.find("series") is not None]
        waves, names = parents, [each.find("series/code") for each in parents]
        averaged = [
            name is not None and name.get("code", "").upper() == "REPRESENTATIVE_BEAT"
            for name in names
        ]
    else:
        return None
    if not any(averaged):
        return None
    remark = "the averaged beat of the file is damaged; its rhythm is read"
    if all(averaged):
        name, remark = names[0], NO_RHYTHM
        assert name is not None  # it says that this is an averaged beat
        name.text = "Rhythm"
        name.set("code", "RHYTHM")
    else:
        for wave in (wave for wave, one in zip(waves, averaged, strict=True) if one):
            root.remove(wave)
    return ET.tostring(root), remark


def mended_scp(data: bytes) -> tuple[bytes, str] | None:
    """SCP-ECG whose sample ranges count from 1, with what is needed for its samples only.

    Its size is that of the file, and section 5 stands for a section 6 that is not there.
    """
    content, remarks = bytearray(data), []
    right = {place for place, stated, found in scp_checksums(data) if stated == found}
    # section: its pointer, its first byte and length
    sections = {number: places for number, *places in _scp_sections(data)}
    entries = {number: pointer for number, (pointer, _, _) in sections.items()}
    places = {number: (start, n) for number, (_, start, n) in sections.items() if n > 0}
    if 3 not in places:
        return None
    if int.from_bytes(data[2:6], "little") != len(data):
        struct.pack_into("<I", content, 2, len(data))
        remarks.append("the size of the record is stated wrongly")
    dropped = [number for number in places if number > 6]
    leads = range(places[3][0] + 18, places[3][0] + 18 + 9 * data[places[3][0] + 16], 9)
    if 6 not in places and 6 in entries and {4, 5} <= set(places):
        start, length = places[5]
        beat = int.from_bytes(data[places[4][0] + 16 :][:2], "little")  # ms
        interval = int.from_bytes(data[start + 18 :][:2], "little")  # us
        struct.pack_into("<H", content, start + 2, 6)
        for lead in leads:
            struct.pack_into("<II", content, lead, 1, round(1000 * beat / interval))
        content[places[3][0] + 17] &= 0xFE  # nothing was subtracted
        struct.pack_into("<HII", content, entries[6], 6, length, start + 1)
        dropped += [4, 5]
        remarks.append(NO_RHYTHM)
    elif min(firsts := [int.from_bytes(data[at : at + 4], "little") for at in leads]) == 0:
        if 1 in firsts:  # they count from both
            return None
        for lead, first in zip(leads, firsts, strict=True):
            struct.pack_into("<I", content, lead, first + 1)
        remarks.append("its sample ranges count from 0; the last sample may be left out")
    for number in dropped:
        struct.pack_into("<II", content, entries[number] + 2, 0, 0)
    if not remarks and not dropped:
        return None
    remarks = remarks or ["its measurements are damaged and left out"]
    # what was right is right again, the whole last
    for place, _, _ in reversed(list(scp_checksums(data))):
        sums = {at: found for at, _, found in scp_checksums(bytes(content))}
        if place in right and place in sums:
            struct.pack_into("<H", content, place, sums[place])
    return bytes(content), f"deviates from SCP-ECG: {'; '.join(remarks)}"


def scp_samples_are_right(data: bytes) -> bool:
    """Whether no checksum that the samples rest on is wrong; 0 is one that was not written."""
    samples = {start for number, _, start, n in _scp_sections(data) if n and number in SCP_SAMPLES}
    return all(
        stated in (0, found) for place, stated, found in scp_checksums(data) if place in samples
    )


def scp_checksums(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Place of each checksum, what it is and what it should be: the whole, then each section."""
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
