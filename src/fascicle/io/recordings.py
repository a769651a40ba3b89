"""ECG recordings from files: WFDB, DICOM waveform, CSV."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from fascicle.errors import InputError
from fascicle.io.recordings_csv import read_csv
from fascicle.io.recordings_dicom import read_dicom
from fascicle.io.recordings_wfdb import read_wfdb
from fascicle.recording.recording import Recording

_READERS = {".hea": read_wfdb, ".dcm": read_dicom, ".csv": read_csv}
_ADVICE = {
    ".pkl": "pickle files can run any code and are never opened, save the recording as CSV",
    ".pickle": "pickle files can run any code and are never opened, save the recording as CSV",
    ".dat": "give its WFDB header, the .hea file beside it",
    ".xml": "convert it to WFDB, DICOM or CSV",
}


def read_recording(path: str | Path) -> Recording:
    """Read a 12-lead recording.

    Parameters
    ----------
    path : path
        ``.hea`` (WFDB header) or the record name without suffix; ``.dcm`` (DICOM waveform);
        ``.csv`` with a column ``time_ms`` or ``time_s`` and one column per lead with its unit, such
        as ``V1_uV`` or ``aVR [mV]``. The ``ecg.csv`` that fascicle writes is in mV.

    Returns
    -------
    Recording
        Leads in mV, in the order of `fascicle.leads.LEADS`; III, aVR, aVL, aVF are computed from I
        and II where they are absent.

    Raises
    ------
    InputError
        When the file cannot be used; the message says why and what to do.
    """
    path = _existing_file(Path(path))
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        advice = _ADVICE.get(suffix, "give .hea (WFDB), .dcm (DICOM waveform) or .csv")
        raise InputError(f"{path}: '{path.suffix}' recordings cannot be read; {advice}")
    recording = _READERS[suffix](path)
    return replace(recording, provenance=recording.provenance | {"source_sha256": _sha256(path)})


def _existing_file(path: Path) -> Path:
    """Return the file itself, or the WFDB header of a record name."""
    if path.is_file():
        return path
    header = path.with_name(path.name + ".hea") if path.name else path
    if header.is_file():
        return header
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give one recording file (.hea, .dcm or .csv)")
    raise InputError(f"{path}: no such file; check the name of the recording")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
