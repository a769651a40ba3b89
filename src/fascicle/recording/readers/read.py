"""ECG recordings from the files that clinics and archives have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from fascicle.core.errors import InputError
from fascicle.core.files import as_path
from fascicle.core.isolated import read_isolated
from fascicle.core.leads import LEADS
from fascicle.core.ranges import check_items, check_text, number
from fascicle.recording.readers.content import LARGEST_FILE, kind_of_content, sha256_of
from fascicle.recording.readers.raw_recording import RawRecording, ReadOptions, assemble
from fascicle.recording.recording import Recording

# The module and function that read each kind of file; loaded when used.
_READERS = {
    "WFDB": ("wfdb_records", "read_wfdb"),
    "DICOM": ("dicom", "read_dicom"),
    "XML": ("clinical", "read_xml"),
    "SCP-ECG": ("clinical", "read_scp"),
    "EDF": ("edf", "read_edf"),
    "HDF5": ("hdf5", "read_hdf5"),
    "MAT": ("matlab", "read_matlab"),
    "table": ("tables", "read_table"),
}
# Kinds whose libraries may crash or never end on damaged files; they run in a child process
_ISOLATED = ("SCP-ECG", "HDF5", "MAT")
_KINDS = {
    ".hea": "WFDB", ".dcm": "DICOM", ".xml": "XML", ".scp": "SCP-ECG", ".edf": "EDF",
    ".h5": "HDF5", ".hdf5": "HDF5", ".nc": "HDF5", ".mat": "MAT", ".csv": "table",
    ".tsv": "table", ".txt": "table",
}  # fmt: skip
_ADVICE = {
    ".pkl": "pickle files can run any code and are never opened, save the recording as CSV",
    ".pickle": "pickle files can run any code and are never opened, save the recording as CSV",
    ".npy": "arrays without lead names are not read, save the recording as CSV",
    ".dat": "give its WFDB header, the .hea file beside it",
    ".bdf": "BDF is not read, save the recording as EDF",
    ".pdf": "give the recording itself, or digitise the picture to CSV",
}
_KNOWN = (
    "give WFDB (.hea), DICOM (.dcm), HL7 aECG or MUSE (.xml), SCP-ECG (.scp), EDF (.edf), HDF5 "
    "(.h5), MATLAB (.mat) or a table (.csv, .tsv)"
)


def read_recording(
    path: str | Path,
    *,
    leads: Sequence[str] | None = None,
    sampling_rate: float | None = None,
    unit: str | None = None,
) -> Recording:
    """Read a 12-lead recording.

    Parameters
    ----------
    path : path
        WFDB header (or the record name without suffix), DICOM waveform, HL7 aECG, MUSE XML,
        SCP-ECG, EDF or EDF+, HDF5, MATLAB or a table: see ``docs/recordings.md``.
    leads : sequence of str, optional
        Leads to use, of `fascicle.core.leads.LEADS`; by default all. Limb leads are computed where
        two of them are used.
    sampling_rate : float, optional
        Samples per second (Hz), for files that do not say.
    unit : str, optional
        Unit of the leads (nV, uV, mV, V), for files that do not say.

    Returns
    -------
    Recording
        Leads in mV, in the order of `fascicle.core.leads.LEADS`.

    Raises
    ------
    InputError
        When the file cannot be used; the message says why and what to do.
    """
    path = existing_file(as_path(path, "recording"))
    if leads is not None:
        check_items(leads, str, "leads", f"names of {', '.join(LEADS)}")
    if sampling_rate is not None:
        number(sampling_rate, "sampling_rate")
    if unit is not None:
        check_text(unit, "unit")
    options = ReadOptions(sampling_rate, unit)
    kind = _kind_of(path)
    if kind in _ISOLATED:
        raw = RawRecording.of_parts(read_isolated(read_parts, path, kind=kind, **asdict(options)))
    else:
        raw = _read(path, kind, options)
    recording = assemble(raw, str(path), options, leads)
    notes = {"source_sha256": sha256_of([path])}
    if leads is not None:
        notes["choice_leads"] = ", ".join(leads)
    if sampling_rate is not None:
        notes["choice_sampling_rate_hz"] = f"{sampling_rate:g}"
    if unit is not None:
        notes["choice_unit"] = unit
    return replace(recording, provenance=recording.provenance | notes)


def read_parts(path: Path, kind: str, **options: Any) -> dict[str, Any]:
    """Parts of the raw recording in a file whose library may crash."""
    return _read(path, kind, ReadOptions(**options)).parts


def _read(path: Path, kind: str, options: ReadOptions) -> RawRecording:
    module, function = _READERS[kind]
    raw: RawRecording = getattr(import_module(f"{__package__}.{module}"), function)(path, options)
    return raw


def existing_file(path: Path) -> Path:
    """Return the file itself, or the WFDB header of a record name.

    Raises
    ------
    InputError
        If there is neither.
    """
    if path.is_file():
        return path
    header = path.with_name(path.name + ".hea") if path.name else path
    if header.is_file():
        return header
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give one recording file")
    if path.exists():
        raise InputError(f"{path}: is not an ordinary file; give one recording file")
    raise InputError(f"{path}: no such file; check the name of the recording")


def _kind_of(path: Path) -> str:
    """Kind of a file by its suffix, or by its first bytes where it has none; both must agree."""
    suffix, size = path.suffix.lower(), path.stat().st_size
    if not 0 < size <= LARGEST_FILE:
        raise InputError(
            f"{path}: {size / 2**20:.0f} MB; cut the recording to a part of at most "
            f"{LARGEST_FILE / 2**20:.0f} MB, 10 s are enough"
            if size
            else f"{path}: the file is empty; download or export it again"
        )
    found = kind_of_content(path)
    kind = _KINDS.get(suffix)
    if kind is None and suffix not in _ADVICE:
        kind = found
    if kind is None:
        what = f"'{suffix}' recordings" if suffix else "recordings of unknown kind"
        raise InputError(f"{path}: {what} cannot be read; {_ADVICE.get(suffix, _KNOWN)}")
    # MATLAB's newer files are HDF5 inside
    if found is not None and found != kind and (found, kind) != ("HDF5", "MAT"):
        raise InputError(f"{path}: its content is {found}, not what its name says; rename it")
    return kind
