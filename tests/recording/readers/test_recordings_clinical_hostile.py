"""HL7 aECG, GE MUSE XML and SCP-ECG files made to break their reader, by hand and at random."""

from __future__ import annotations

import re
import struct

import clinical_files as files
import numpy as np
import pytest
from clinical_files import replaced, saved
from hypothesis import given
from hypothesis import strategies as st
from refusals import fuzzing, refused

from fascicle.core.errors import InputError
from fascicle.core.leads import INDEPENDENT_LEADS
from fascicle.recording.readers.read import read_recording


@pytest.fixture(scope="module")
def digits():
    """(8, 2000) integers: 4 s at 500 Hz."""
    return files.heart_beats()


class TestHostileXml:
    @pytest.mark.parametrize(
        "declaration",
        [
            '<!ENTITY a "x"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;">',
            '<!ENTITY x SYSTEM "file:///etc/passwd">',
            '<!ENTITY x SYSTEM "http://127.0.0.1:9/x">',
            '<!ENTITY % p SYSTEM "http://127.0.0.1:9/x"> %p;',
        ],
    )
    def test_entities(self, tmp_path, digits, declaration):
        doctype = '<!DOCTYPE RestingECG SYSTEM "restecg.dtd"'
        text = replaced(files.muse(digits), doctype, f"{doctype} [{declaration}]")
        refused(saved(tmp_path, text), "entity declarations are not allowed")

    def test_document_type_is_not_fetched(self, tmp_path, digits):
        (tmp_path / "restecg.dtd").write_text("<!ENTITY x 'y'> not a DTD <")
        text = files.muse(digits)
        assert read_recording(saved(tmp_path, text)).duration == 4
        text = replaced(text, '"restecg.dtd"', '"http://127.0.0.1:9/restecg.dtd"')
        assert read_recording(saved(tmp_path, text)).duration == 4

    def test_deep_nesting(self, tmp_path, digits):
        nested = "<component><annotation>" * 20_000 + "</annotation></component>" * 20_000
        text = f"<subjectOf><annotationSet>{nested}</annotationSet></subjectOf></series>"
        text = replaced(files.aecg(digits), "</series>", text)
        refused(saved(tmp_path, text))

    @pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "utf-8-sig"])
    def test_encodings(self, tmp_path, digits, encoding):
        text = replaced(
            files.muse(digits),
            "<PatientID>",
            "<PatientLastName>Müller</PatientLastName><PatientID>",
        )
        text = replaced(text, "ISO-8859-1", encoding.removesuffix("-sig"))
        path = tmp_path / "a.xml"
        path.write_bytes(text.encode(encoding))
        assert read_recording(path).signal[6] == pytest.approx(digits[2] * 4.88e-3)

    @pytest.mark.parametrize("encoding", ["no-such", "shift_jis", "idna", "hex", "undefined"])
    def test_unknown_encodings(self, tmp_path, digits, encoding):
        text = replaced(files.muse(digits), "ISO-8859-1", encoding)
        refused(saved(tmp_path, text))

    def test_null_bytes(self, tmp_path, digits):
        text = replaced(files.muse(digits), "<LeadID>", "<LeadID>\0")
        refused(saved(tmp_path, text))


class TestHostileScp:
    def changed(self, tmp_path, sections, number, at, value):
        content = bytearray(sections[number])
        content[at : at + len(value)] = value
        return saved(tmp_path, files.scp_record(sections | {number: bytes(content)}))

    @pytest.mark.parametrize(
        ("start", "end", "word"),
        [
            (1, 2**32 - 1, "GB of memory, the limit for a file"),
            (1, 150_000_000, "data ends"),
            (2**32 - 500, 2**32 - 1, "GB of memory, the limit for a file"),
            (0, 10, "invalid sample range"),
            (9, 1, "invalid sample range"),
        ],
    )
    def test_declared_samples(self, tmp_path, digits, start, end, word):
        """Neither four thousand million samples nor their place may cost memory."""
        sections = files.scp_sections(digits, huffman=True, interval=10)
        place = struct.pack("<II", start, end)
        refused(self.changed(tmp_path, sections, 3, 2 + 9 * 3, place), word)

    def test_no_leads(self, tmp_path, digits):
        refused(self.changed(tmp_path, files.scp_sections(digits), 3, 0, b"\0"), "no leads")
        path = self.changed(tmp_path, files.scp_sections(digits), 3, 0, b"\xff")
        refused(path, "declares 255 leads")

    def test_unknown_encoding(self, tmp_path, digits):
        path = self.changed(tmp_path, files.scp_sections(digits), 6, 4, b"\x07")
        refused(path, "unknown difference encoding 7")

    def test_bimodal(self, tmp_path, digits):
        path = self.changed(tmp_path, files.scp_sections(digits), 6, 5, b"\x01")
        refused(path, "bimodal compression", "not supported", "without compression")

    def test_lengths_beyond_the_file(self, tmp_path, digits):
        content = bytearray(files.scp(digits))
        content[52:56] = struct.pack("<I", 2**31)
        refused(saved(tmp_path, bytes(content)), "SCP")
        path = self.changed(tmp_path, files.scp_sections(digits), 6, 6, b"\xff\xff")
        refused(path, "exceeds the section")

    @pytest.mark.parametrize("missing", [3, 6])
    def test_missing_sections(self, tmp_path, digits, missing):
        sections = files.scp_sections(digits)
        del sections[missing]
        refused(saved(tmp_path, files.scp_record(sections)), f"Section {missing} (", "is missing")

    def test_huffman_values_beyond_any_integer(self, tmp_path, digits):
        sections = files.scp_sections(digits)
        sections[2] = struct.pack("<HHBBBhI", 1, 1, 1, 255, 1, 0, 1)
        sections[3] = sections[3][:2] + b"".join(
            struct.pack("<IIB", 1, 1000, files.SCP_CODES[name]) for name in INDEPENDENT_LEADS
        )
        data = [b"\xaa" * 32_000] * 8
        sections[6] = struct.pack("<HHBB8H", 4880, 2000, 0, 0, *map(len, data)) + b"".join(data)
        refused(saved(tmp_path, files.scp_record(sections)), "damaged")


# Words that a number, a unit or a tag of an XML file is replaced by
_WORDS = st.sampled_from(
    [b"nan", b"-inf", b"1e999", b"-1", b"0", b"", b"1e-320", b"1_0", b"&x;", b"&#0;", b"</", b"<a>",
     b"\x00", b"\xff\xfe", b'"', b"20021122091000+9999", b"]]>", b"us", b"Hz"]
)  # fmt: skip
_CHANGE = st.tuples(
    st.sampled_from(["flip", "insert", "cut", "end", "value"]), st.floats(0, 1), _WORDS
)
_BRIEF = files.heart_beats(samples=800)
_VALID = {
    ".xml": [files.aecg(_BRIEF).encode(), files.muse(_BRIEF).encode()],
    ".scp": [files.scp(_BRIEF, order=2, huffman=True), files.scp(_BRIEF)],
}


def mutated(content: bytes, changes) -> bytes:
    """Flip a bit, insert a word, cut 20 bytes, end the file, or replace an attribute's value."""
    for kind, place, word in changes:
        at = int(place * max(len(content) - 1, 0))
        if kind == "flip" and content:
            content = content[:at] + bytes([content[at] ^ 1 << len(word) % 8]) + content[at + 1 :]
        elif kind == "insert":
            content = content[:at] + word + content[at:]
        elif kind == "cut":
            content = content[:at] + content[at + 20 :]
        elif kind == "end":
            content = content[: max(at, 1)]
        else:
            content = content[:at] + re.sub(rb'"[^"]*"|>[^<]{1,9}<', word, content[at:], count=1)
    return content


def sound_or_refused(path, content):
    path.write_bytes(content)
    try:
        recording = read_recording(path)
    except InputError:
        refused(path)
    else:
        assert np.isfinite(recording.signal).any()
        assert not np.isinf(recording.signal).any()


_LONG, _SHORT = fuzzing(60), fuzzing(25)


@pytest.mark.slow
class TestFuzz:
    @_LONG
    @given(st.data())
    def test_mutations(self, tmp_path, data):
        suffix = data.draw(st.sampled_from(sorted(_VALID)))
        content = data.draw(st.sampled_from(_VALID[suffix]))
        changes = data.draw(st.lists(_CHANGE, min_size=1, max_size=4))
        sound_or_refused(tmp_path / f"a{suffix}", mutated(content, changes))

    @_SHORT
    @given(st.sampled_from([1, 3, 6]), st.lists(_CHANGE, min_size=1, max_size=3), st.booleans())
    def test_mutations_with_right_checksums(self, tmp_path, number, changes, huffman):
        sections = files.scp_sections(_BRIEF, order=1, huffman=huffman)
        head, tail = sections[number][:30], sections[number][30:]
        sections[number] = mutated(head, changes) + tail
        sound_or_refused(tmp_path / "a.scp", files.scp_record(sections))

    @_SHORT
    @given(
        st.sampled_from([b"", b"<RestingECG>", b"<AnnotatedECG>", bytes(16) + b"SCPECG"]),
        st.binary(max_size=200),
        st.sampled_from([".xml", ".scp"]),
    )
    def test_any_bytes(self, tmp_path, start, content, suffix):
        sound_or_refused(tmp_path / f"a{suffix}", start + content)
