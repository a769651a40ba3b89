"""Lead names and units as they are spelt in files."""

from __future__ import annotations

import re
import unicodedata

from fascicle.core.leads import LEADS

# What may stand before the name proper: what ISO/IEEE 11073 and EDF+ put there, and who introduced
# the lead.
_WORD = "(?:mdc|ecg[12]?|ekg|einthoven|goldberger|wilson|lead)"
# A hyphen joins words only where nothing is beside it, or blanks on both sides: "ECG -aVR" is the
# inverted lead.
_BEFORE = rf"(?:(?:{_WORD}(?:[ _:.]+(?!-)|-(?![ -])|[ ]-[ ])|lead))*"
_BEHIND = r"(?:[ _-]?lead)?"
_REMARK = (
    r"(?: ?[(\[](?:einthoven|goldberger|wilson|unipolar|bipolar|limb|chest|precordial|augmented|"
    r"standard)[)\]])?"
)
_ROMAN = re.compile(rf"{_BEFORE}(?:l[ _]?|d[ _-]?)?(?P<name>i{{1,3}}){_BEHIND}{_REMARK}")
_ARABIC = re.compile(rf"{_BEFORE}(?:lead[ _-]?|l[ _]?|d[ _-]?)(?P<name>[123]){_BEHIND}{_REMARK}")
_AUGMENTED = re.compile(rf"{_BEFORE}a[ _-]?v[ _-]?(?P<name>[rlf]){_BEHIND}{_REMARK}")
_CHEST = re.compile(rf"{_BEFORE}[vc][ _-]?0?(?P<name>[1-6]){_BEHIND}{_REMARK}")

_LONGEST_NAME = 64  # characters, as in DICOM; bounds what matching takes

# Codes of ISO/IEEE 11073 (MDC, context 2) and, with the prefix 5.6.3-9-, of SCP-ECG
_CODES = {"1": "I", "2": "II", "61": "III", "62": "aVR", "63": "aVL", "64": "aVF"} | {
    str(number + 2): f"V{number}" for number in range(1, 7)
}
_MILLIVOLTS = {
    spelling: scale
    for scale, short, long in ((1e-6, "nv", "nano"), (1e-3, "uv", "micro"), (1.0, "mv", "milli"))
    for spelling in (short, f"{long}volt", f"{long}volts")
} | {"v": 1e3, "volt": 1e3, "volts": 1e3}


def lead_name(text: str) -> str | None:
    """Return the name in `fascicle.core.leads.LEADS` of a text without unit, None for others.

    Understands ``aVR``, ``AVR``, ``a VR``, ``Lead I``, ``I lead``, ``DII``, ``L1``, ``v1``,
    ``V01``, ``C1``, ``MDC_ECG_LEAD_V1``, ``ECG-I``, ``Lead I (Einthoven)`` and
    Roman numerals of their own code points. Not leads of the twelve: an inverted ``-aVR``, the
    unaugmented ``VR``, ``MLII`` of ambulatory recorders, ``V7``, ``V4R``, Frank's X, Y and Z, and a
    ``II rhythm``, which repeats a lead.
    """
    if len(text) > _LONGEST_NAME:
        return None
    name = _plain(text)
    for pattern in (_ROMAN, _ARABIC):
        if match := pattern.fullmatch(name):
            number = match["name"]
            return LEADS[(int(number) if number.isdigit() else len(number)) - 1]
    if match := _AUGMENTED.fullmatch(name):
        return f"aV{match['name'].upper()}"
    if match := _CHEST.fullmatch(name):
        return f"V{match['name']}"
    return None


def _plain(text: str) -> str:
    """Return the text in lower case, in compatible letters without accents, single blanks."""
    # a dotless i is what Turkish software makes of a lower-case I
    letters = unicodedata.normalize("NFKD", text).casefold().replace("ı", "i")
    return " ".join("".join(c for c in letters if not unicodedata.combining(c)).split())


def lead_of_code(code: str) -> str | None:
    """Return the lead of an MDC (``2:1``) or SCP-ECG (``5.6.3-9-1``) code, or None."""
    for prefix in ("2:", "5.6.3-9-"):
        if code.startswith(prefix):
            return _CODES.get(code.removeprefix(prefix))
    return None


def millivolts(unit: str) -> float | None:
    """Return how many mV one such unit is, or None when the unit is unknown.

    Understands nV, uV (with u or either code point of the Greek letter), mV, V and the words
    (``microvolts``), in any case: a megavolt is no unit of an ECG.
    """
    return _MILLIVOLTS.get(plain_unit(unit))


def plain_unit(unit: str) -> str:
    """Return a unit in lower case, with u for either code point of the Greek letter."""
    return unit.strip().lower().replace("µ", "u").replace("μ", "u")


def same_unit(one: str, other: str) -> bool:
    """Tell whether two spellings mean the same unit."""
    if millivolts(one) is None or millivolts(other) is None:
        return one == other
    return millivolts(one) == millivolts(other)
