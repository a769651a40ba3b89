"""DICOM waveform objects (12-lead, general and ambulatory ECG)."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.core.leads import CHEST_LEADS, limb_leads_from
from fascicle.recording.readers.content import LARGEST_FILE
from fascicle.recording.readers.declared import agreed_rate
from fascicle.recording.readers.dicom_groups import Group, group_filters, group_of, read_channels
from fascicle.recording.readers.names import first_line
from fascicle.recording.readers.raw_recording import Contents
from fascicle.recording.readers.read_options import Given
from fascicle.recording.recording import LONGEST, check_extent

# What pydicom raises on damaged elements, besides its own BytesLengthException
_PARSE_ERRORS = (
    ValueError, OSError, EOFError, KeyError, TypeError, AttributeError, NotImplementedError,
    RecursionError, struct.error, zlib.error,
)  # fmt: skip
_DEFLATE_RATIO = 1032  # at most, of zlib.net's technical details


def read_dicom(path: Path, given: Given) -> Contents:
    """Read the leads of a DICOM waveform object.

    Of several multiplex groups the one with the most leads counts and, of those, the one with the
    most samples: the rhythm, not the median beat. Where it lacks leads, groups that have them are
    joined to it by their time offsets; each lead is NaN outside its own time.

    Parameters
    ----------
    path : path
        The file.
    given : Given
        What the user says; it must agree with the file.

    Returns
    -------
    Contents
        Channels of those groups, in the units of their sensitivity.

    Raises
    ------
    InputError
        When the file has no waveform, is damaged, truncated, encrypted or compressed, or when a
        lead has no sensitivity or leads are not of the same time.

    References
    ----------
    DICOM PS3.3, section C.10.9 (waveform module) and PS3.17, annex C (waveforms).
    """
    groups = [group_of(item, k, str(path)) for k, item in enumerate(_waveforms(path), start=1)]
    chosen = _chosen(groups, path)
    rate = agreed_rate(path, chosen[0].rate, given)
    starts = _starts(chosen, rate, path)
    length = max(start + group.samples for start, group in zip(starts, chosen, strict=True))
    check_extent(length, rate, str(path))
    channels = []
    for start, group in zip(starts, chosen, strict=True):
        found = read_channels(group, rate, str(path))
        channels += [channel.placed(start, length) for channel in found]
    notes = {"multiplex_group": ", ".join(str(group.number) for group in chosen)}
    labels = [group.label for group in chosen if group.label]
    notes |= {"multiplex_group_label": ", ".join(labels)} if labels else {}
    filters = group_filters(chosen, str(path))
    return Contents(channels, rate, "DICOM waveform", filters, notes)


def _waveforms(path: Path) -> Sequence[Any]:
    """Return the items of the waveform sequence, all of their elements decoded."""
    import pydicom
    from pydicom.errors import BytesLengthException, InvalidDicomError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _check_syntax(path, pydicom.filereader.read_file_meta_info(path))
            # From memory, so that no element is longer than the file
            dataset = pydicom.dcmread(BytesIO(path.read_bytes()))
            items = dataset.get("WaveformSequence", None)
            if not isinstance(items, pydicom.Sequence) or not items:
                raise InputError(f"{path}: {_without_waveform(dataset)}")
            for item in items:
                list(item.iterall())
            return list(items)
    except InputError:
        raise
    except InvalidDicomError as error:
        raise InputError(
            f"{path}: not a DICOM file (no DICM mark); give a DICOM ECG waveform"
        ) from error
    except (*_PARSE_ERRORS, BytesLengthException) as error:
        found = printable(first_line(error))
        raise InputError(
            f"{path}: damaged or truncated DICOM file ({found}); export it again"
        ) from error


def _check_syntax(path: Path, meta: Any) -> None:
    """Refuse transfer syntaxes that waveforms are not stored in."""
    from pydicom.uid import (
        DeflatedExplicitVRLittleEndian,
        ExplicitVRLittleEndian,
        ImplicitVRLittleEndian,
    )

    syntax = meta.get("TransferSyntaxUID", None)
    plain = (None, ImplicitVRLittleEndian, ExplicitVRLittleEndian, DeflatedExplicitVRLittleEndian)
    if syntax not in plain:
        raise InputError(
            f"{path}: transfer syntax is {printable(str(getattr(syntax, 'name', syntax)))}, in "
            "which waveforms are not read; export it as Explicit VR Little Endian"
        )
    size = path.stat().st_size
    if syntax == DeflatedExplicitVRLittleEndian and size * _DEFLATE_RATIO > LARGEST_FILE:
        raise InputError(
            f"{path}: {size / 2**20:.1f} MB of deflated DICOM; export it as Explicit VR Little "
            "Endian, which is not compressed"
        )


def _without_waveform(dataset: Any) -> str:
    """Say what a file without a waveform is, and what to do."""
    if "EncryptedAttributesSequence" in dataset:
        return "encrypted DICOM file without a readable waveform; export it without encryption"
    kind = printable(str(dataset.get("Modality", None) or "unknown"))
    stored = getattr(dataset.get("SOPClassUID", None), "name", "") or "unknown object"
    return (
        f"DICOM file without a waveform (modality {kind}, {printable(stored)}); give a DICOM ECG "
        "waveform"
    )


def _chosen(groups: Sequence[Group], path: Path) -> list[Group]:
    """Return the group that counts, and those that have what it lacks."""
    ranked = sorted(groups, key=lambda group: (-len(group.leads), -group.samples))
    chosen, found = [ranked[0]], list(ranked[0].leads)
    for group in ranked[1:]:
        complete = set(CHEST_LEADS) <= set(found) and limb_leads_from(found) is not None
        if complete or not group.leads or set(group.leads) & set(found):
            continue
        if group.rate != chosen[0].rate:
            raise InputError(
                f"{path}: leads {', '.join(group.leads)} are sampled at {group.rate or 0:g} Hz, "
                f"{', '.join(chosen[0].leads)} at {chosen[0].rate or 0:g} Hz; export all leads at "
                "one rate"
            )
        chosen.append(group)
        found += group.leads
    return chosen


def _starts(groups: Sequence[Group], rate: float, path: Path) -> list[int]:
    """Return the first sample of each group on their common time."""
    if len(groups) == 1:
        return [0]
    unknown = [group for group in groups if group.offset is None]
    if unknown:
        raise InputError(
            f"{path}: leads {', '.join(unknown[0].leads)} are in a waveform of their own without a "
            "time offset to the others; export all leads in one waveform"
        )
    offsets = np.array([group.offset for group in groups], dtype=np.float64)
    if np.ptp(offsets) > LONGEST:
        raise InputError(
            f"{path}: its leads are recorded {np.ptp(offsets):.0f} s apart; export all leads over "
            "the same time"
        )
    return [int(start) for start in np.round((offsets - offsets.min()) * rate)]
