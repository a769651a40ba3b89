"""Formats of recordings that can be read, a `Reader` each: help texts follow from this list.

Nothing heavy is imported here: a format's own module loads when a file of it is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from fascicle.core.errors import InputError


@dataclass(frozen=True)
class Reader:
    """Reader of the files of one format.

    Attributes
    ----------
    format : str
        Name of the format.
    suffixes : tuple of str
        Endings of the names of its files, such as ``.csv``.
    read : function
        Called as ``read(path, sampling_rate)``, returns a `RawRecording`. `sampling_rate` is the
        rate that the user states, usually None. A file for which it raises an exception other than
        `InputError` is reported as damaged.
    recognises : function, optional
        Whether a file that begins with these bytes (at most 512) is of this format. The content
        counts before the name.
    largest : int
        Size of the largest file that is opened (bytes).
    isolated : bool
        Whether to read in a child process with limits on its time and memory, which cannot reach
        functions that a script or a notebook defines.
    """

    format: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, float | None], Any]
    recognises: Callable[[bytes], bool] = lambda start: False
    largest: int = 512 * 2**20
    isolated: bool = False


def _built_in(name: str, suffixes: str, place: str, beginning: bytes = b"(?!)") -> Reader:
    """Reader by a function, ``module:function``, loaded when it is called, and how files begin."""
    begin = re.compile(beginning, re.DOTALL).match

    def read(path: Path, sampling_rate: float | None) -> Any:
        return resolve_name(f"fascicle.recording.readers.{place}")(path, sampling_rate)

    return Reader(
        name, tuple(suffixes.split()), read, lambda start: begin(start) is not None, isolated=True
    )


READERS = [
    _built_in("WFDB", ".hea", "clinical:read_wfdb"),
    _built_in("DICOM waveform", ".dcm", "dicom:read_dicom", b".{128}DICM"),
    _built_in(
        "HL7 aECG, GE MUSE or CardioSoft, Philips, Mortara or Schiller XML", ".xml",
        "clinical:read_clinical",
        b"[\xef\xbb\xbf\xff\xfe \t\r\n\0]*<",
    ),
    _built_in("SCP-ECG", ".scp", "clinical:read_clinical", b".{16}SCPECG"),
    _built_in("EDF", ".edf", "clinical:read_clinical", b"0 {7}.{248}"),
    _built_in("ISHNE", ".ecg", "clinical:read_clinical", b"ISHNE1[.]0"),
    _built_in("MFER", ".mwf .mfer", "clinical:read_clinical"),
    _built_in("HDF5", ".h5 .hdf5 .nc", "arrays:read_hdf5", b"\x89HDF\r\n\x1a\n"),
    _built_in("MATLAB", ".mat", "arrays:read_matlab", b"MATLAB "),
    _built_in("table", ".csv .tsv .txt", "tables:read_table"),
    _built_in("LabSystem Pro text", ".txt", "tables:read_labsystem", rb"\s*\[Header\]"),
]  # fmt: skip


def register_reader(reader: Reader) -> None:
    """Add a format to those that are read, in this process; it comes before the others.

    A reader of the same name is replaced.
    """
    READERS[:] = [reader, *(other for other in READERS if other.format != reader.format)]


def known_formats() -> str:
    """Formats with their suffixes, for help texts and messages."""
    return ", ".join(f"{reader.format} ({', '.join(reader.suffixes)})" for reader in READERS)


def reader_of(path: Path) -> Reader:
    """Reader of a file that is not empty or too large, by its content or else by its name."""
    with path.open("rb") as file:
        start, suffix = file.read(512), path.suffix.lower()
    readers = [reader for reader in READERS if reader.recognises(start)]
    readers += [reader for reader in READERS if suffix in reader.suffixes]
    if not start or not readers:
        problem = f"'{suffix}' recordings cannot be read" if start else "the file is empty"
        raise InputError(f"{path}: {problem}; give {known_formats()}")
    size, largest = path.stat().st_size / 2**20, readers[0].largest / 2**20
    if size > largest:
        raise InputError(
            f"{path}: {size:.0f} MB; cut the recording to a part of at most {largest:.0f} MB, 10 s "
            "are enough"
        )
    return readers[0]
