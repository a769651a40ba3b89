"""Lead names and units as they are spelt in files."""

from __future__ import annotations

import re

from fascicle.leads import LEADS

_STANDARD = {lead.lower(): lead for lead in LEADS}
_SPELLINGS = (
    _STANDARD
    | {f"d{name}": lead for name, lead in _STANDARD.items() if set(name) == {"i"}}
    | {f"d{number}": lead for number, lead in zip("123", LEADS, strict=False)}
    | {f"c{number}": f"V{number}" for number in range(1, 7)}
)
_PREFIX = re.compile(r"^(mdc_)?(ecg_)?(lead|derivation)?[ _:.]*")
_SUFFIX = re.compile(r"\s*\(.*\)$")
# Codes of ISO/IEEE 11073 (MDC, context 2) and, with the prefix 5.6.3-9-, of SCP-ECG
_CODES = {"1": "I", "2": "II", "61": "III", "62": "aVR", "63": "aVL", "64": "aVF"} | {
    str(number + 2): f"V{number}" for number in range(1, 7)
}
_MILLIVOLTS = {"nv": 1e-6, "uv": 1e-3, "mv": 1.0, "v": 1e3}


def lead_name(text: str) -> str | None:
    """Return the standard name of a lead, or None when the text names no lead.

    Understands ``aVR``, ``AVR``, ``Lead I``, ``DII``, ``v1``, ``C1``, ``MDC_ECG_LEAD_V1``,
    ``Lead I (Einthoven)``. An inverted ``-aVR`` is not aVR.
    """
    name = _SUFFIX.sub("", text.strip().lower())
    return _SPELLINGS.get(_PREFIX.sub("", name))


def lead_of_code(code: str) -> str | None:
    """Return the lead of an MDC (``2:1``) or SCP-ECG (``5.6.3-9-1``) code, or None."""
    for prefix in ("2:", "5.6.3-9-"):
        if code.startswith(prefix):
            return _CODES.get(code.removeprefix(prefix))
    return None


def millivolts(unit: str) -> float | None:
    """Return how many mV one such unit is, or None when the unit is unknown."""
    return _MILLIVOLTS.get(unit.strip().lower().replace("µ", "u").replace("μ", "u"))


def first_line(error: BaseException) -> str:
    """Return one line about an error of a library."""
    lines = str(error).strip().splitlines()
    return lines[0].strip().rstrip(".") if lines else type(error).__name__
