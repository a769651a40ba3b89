"""Lead names and units as they are spelt in files, and the leads that follow from others."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.leads import LEADS
from fascicle.recording.recording import Recording

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


def assemble(
    leads: Mapping[str, NDArray[np.float64]],
    sampling_rate: float,
    source: str,
    provenance: Mapping[str, str],
) -> Recording:
    """Put leads by standard name, each (n,) mV, in order; limb leads follow from I and II.

    Raises
    ------
    InputError
        When leads are missing, or the recording fails its checks.
    """
    given = dict(leads)
    derived = _derived_limb_leads(given)
    missing = [lead for lead in LEADS if lead not in given and lead not in derived]
    if missing:
        raise InputError(
            f"{source}: lead{'s' * (len(missing) > 1)} {', '.join(missing)} missing (found: "
            f"{', '.join(given) or 'none'}); all 12 leads are needed, III and aVR, aVL, aVF follow "
            "from I and II"
        )
    notes = dict(provenance)
    if derived:
        notes["derived_leads"] = ", ".join(derived)
    signal = np.stack([(given | derived)[lead] for lead in LEADS])
    return Recording(signal, sampling_rate, source, notes)


def _derived_limb_leads(
    given: Mapping[str, NDArray[np.float64]],
) -> dict[str, NDArray[np.float64]]:
    """Compute the absent ones of III, aVR, aVL, aVF by Einthoven's and Goldberger's laws."""
    if "I" not in given or "II" not in given:
        return {}
    i, ii = given["I"], given["II"]
    limb = {"III": ii - i, "aVR": -(i + ii) / 2, "aVL": i - ii / 2, "aVF": ii - i / 2}
    return {name: lead for name, lead in limb.items() if name not in given}
