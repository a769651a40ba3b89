"""Writers of HL7 aECG, MUSE, Mortara, SCP-ECG, ISHNE and MFER files, from the standards.

Digits are (leads, samples) arrays of integers. Everything that a test wants wrong is an argument,
or is changed in the text that comes out.
"""

from __future__ import annotations

import base64
import binascii
import struct
import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from fascicle.core.leads import INDEPENDENT_LEADS, LEADS

# EN 1064, 5.6.3: identification of leads
SCP_CODES = {name: code for code, name in enumerate(INDEPENDENT_LEADS, 1)}


def heart_beats(samples=2000, seed=1):
    """Digits of eight leads in which a QRS, different in each, beats once a second over noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / 500
    qrs = np.exp(-(((t % 1.0 - 0.5) / 0.02) ** 2))
    amplitude = rng.uniform(-400, 400, 8)
    return np.rint(amplitude[:, None] * qrs + rng.normal(0, 2, (8, samples))).astype(int)


def aecg(
    digits, *, step=("0.002", "s"), scale=("2.5", "uV"), origin="0", subjects=("SBJ-1",)
) -> str:
    """HL7 aECG with one rhythm series of one sequence set."""
    people = "".join(
        '<componentOf><timepointEvent><componentOf><subjectAssignment><subject><trialSubject>'
        f'<id root="2.16" extension="{subject}"/></trialSubject></subject></subjectAssignment>'
        '</componentOf></timepointEvent></componentOf>'
        for subject in subjects
    )  # fmt: skip
    value, unit = scale
    leads = "".join(
        f'<component><sequence><code code="MDC_ECG_LEAD_{name.upper()}"/>'
        f'<value xsi:type="SLIST_PQ"><origin value="{origin}" unit="{unit}"/>'
        f'<scale value="{value}" unit="{unit}"/><digits>{" ".join(map(str, row))}</digits>'
        "</value></sequence></component>"
        for name, row in zip(INDEPENDENT_LEADS, digits, strict=True)
    )
    time = (
        '<component><sequence><code code="TIME_ABSOLUTE"/><value xsi:type="GLIST_TS">'
        f'<head value="20021122091000.000"/><increment value="{step[0]}" unit="{step[1]}"/>'
        "</value></sequence></component>"
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<AnnotatedECG xmlns="urn:hl7-org:v3" '
        'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" type="Observation">'
        f'{people}<component><series><code code="RHYTHM"/><component><sequenceSet>'
        f"{time}{leads}</sequenceSet></component></series></component></AnnotatedECG>"
    )


def muse(
    digits, *, base="500", exponent="0", scale="4.88", unit="MICROVOLTS", checksums=True,
    extra: Mapping[str, str] | None = None, patient="4711",
) -> str:  # fmt: skip
    """GE MUSE XML: a median beat, then the rhythm, digits as little-endian 16 bit in base64."""

    def lead(name, row):
        payload = np.asarray(row).astype("<i2").tobytes()
        text = base64.b64encode(payload).decode()
        lines = "\n".join(text[k : k + 72] for k in range(0, len(text), 72))
        checksum = zlib.crc32(payload) if checksums else 0
        more = (extra or {}).get(name, "")
        return (
            f"<LeadData>\n<LeadByteCountTotal>{len(payload)}</LeadByteCountTotal>\n"
            f"<LeadSampleCountTotal>{len(row)}</LeadSampleCountTotal>\n"
            f"<LeadAmplitudeUnitsPerBit>{scale}</LeadAmplitudeUnitsPerBit>\n"
            f"<LeadAmplitudeUnits>{unit}</LeadAmplitudeUnits>\n<LeadID>{name}</LeadID>\n{more}"
            f"<LeadSampleSize>2</LeadSampleSize>\n<LeadDataCRC32>{checksum}</LeadDataCRC32>\n"
            f"<WaveFormData>\n{lines}\n</WaveFormData>\n</LeadData>\n"
        )

    def waveform(kind, rows):
        return (
            f"<Waveform>\n<WaveformType>{kind}</WaveformType>\n<SampleBase>{base}</SampleBase>\n"
            f"<SampleExponent>{exponent}</SampleExponent>\n<HighPassFilter>16</HighPassFilter>\n"
            "<LowPassFilter>150</LowPassFilter>\n<ACFilter>60</ACFilter>\n"
            + "".join(lead(*each) for each in zip(INDEPENDENT_LEADS, rows, strict=True))
            + "</Waveform>\n"
        )

    return (
        '<?xml version="1.0" encoding="ISO-8859-1"?>\n'
        '<!DOCTYPE RestingECG SYSTEM "restecg.dtd">\n<RestingECG>\n'
        "<MuseInfo><MuseVersion>9.0.7</MuseVersion></MuseInfo>\n"
        f"<PatientDemographics><PatientID>{patient}</PatientID></PatientDemographics>\n"
        + waveform("Median", np.asarray(digits)[:, :600] // 2)
        + waveform("Rhythm", digits)
        + "</RestingECG>\n"
    )


def section(number: int, content: bytes) -> bytes:
    """A section with its header and checksum, padded to an even length."""
    content += b"\0" * (len(content) % 2)
    reserved = b"SCPECG" if number == 0 else bytes(6)
    body = struct.pack("<HIBB", number, 16 + len(content), 20, 20) + reserved + content
    return struct.pack("<H", binascii.crc_hqx(body, 0xFFFF)) + body


def scp_record(sections: Mapping[int, bytes]) -> bytes:
    """A record of sections 1 and up, with the pointers of section 0 and all checksums."""
    contents = {number: section(number, content) for number, content in sections.items()}
    table = range(12)
    place = 6 + 16 + 10 * len(table)
    pointers = struct.pack("<HII", 0, place - 6, 7)
    for number in table[1:]:
        size = len(contents.get(number, b""))
        pointers += struct.pack("<HII", number, size, place + 1 if size else 0)
        place += size
    body = section(0, pointers) + b"".join(contents[number] for number in sorted(contents))
    body = struct.pack("<I", 6 + len(body)) + body
    return struct.pack("<H", binascii.crc_hqx(body, 0xFFFF)) + body


def scp_sections(
    digits: Sequence, *, starts=(1,) * 8, nanovolts=4880, interval=2000, flags=0x04 | 8 << 3
) -> dict[int, bytes]:
    """Contents of the sections of a 12-lead recording, to be changed by a test."""
    leads = [
        struct.pack("<IIB", start, start + len(row) - 1, SCP_CODES[name])
        for name, start, row in zip(INDEPENDENT_LEADS, starts, digits, strict=True)
    ]
    data = [np.asarray(row).astype("<i2").tobytes() for row in digits]
    tags = b"\x1b\x02\x00" + struct.pack("<H", 5) + b"\x1c\x02\x00" + struct.pack("<H", 150)
    tags += b"\x1d\x01\x00\x02" + b"\xff\x00\x00"
    return {
        1: b"\x02\x05\x004711\x00" + tags,
        3: bytes([len(leads), flags]) + b"".join(leads),
        6: struct.pack(f"<HHBB{len(data)}H", nanovolts, interval, 0, 0, *map(len, data))
        + b"".join(data),
    }


def scp(digits, **options) -> bytes:
    """SCP-ECG file of a recording."""
    return scp_record(scp_sections(digits, **options))


def mortara(digits) -> bytes:
    """Mortara ELI XML of 200 digits a mV at 500 Hz."""
    channels = "".join(
        f'<CHANNEL NAME="{name}" SAMPLE_FREQ="500" UNITS_PER_MV="200" DURATION="{len(row)}" '
        f'BITS="16" FORMAT="SIGNED" ENCODING="BASE64" OFFSET="0" '
        f'DATA="{base64.b64encode(np.asarray(row).astype("<i2").tobytes()).decode()}"/>'
        for name, row in zip(INDEPENDENT_LEADS, digits, strict=True)
    )
    source = '<SOURCE TYPE="RESTING" MANUFACTURER="MORTARA" MODEL="ELI280"/>'
    return f'<?xml version="1.0"?><ECG VENT_RATE="60">{source}{channels}</ECG>'.encode()


def cardiosoft(digits) -> bytes:
    """CardioSoft XML of 5 uV a digit at 500 Hz, with an averaged beat."""
    about = '<SampleRate units="Hz">500</SampleRate><Resolution units="uVperLsb">5</Resolution>'
    leads = "".join(
        f'<WaveformData lead="{name}">{",".join(map(str, row))}\n\t</WaveformData>'
        for name, row in zip(INDEPENDENT_LEADS, digits, strict=True)
    )
    beat, rhythm = (f"<{kind}>{about}{leads}</{kind}>" for kind in ("MedianSamples", "StripData"))
    head = '<?xml version="1.0" encoding="ISO-8859-1"?>'
    return f"{head}<CardiologyXML>{beat}{rhythm}</CardiologyXML>".encode()


def philips(beat, *, rate="") -> str:
    """Philips XML of representative beats alone, of 5 uV a digit at 500 Hz."""
    beats = "".join(
        f'<repbeat leadname="{name}"><waveform duration="{2 * len(row)}">'
        f"{base64.b64encode(np.asarray(row).astype('<i2').tobytes()).decode()}</waveform></repbeat>"
        for name, row in zip(INDEPENDENT_LEADS, beat, strict=True)
    )
    return (
        '<?xml version="1.0"?><restingecgdata xmlns="http://www3.medical.philips.com"><documentinfo>'
        "<documenttype>PhilipsECG</documenttype><documentversion>1.04</documentversion>"
        "</documentinfo><dataacquisition><signalcharacteristics><samplingrate>500</samplingrate>"
        "<signalresolution>5</signalresolution></signalcharacteristics></dataacquisition><waveforms>"
        f'<repbeats dataencoding="Base64" {rate}>{beats}</repbeats></waveforms></restingecgdata>'
    )


def ishne(digits, *, nanovolts=5000) -> bytes:
    """ISHNE Holter file (Badilini 1998): a header of 522 bytes, then the leads in turns."""
    codes = [5 + LEADS.index(name) for name in INDEPENDENT_LEADS] + [-9] * 4
    rows = np.asarray(digits).astype("<i2").T.tobytes()
    header = bytearray(512)
    struct.pack_into("<iiii", header, 0, 0, np.shape(digits)[1], 522, 522)
    struct.pack_into("<h", header, 146, 8)
    struct.pack_into("<12h12h12h", header, 148, *codes, *[0] * 12, *[nanovolts] * 12)
    struct.pack_into("<h", header, 262, 500)
    return b"ISHNE1.0" + struct.pack("<H", binascii.crc_hqx(bytes(header), 0xFFFF)) + header + rows


def mfer(digits, *, interval=b"\x0b\x04\x01\xfd\x02\x00") -> bytes:
    """MFER file (ISO 22077) of 5 uV a digit; by default at an interval of 2 ms."""

    def item(tag: int, content: bytes) -> bytes:
        size = len(content)
        length = bytes([size]) if size < 128 else b"\x84" + struct.pack(">I", size)
        return bytes([tag]) + length + content

    samples = np.shape(digits)[1]
    start = item(0x40, b"MFR ") + item(0x01, b"\1") + interval + item(0x0C, b"\0\xfa\5\0")
    start += item(0x04, struct.pack("<I", samples)) + item(0x05, bytes([8]))
    start += item(0x06, struct.pack("<I", 1))
    for k, name in enumerate(INDEPENDENT_LEADS):
        attributes = item(0x09, struct.pack("<H", SCP_CODES[name]))
        start += b"\x3f" + bytes([k, len(attributes)]) + attributes
    return start + item(0x1E, np.asarray(digits).astype("<i2").tobytes()) + b"\x80\0"


def saved(folder, content):
    """Write a file of the right name; text is XML, bytes are SCP-ECG."""
    path = folder / ("a.xml" if isinstance(content, str) else "a.scp")
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def replaced(text, old, new, count=1):
    assert old in text
    return text.replace(old, new, count)
