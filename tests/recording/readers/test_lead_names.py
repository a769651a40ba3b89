"""Spellings of leads and units."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fascicle.core.leads import LEADS
from fascicle.recording.readers.names import lead_name, lead_of_code, millivolts

SPELLINGS = {
    "I": [
        "I", " I ", "DI", "D-I", "L1", "L I", "lead_I", "LeadI", "I-lead", "Lead: I", "lead 1",
        "EKG I", "ECG1 I", "ECG - I", "ECG_Lead_I", "MDC_ECG_LEAD_I", "Lead I (Einthoven)",
        "Lead Ⅰ",
    ],
    "II": ["II", "ii", "DII", "d2", "Lead 2", "Ⅱ", "ⅱ", "Dıı", "MDC_ECG_LEAD_II", "ECG II"],
    "III": ["III", "DIII", "D3", "L3", "LIII", "Lead III", "Ⅲ", "iii"],
    "aVR": ["aVR", "AVR", "avr", "aVR lead", "a VR", "a_VR", "aV R", "Lead aVR", "ECG-aVR",
            "MDC_ECG_LEAD_AVR", "Goldberger aVR", "aVR (Goldberger)", "ECG AVR"],
    "aVL": ["aVL", "AVL", "MDC_ECG_LEAD_AVL"],
    "aVF": ["aVF", "AVF", "Lead aVF"],
    "V1": ["V1", "v1", "C1", "V 1", "V01", "V_1", "V₁", "V1 (Wilson)", "ecg_v1", "ECG_Lead_V1",
           "MDC_ECG_LEAD_V1", "Wilson V1", "V1 lead", "LeadV1", "Ｖ１", "V1 [unipolar]"],
    "V6": ["V6", "c6", "V06", "Lead V6"],
}  # fmt: skip
# Frank's leads, more chest leads, inverted and unaugmented leads, Holter leads, electrodes, strips
NOT_LEADS = [
    "", "X", "Y", "Z", "vx", "V7", "V8", "V9", "V3R", "V4R", "V0", "V10", "V12", "V001", "V",
    "-aVR", "- aVR", "\u2212aVR", "aVR-", "-I", "ECG -aVR", "Lead -aVR", "MDC_ECG_LEAD_-aVR",
    "Lead--I", "aVR (inverted)", "V4 (right)", "I (2)", "VR", "VL", "VF", "MLII", "MV1", "CM5",
    "RA", "LA", "LL", "II rhythm", "II (rhythm)", "IIII", "IV", "I I", "I-II", "I II", "1", "ECG",
    "ECG 1", "ECG1", "lead", "lead 4", "D4", "D", "L", "time", "I.1", "I (mV)", "A1", "aVR aVL",
    "Nehb I", "Lead I" + " " * 100,
]  # fmt: skip


def test_spellings():
    for lead, spellings in SPELLINGS.items():
        for text in spellings:
            for cased in (text, text.swapcase(), text.upper(), text.lower()):
                assert lead_name(cased) == lead
    assert [lead_name(lead) for lead in LEADS] == list(LEADS)
    # the last two are made to be slow
    for text in [*NOT_LEADS, "lead " * 12, "lead " * 1000]:
        assert lead_name(text) is None, text


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.text(alphabet="aviI1237c lrfd-_.()ecgmdkbXYℤⅡ₁Ç", max_size=12) | st.text(max_size=80))
def test_a_name_is_a_standard_one_and_is_its_own_name(text):
    lead = lead_name(text)
    assert lead is None or (lead in LEADS and lead_name(lead) == lead)
    ascii_case = "".join(c.swapcase() if c.isascii() else c for c in text)
    assert lead_name(ascii_case) == lead
    # whatever a minus stands before is inverted
    assert lead_name(f"-{text}") is None


def test_codes():
    assert [lead_of_code(f"2:{code}") for code in (1, 2, 3, 8, 61, 62, 63, 64)] == [
        "I", "II", "V1", "V6", "III", "aVR", "aVL", "aVF",
    ]  # fmt: skip
    # DICOM CID 3001
    assert [lead_of_code(f"2:{code}") for code in (9, 66, 67, 10, 14, 16, 17, 18)] == [
        "V7", "V8", "V9", "V2R", "V6R", "X", "Y", "Z",
    ]  # fmt: skip
    assert lead_of_code("2:15") is None
    assert lead_of_code("1:1") is None


@pytest.mark.parametrize(
    ("scale", "spellings"),
    [
        (1e-6, ["nV", "nv", "nanovolt", "nanovolts"]),
        (1e-3, ["uV", "uv", "UV", "\u00b5V", "\u03bcV", "microvolt", "Microvolts", "uV "]),
        (1.0, ["mV", "MV", "mv", " mV", "millivolt", "millivolts"]),
        (1e3, ["V", "v", "volt", "Volts"]),
    ],
)  # fmt: skip
def test_units(scale, spellings):
    assert [millivolts(unit) for unit in spellings] == [scale] * len(spellings)
    for other in ("", "adc", "1e-6 V", "mV/cm", "kV", "A", "digit", "mm", "ms"):
        assert millivolts(other) is None
