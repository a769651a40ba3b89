"""What kind of file a recording is, by its content, and how large it may be."""

from __future__ import annotations

from pathlib import Path

LARGEST_FILE = 512 * 2**20  # bytes; ten times what a recording of the longest length takes


def kind_of_content(path: Path) -> str | None:
    """Kind of file from marks that are unmistakable; None where there is none."""
    with path.open("rb") as file:
        start = file.read(512)
    if start[128:132] == b"DICM":
        return "DICOM"
    if start.startswith(b"\x89HDF\r\n\x1a\n"):
        return "HDF5"
    if start.startswith(b"MATLAB "):
        return "MAT" if b"HDF5" not in start[:128] else "HDF5"
    if start.startswith(b"0       ") and len(start) >= 256:
        return "EDF"
    if start[16:22] == b"SCPECG":
        return "SCP-ECG"
    if start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<?xml", b"<")):
        return "XML"
    return None
