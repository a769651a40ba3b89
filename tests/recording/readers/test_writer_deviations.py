"""Deviations of writers from the standard of their format: values are read right, and it is said.

Most were seen in files of public archives and in the issues of wfdb-python, pyedflib and MNE.
"""

import re

import clinical_files as files
import dicom_files
import edfio
import pytest
from refusals import read_as, refused

from fascicle.core.leads import INDEPENDENT_LEADS, LEADS
from fascicle.recording.readers.read import read_recording

ROWS = [LEADS.index(lead) for lead in INDEPENDENT_LEADS]
DIGITS = files.heart_beats()
MV = 5e-3 * DIGITS  # of every file here, at 500 Hz
SIGNALS = [
    edfio.EdfSignal(5.0 * row, 500, label=lead, physical_dimension="uV",
                    physical_range=(-5000, 5000), digital_range=(-1000, 1000))
    for lead, row in zip(INDEPENDENT_LEADS, DIGITS, strict=True)
]  # fmt: skip
EDF = edfio.Edf(SIGNALS, data_record_duration=2).to_bytes()
HEAD = 256 * 9
LABEL, UNIT, PHYSICAL_MIN, DIGITAL_MIN, PHYSICAL_MAX = 0, 96, 104, 120, 112


def put(at, text, width=8, data=EDF):
    return data[:at] + text.encode("latin-1").ljust(width) + data[at + width :]


def put_all(offset, texts, width=8, data=EDF):
    """A field of all signals of an EDF file."""
    for k, text in enumerate([texts] * 8 if isinstance(texts, str) else texts):
        data = put(256 + 8 * offset + width * k, text, width, data)
    return data


def wfdb(first="rec 8 500 2000", file="rec.dat", gain="200/mV", more="16 0"):
    lines = [
        f"{file} 16 {gain} {more} {row[0]} {int(row.sum()) % 2**16} 0 {lead}"
        for row, lead in zip(DIGITS, INDEPENDENT_LEADS, strict=True)
    ]
    return "\n".join([first, *lines]) + "\n"


def aecg(old="", new="", count=0, **options):
    text = files.aecg(DIGITS, **({"scale": ("5", "uV")} | options))
    return re.sub(old, new, text, count=count) if old else text


def muse(old="", new="", **options):
    text = files.muse(DIGITS, **({"scale": "5"} | options))
    assert not old or re.search(old, text)
    return re.sub(old, new, text, flags=re.DOTALL) if old else text


def dicom(of_channels, of_group=None):
    item = dicom_files.group(DIGITS, INDEPENDENT_LEADS)
    dicom_files.change_leads(item, ChannelSensitivity="5")
    dicom_files.change_leads(item, **of_channels)
    return dicom_files.put(item, **(of_group or {}))


MFER = files.mfer(DIGITS)
MILLI = [dicom_files.code("", "UCUM", "microvolt")]
# file: what deviates: content, what is said of it ("" if nothing needs to be)
READ = {
    "a.edf": {
        "number of records": (put(236, "-1"), "using the 2 complete records"),
        "no number of records": (put(236, ""), "'' in its header is read as -1"),
        "a record more than there is": (put(236, "3"), "declares 3 data records, only 2"),
        "cut short": (put(236, "3") + EDF[-5000:], "declares 3 data records, only 2"),
        "bytes behind the records": (EDF + bytes(77), "77 byte(s) after the last"),
        "size of the header": (put(184, "256"), "header size field is 256"),
        "letters beyond ASCII": (put(8, "Müller", 80), ""),
        "decimal commas": (put_all(PHYSICAL_MAX, "5000,0"), "'5000,0' in its header"),
        "decimals of whole numbers": (put_all(DIGITAL_MIN, "-1000.0"), "'-1000.0' in its header"),
        "NUL for blanks": (EDF[:HEAD].replace(b" ", b"\0") + EDF[HEAD:], ""),
        "reference": (put_all(LABEL, [f"ECG {lead}-Ref" for lead in INDEPENDENT_LEADS], 16), ""),
        "Greek unit in UTF-8": (put_all(UNIT, "µV".encode().decode("latin-1")), ""),
    },
    "rec.hea": {
        "date first": (wfdb("rec 8 500 2000 05-May-2020 09:49:17"), "no time and date"),
        "a year": (wfdb("rec 8 500 2000 2006"), "'2006' is left out"),
        "folder": (wfdb("median/rec 8 500 2000", "median/rec.dat"), "'median/rec.dat'"),
        "capitals": (wfdb(file="REC.DAT"), "'REC.DAT' in its header is read as rec.dat"),
        "renamed": (wfdb("old 8 500 2000", "old.dat"), "'old.dat' in its header is read as rec"),
        "no number of samples": (wfdb("rec 8 500"), ""),
        "comments first": ("# of a hospital\n\n" + wfdb(gain="200").replace("\n", "\r\n"), ""),
        "byte order mark": ("\ufeff" + wfdb(), ""),
        "baseline behind the unit": (wfdb(gain="200/mV(0)"), "is read as 200(0)/mV"),
        "baseline with decimals": (wfdb(gain="200(0.0)/mV"), "is read as 200(0)/mV"),
        "gain with a comma": (wfdb(gain="200,0/mV"), "is read as 200.0/mV"),
        "bits with decimals": (wfdb(more="16.0 0.0"), "'16.0' in its header"),
        "rate with a unit": (wfdb("rec 8 500Hz 2000"), "'500Hz' in its header is read as 500"),
    },
    "aecg.xml": {
        "prefix": (aecg(r"<(/?)(?=[A-Za-z])", r"<\1h:").replace("xmlns=", "xmlns:h="), ""),
        "undeclared prefix": (aecg(' xmlns:xsi="[^"]*"'), "not well-formed XML (unbound prefix"),
        "case of leads": (aecg("(LEAD_[AV]+)", lambda match: match[1].lower()), ""),
        "no unit of the origin": (aecg('(<origin value="0") unit="uV"', r"\1"), ""),
        "case of units": (aecg("uV", "UV"), ""),
        "millivolts with a comma": (aecg(scale=("0,005", "mV")), "'0,005' is read as 0.005"),
        "time with a comma": (aecg(step=("0,002", "s")), "'0,002' is read as 0.002"),
        "unit of time": (aecg(step=("2", "MSEC")), ""),
        "UTF-16 that says UTF-8": (aecg().encode("utf-16"), "not well-formed XML"),
        "Latin-1 that says UTF-8": (aecg(subjects=("Müller",)).encode("latin-1"), ""),
        "bytes at the end": (aecg() + "\0\0", "not well-formed XML"),
        "no kind of series": (aecg('<code code="RHYTHM"/>', ""), ""),
    },
    "muse.xml": {
        "samples counted wrongly": (muse("Total>2000<", "Total>2001<"), "LeadSampleCountTotal"),
        "bytes counted wrongly": (muse("Total>4000<", "Total>4001<"), "LeadByteCountTotal"),
        "Base64 not filled up": (muse("=+(?=\n)", ""), ""),
        "unit": (muse(unit=" uV "), ""),
        "averaged beat damaged": (muse("Total>600<", "Total>601<"), ""),
        "checksum empty": (muse("<LeadDataCRC32>[^<]*<", "<LeadDataCRC32><"), ""),
        "ampersand": (muse(patient="A & B"), "not well-formed XML"),
        "control characters": (muse(patient="A\2B"), "not well-formed XML"),
    },
    "a.mwf": {
        "no end": (MFER[:-2], ""),
        "date of birth": (MFER[:6] + b"\x83\7\x1e\0\0\0\0\x0d\x40" + MFER[6:], ""),
    },
    "a.dcm": {
        "empty correction factor": (dicom({"ChannelSensitivityCorrectionFactor": ""}), ""),
        "no baseline": (dicom({"ChannelBaseline": None}), ""),
        "unit in words only": (dicom({"ChannelSensitivityUnitsSequence": MILLI}), ""),
        "number of samples": (dicom({}, {"NumberOfWaveformSamples": 2001}), "holds 2000"),
        "number of channels": (dicom({}, {"NumberOfWaveformChannels": 12}), "describes 8"),
        "padding": (dicom({}, {"WaveformData": DIGITS.T.astype("<i2").tobytes() + b"\0\0"}), ""),
    },
}  # fmt: skip
ALL = [(name, what) for name, found in READ.items() for what in found]


def saved(folder, name, content):
    if name == "a.dcm":
        return dicom_files.write(folder, content)
    (folder / "rec.dat").write_bytes(DIGITS.T.astype("<i2").tobytes())
    (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder / name


@pytest.mark.parametrize(("name", "what"), ALL)
def test_read(tmp_path, name, what):
    content, said = READ[name][what]
    recording = read_as(saved(tmp_path, name, content), MV)
    assert recording.sampling_rate == 500
    remarks = "\n".join(recording.remarks)
    assert said in remarks
    assert bool(said) == bool(remarks), remarks


def test_the_range_of_edf_may_run_downward(tmp_path):
    turned = put(256 + 8 * PHYSICAL_MAX, "-5000", data=put(256 + 8 * PHYSICAL_MIN, "5000"))
    recording = read_recording(saved(tmp_path, "a.edf", turned))
    assert recording.signal[:2] == pytest.approx(MV[:2] * [[-1], [1]], abs=1e-9)


@pytest.mark.parametrize("begin", [132, 144])
def test_dicom_without_its_beginning(tmp_path, begin):
    """Without its preamble, or all that comes before the data set."""
    path = saved(tmp_path, "a.dcm", dicom({}))
    data = path.read_bytes()
    begin += int.from_bytes(data[140:144], "little") * (begin == 144)
    path.write_bytes(data[begin:])
    assert read_recording(path).signal[ROWS] == pytest.approx(MV, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.xml", aecg("<increment[^>]*/>", "")),
        ("a.xml", muse("<SampleBase>[^<]*</SampleBase>", "")), ("rec.hea", wfdb("rec 8")),
        ("a.mwf", files.mfer(DIGITS, interval=b"")),
    ],
)  # fmt: skip
def test_a_rate_that_is_not_there_is_asked(tmp_path, name, content):
    path = saved(tmp_path, name, content)
    refused(path, "no sampling rate in the file")
    read_as(path, MV, sampling_rate=500)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.edf", put_all(PHYSICAL_MAX, "5,000"), "physical maximum '5,000'"),
        ("a.edf", put_all(PHYSICAL_MIN, "5000"), "unknown amplitude"),
        ("a.edf", put_all(PHYSICAL_MIN, "nan"), "unknown amplitude"),
        ("a.edf", put_all(PHYSICAL_MAX, "x"), "damaged"),
        ("a.edf", put_all(DIGITAL_MIN, "32767"), "unknown amplitude of lead I"),
        ("a.edf", EDF[: HEAD + 5000], "none is complete"), ("a.edf", put(252, "7", 4), ""),
        ("rec.hea", wfdb(gain="0"), "the gain of lead I"), ("rec.hea", wfdb(gain="1,000/mV"), ""),
        ("rec.hea", wfdb("rec 9 500 2000"), "9 signals declared"),
        ("rec.hea", wfdb(file="/etc/passwd"), "no file in its folder"),
        ("rec.hea", wfdb("rec 8 500 2001"), "holds 2000 frames"),
        ("a.xml", aecg(scale=("2,500", "uV")), "unknown amplitude"),
        ("a.xml", aecg()[:-3000], "Malformed XML"),
        ("a.xml", muse("Total>2000<", "Total>2001<", checksums=False), "LeadSampleCountTotal"),
        ("a.mwf", MFER.replace(b"\4\4\xd0\7\0\0", b"\4\4\xd1\7\0\0"), "shorter than the frame"),
        ("a.dcm", dicom({"ChannelSensitivityCorrectionFactor": "0"}), "unknown unit of lead I"),
        ("a.dcm", dicom({"ChannelSensitivityUnitsSequence": None}), "unknown unit of lead I"),
        ("a.dcm", dicom({}, {"NumberOfWaveformChannels": 7, "NumberOfWaveformSamples": 99}), ""),
    ],
)  # fmt: skip
def test_what_is_ambiguous_or_damaged_is_refused(tmp_path, name, content, words):
    refused(saved(tmp_path, name, content), words)
