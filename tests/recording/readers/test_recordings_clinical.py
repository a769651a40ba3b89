"""HL7 aECG, GE MUSE XML and SCP-ECG files, good and wrong."""

import re
import struct
import xml.etree.ElementTree as ET

import clinical_files as files
import numpy as np
import pytest
from clinical_files import replaced, saved
from refusals import read_as, refused

from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS, LEADS
from fascicle.recording.pipeline import make_target
from fascicle.recording.readers.read import read_recording
from fascicle.recording.recording import Filters, MissingMetadataError

ROWS = [LEADS.index(lead) for lead in INDEPENDENT_LEADS]


@pytest.fixture(scope="module")
def digits():
    """(8, 2000) integers: 4 s at 500 Hz."""
    return files.heart_beats()


class TestPublishedAecg:
    """The example file of the standard, its digits read a second time, without the library."""

    @pytest.fixture(scope="class")
    def path(self, data_folder):
        return data_folder / "ecg" / "aecg" / "Example_aECG.xml"

    def test_values(self, path):
        recording = read_recording(path)
        namespace = "{urn:hl7-org:v3}"
        series = ET.parse(path).getroot().find(f"{namespace}component/{namespace}series")
        expected = {}
        for sequence in series.find(f"{namespace}component/{namespace}sequenceSet").iter(
            f"{namespace}sequence"
        ):
            code = sequence.find(f"{namespace}code").get("code")
            found = sequence.find(f".//{namespace}digits")
            if found is not None:
                scale = float(sequence.find(f".//{namespace}scale").get("value"))
                name = code.removeprefix("MDC_ECG_LEAD_").replace("AV", "aV")
                expected[name] = scale / 1000 * np.array(found.text.split(), dtype=float)
        assert recording.sampling_rate == 500
        assert recording.signal.shape == (12, 5000)
        assert recording.derived == ()
        for lead, row in zip(LEADS, recording.signal, strict=True):
            assert row == pytest.approx(expected[lead], abs=1e-12), lead
        assert recording.digits_per_millivolt == pytest.approx(np.full(12, 400))
        assert recording.filters == Filters(lowpass=150, notch=60)

    def test_philips(self, data_folder):
        """The example file of Sierra XML: its digits, XLI-compressed, obey the identities."""
        recording = read_recording(data_folder / "ecg" / "philips" / "129DYPRG.XML")
        assert recording.filters == Filters(highpass=0.05, lowpass=150)
        # a calibration pulse stood at the end
        assert recording.signal.shape == (12, 5264)
        assert "\n".join(recording.remarks) == "calibration pulse left out: 10.528 to 11.000 s"
        one, two, three, right, left, foot = recording.signal[:6]
        for error in (one + three - two, right + (one + two) / 2, left - (one - three) / 2):
            assert np.abs(error).max() <= 0.0101  # two digits
        assert np.abs(foot - (two + three) / 2).max() <= 0.0101


class TestSignal:
    @pytest.mark.parametrize(
        ("name", "write", "scale", "filters"),
        [
            ("a.scp", files.scp, 4.88e-3, Filters(0.05, 150, 50)),
            ("a.xml", files.muse, 4.88e-3, Filters(0.16, 150, 60)),
            ("a.xml", files.aecg, 2.5e-3, None),
            ("a.xml", lambda d: files.aecg(d, scale=("2500", "nV")), 2.5e-3, None),
            ("a.xml", files.mortara, 5e-3, None), ("a.ecg", files.ishne, 5e-3, None),
            ("a.mwf", files.mfer, 5e-3, None), ("a.xml", files.cardiosoft, 5e-3, None),
        ],
    )  # fmt: skip
    def test_of_each_format(self, tmp_path, digits, name, write, scale, filters):
        content, path = write(digits), tmp_path / name
        content = content.encode() if isinstance(content, str) else content
        path.write_bytes(content)
        recording = read_as(path, digits * scale)
        assert recording.sampling_rate == 500
        assert recording.digits_per_millivolt[ROWS] == pytest.approx(np.full(8, 1 / scale))
        assert recording.filters == (filters or Filters())
        assert not recording.remarks
        for share in (0.1, 0.99):
            path.write_bytes(content[: int(share * len(content))])
            refused(path)

    def test_faults_of_ishne(self, tmp_path, digits):
        faulty = np.array(digits)
        faulty[3, 700:710] = -(2**15)
        path = tmp_path / "a.ecg"
        path.write_bytes(files.ishne(faulty))
        refused(path, "lead V2 lacks 10 samples (first: sample 700")
        path.write_bytes(files.ishne(digits, nanovolts=-9))
        refused(path, "unknown amplitude", unit="uV")

    @pytest.mark.parametrize(
        ("write", "options", "rate"),
        [
            (files.scp, {"interval": 1024}, 976.5625),
            (files.aecg, {"step": ("1.024", "ms")}, 976.5625),
            (files.muse, {"base": "5", "exponent": "2"}, 500),
            (files.muse, {"base": "4883", "exponent": "-1"}, 488.3),
        ],
    )
    def test_exact_rate(self, tmp_path, digits, write, options, rate):
        """The library rounds it, this does not."""
        recording = read_recording(saved(tmp_path, write(digits, **options)))
        assert recording.sampling_rate == pytest.approx(rate, rel=1e-12)
        assert not recording.remarks


class TestAmplitude:
    def test_unit_serves_only_a_stated_scale(self, tmp_path, digits):
        recording = read_recording(saved(tmp_path, files.aecg(digits, origin="100")))
        assert recording.signal[6] == pytest.approx(digits[2] * 2.5e-3 + 0.1, abs=1e-12)
        path = saved(tmp_path, files.aecg(digits, scale=("2.5", "")))
        refused(path, "unknown unit of lead I", "unit=")
        read_as(path, digits * 2.5e-3, unit="uV")
        path = saved(tmp_path, re.sub("<scale[^>]*/>", "", files.aecg(digits)))
        refused(path, "unknown amplitude of lead I", unit="uV")

    def test_muse_without_unit(self, tmp_path, digits):
        path = saved(tmp_path, files.muse(digits, unit=""))
        refused(path, "unknown unit of lead I")
        assert read_recording(path, unit="uV").signal[6] == pytest.approx(digits[2] * 4.88e-3)
        refused(saved(tmp_path, files.muse(digits, unit="FURLONGS")), "unknown unit", "FURLONGS")
        path = saved(tmp_path, files.muse(digits, scale="0,00488", unit="MV"))
        assert read_recording(path).signal[6] == pytest.approx(digits[2] * 4.88e-3)

    @pytest.mark.parametrize("scale", ["-2.5", "nan", ""])
    def test_impossible_scales(self, tmp_path, digits, scale):
        words = "unknown amplitude of lead I"
        refused(saved(tmp_path, files.muse(digits, scale=scale)), words, unit="uV")
        refused(saved(tmp_path, files.aecg(digits, scale=(scale, "uV"))), words, unit="uV")
        refused(saved(tmp_path, files.scp(digits, nanovolts=0)), words, unit="uV")


class TestTime:
    def test_leads_in_turns(self, tmp_path):
        """Two groups one after another, as SCP-ECG's start samples say."""
        digits = files.heart_beats(samples=1000)
        starts = [1, 1, 1, 1, 1001, 1001, 1001, 1001]
        content = files.scp(digits, starts=starts, interval=2000, flags=4 << 3)
        recording = read_recording(saved(tmp_path, content))
        assert recording.signal.shape == (12, 2000)
        assert recording.spans[ROWS].tolist() == [[0, 1000]] * 4 + [[1000, 2000]] * 4
        assert recording.signal[8, 1000:] == pytest.approx(digits[4] * 4.88e-3, abs=1e-12)

    def test_offsets_of_muse(self, tmp_path, digits):
        for tag in ("LeadTimeOffset", "LeadOffsetFirstSample"):
            offset = f"<{tag}>20</{tag}>\n"
            path = saved(tmp_path, files.muse(digits, extra={"V3": offset}))
            refused(path, f"{tag} differs")
            extra = dict.fromkeys(INDEPENDENT_LEADS, offset)
            read_as(saved(tmp_path, files.muse(digits, extra=extra)), digits * 4.88e-3)


class TestOneRecording:
    def test_several_people_or_records(self, tmp_path, digits):
        """People are counted, never named."""
        path = saved(tmp_path, files.aecg(digits, subjects=("SBJ-1", "SBJ-2")))
        assert "SBJ" not in refused(path, "holds several recordings", "2 different people")
        second = "<PatientDemographics><PatientID>4712</PatientID></PatientDemographics>"
        text = replaced(files.muse(digits), "</RestingECG>", second + "</RestingECG>")
        assert "471" not in refused(saved(tmp_path, text), "2 different people")
        text = text.replace("4712", "4711")
        assert read_recording(saved(tmp_path, text)).duration == 4
        text = replaced(files.muse(digits), "</RestingECG>", "<RestingECG/></RestingECG>")
        refused(saved(tmp_path, text), "2 RestingECG elements")
        content = files.scp(digits)
        refused(saved(tmp_path, content + content), f"{len(content)} bytes follow")
        assert read_recording(saved(tmp_path, content + bytes(9))).duration == 4

    def test_other_xml(self, tmp_path):
        refused(saved(tmp_path, "<html><x>1</x></html>"), "of a kind that is not read")


class TestDamage:
    def test_checksum_of_muse(self, tmp_path, digits):
        text = files.muse(digits)
        start = text.index("<WaveFormData>", text.index("Rhythm")) + 100
        changed = text[:start] + ("A" if text[start] != "A" else "B") + text[start + 1 :]
        refused(saved(tmp_path, changed), "checksum", "lead I (rhythm)")

    def test_what_a_library_raised_is_kept(self, tmp_path, digits):
        """As a note, for developers; a bug of ours would show there, too."""
        path = saved(tmp_path, files.muse(digits, base="nan"))
        with pytest.raises(InputError, match="damaged, truncated or unusual") as info:
            read_recording(path)
        assert "ge_muse_xml.py" in info.value.__notes__[0]

    def test_checksum_of_scp(self, tmp_path, digits):
        content = bytearray(files.scp(digits))
        content[5000] ^= 0x10
        refused(saved(tmp_path, bytes(content)), "checksum", "CRC mismatch")


class TestDeviations:
    """Of writers from their standard, where the samples are certain nevertheless."""

    @pytest.mark.parametrize("last", [1999, 2000])
    def test_sample_ranges_from_0(self, tmp_path, digits, last):
        sections = files.scp_sections(digits)
        ranges = bytearray(sections[3])
        for k in range(8):
            struct.pack_into("<II", ranges, 2 + 9 * k, 0, last)
        path = saved(tmp_path, files.scp_record(sections | {3: bytes(ranges)}))
        recording = read_as(path, digits[:, :last] * 4.88e-3)
        assert "sample ranges count from 0" in "\n".join(recording.remarks)

    def test_measurements_size_and_checksums_of_scp(self, tmp_path, digits):
        def read(content):
            recording = read_as(saved(tmp_path, content), digits * 4.88e-3)
            return "\n".join(recording.remarks)

        content = files.scp(digits)
        assert read(files.scp_record(files.scp_sections(digits) | {7: b"\1\2"})) == ""
        larger = bytearray(content)
        larger[2:6] = struct.pack("<I", len(content) + 100)
        assert "size of the record" in read(bytes(larger))
        assert "3 bytes after the end" in read(content + b"end")
        of_whole = bytes([content[0] ^ 1]) + content[1:]
        assert "not those of the samples" in read(of_whole)
        unwritten = bytearray(content)
        unwritten[:2] = bytes(2)
        assert "not those of the samples" in read(bytes(unwritten))

    def test_header_checksum_of_ishne_that_was_not_written(self, tmp_path, digits):
        content = bytearray(files.ishne(digits))
        content[8:10] = bytes(2)
        path = tmp_path / "a.ecg"
        path.write_bytes(content)
        read_as(path, digits * 5e-3)
        content[8:10] = b"\1\2"
        path.write_bytes(content)
        refused(path, "checksum")

    def test_unwritten_checksums_in_utf_16(self, tmp_path, digits):
        text = replaced(files.muse(digits, checksums=False), "ISO-8859-1", "utf-16")
        (tmp_path / "a.xml").write_bytes(text.encode("utf-16"))
        assert read_recording(tmp_path / "a.xml").signal[6] == pytest.approx(digits[2] * 4.88e-3)
        text = replaced(files.muse(digits), "ISO-8859-1", "utf-16")
        text = re.sub(r"(?<=<LeadDataCRC32>)\d+", "12345", text)
        (tmp_path / "a.xml").write_bytes(text.encode("utf-16"))
        refused(tmp_path / "a.xml", "checksum")

    def test_calibration_pulses(self, tmp_path, digits):
        pulse = np.zeros((8, 200), dtype=int)
        pulse[:, 50:150] = 200  # 1 mV
        noisy = np.where(digits == 0, 1, digits)
        path = tmp_path / "a.ecg"
        for both in ([noisy, pulse], [pulse, noisy]):
            path.write_bytes(files.ishne(np.hstack(both)))
            recording = read_as(path, noisy * 5e-3)
            assert "calibration pulse left out" in "\n".join(recording.remarks)


class TestAveragedBeatOnly:
    """Is read as the one beat that it is."""

    @pytest.fixture(scope="class")
    def beat(self, digits):
        return digits[:, 50:500]

    def test_muse(self, data_folder):
        recording = read_recording(data_folder / "cases" / "c30_muse_median_only.xml")
        assert recording.signal.shape == (12, 600)
        assert "averaged beat" in "\n".join(recording.remarks)
        with pytest.raises(MissingMetadataError, match="noise="):
            make_target(recording)
        assert make_target(recording, noise=0.03).qrs_duration == pytest.approx(90, abs=5)

    def test_muse_and_aecg(self, tmp_path, beat):
        text = files.muse(beat)
        start = text.index("<Waveform>", text.index("Median"))
        text = text[: text.index("<Waveform>")] + text[start:].replace("Rhythm", "Median")
        aecg = replaced(files.aecg(beat), 'code="RHYTHM"', 'code="REPRESENTATIVE_BEAT"')
        for content, scale in ((text, 4.88e-3), (aecg, 2.5e-3)):
            recording = read_as(saved(tmp_path, content), beat * scale)
            assert recording.sampling_rate == 500
            assert "averaged beat" in "\n".join(recording.remarks)

    @pytest.mark.parametrize("rate", ["", 'samplespersec="1000"'])
    def test_philips(self, tmp_path, beat, rate):
        text = files.philips(beat, rate=rate)
        if rate:
            text = replaced(text, 'duration="900"', 'duration="450"', 8)
        recording = read_as(saved(tmp_path, text), beat * 5e-3)
        assert recording.sampling_rate == (1000 if rate else 500)
        assert "averaged beat" in "\n".join(recording.remarks)

    def test_scp(self, tmp_path, beat):
        sections = files.scp_sections(beat)
        sections[4] = struct.pack("<HHH", 900, 200, 0)  # ms
        sections[5] = sections.pop(6)
        recording = read_as(saved(tmp_path, files.scp_record(sections)), beat * 4.88e-3)
        assert recording.sampling_rate == 500
        assert "averaged beat" in "\n".join(recording.remarks)


class TestHostile:
    @pytest.mark.parametrize(
        "declaration",
        ['<!ENTITY a "x"><!ENTITY b "&a;&a;">', '<!ENTITY x SYSTEM "file:///etc/passwd">'],
    )
    def test_entities(self, tmp_path, digits, declaration):
        doctype = '<!DOCTYPE RestingECG SYSTEM "restecg.dtd"'
        text = replaced(files.muse(digits), doctype, f"{doctype} [{declaration}]")
        refused(saved(tmp_path, text), "entity declarations are not allowed")

    def test_deep_nesting(self, tmp_path, digits):
        """Of annotations, which are not needed, and of anything else."""
        nested = "<component><annotation>" * 20_000 + "</annotation></component>" * 20_000
        text = f"<subjectOf><annotationSet>{nested}</annotationSet></subjectOf></series>"
        text = replaced(files.aecg(digits), "</series>", text)
        assert read_recording(saved(tmp_path, text)).duration == 4
        refused(saved(tmp_path, text.replace("annotationSet", "other")))

    def test_place_of_samples_of_scp(self, tmp_path, digits):
        """It costs no memory if it lies four thousand million samples later."""
        sections = files.scp_sections(digits, interval=10)
        ranges = bytearray(sections[3])
        struct.pack_into("<II", ranges, 2 + 9 * 3, 2**32 - 500, 2**32 - 1)
        refused(saved(tmp_path, files.scp_record(sections | {3: bytes(ranges)})))


def test_the_xml_of_schiller(data_folder):
    recording = read_recording(data_folder / "cases" / "schiller_sema.xml")
    assert recording.signal.shape == (12, 2000)
    assert recording.sampling_rate == 500.0
    assert recording.signal[0, :3] == pytest.approx([-0.005, -0.001, 0.008])  # mV
