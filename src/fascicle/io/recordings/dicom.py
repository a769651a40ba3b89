"""DICOM waveform objects (12-lead ECG, general ECG)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.errors import InputError
from fascicle.io.recordings.contents import Channel, Contents, Given
from fascicle.io.recordings.names import first_line, lead_name, lead_of_code

# What pydicom raises on damaged elements
_PARSE_ERRORS = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    NotImplementedError,
)


def read_dicom(path: Path, given: Given) -> Contents:
    """Read the multiplex group with the most leads and, of those, the most samples."""
    dataset = _open(path)
    if "WaveformSequence" not in dataset or not dataset.WaveformSequence:
        kind = dataset.get("Modality", None) or "unknown"
        raise InputError(
            f"{path}: DICOM file without a waveform (modality {kind}); give a DICOM ECG waveform"
        )
    try:
        groups = [_channels(group) for group in dataset.WaveformSequence]
        sizes = [int(group.NumberOfWaveformSamples) for group in dataset.WaveformSequence]
        rates = [float(group.SamplingFrequency) for group in dataset.WaveformSequence]
        best = max(range(len(groups)), key=lambda k: (len(groups[k]), sizes[k]))
        values = np.asarray(dataset.waveform_array(best), dtype=np.float64)
    except _PARSE_ERRORS as error:
        raise InputError(
            f"{path}: its waveform is truncated or damaged ({first_line(error)}); export it again"
        ) from error
    definitions = dataset.WaveformSequence[best].ChannelDefinitionSequence
    channels = [
        Channel(lead, values[:, column], _unit(path, lead, definitions[column]), lead)
        for lead, column in groups[best].items()
    ]
    notes = {"multiplex_group": str(best + 1)}
    return Contents(channels, rates[best], "DICOM waveform", notes=notes)


def _open(path: Path) -> Any:
    import pydicom
    from pydicom.errors import InvalidDicomError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pydicom.dcmread(path)
    except InvalidDicomError as error:
        raise InputError(
            f"{path}: not a DICOM file (no DICM mark); give a DICOM ECG waveform"
        ) from error
    except _PARSE_ERRORS as error:
        raise InputError(
            f"{path}: damaged DICOM file ({first_line(error)}); export it again"
        ) from error


def _channels(group: Any) -> dict[str, int]:
    """Map the standard lead names of a multiplex group to its columns."""
    columns: dict[str, int] = {}
    for column, channel in enumerate(group.ChannelDefinitionSequence):
        source = channel.get("ChannelSourceSequence", None)
        lead = None
        if source:
            lead = lead_of_code(str(source[0].get("CodeValue", "")))
            lead = lead or lead_name(str(source[0].get("CodeMeaning", "")))
        lead = lead or lead_name(str(channel.get("ChannelLabel", "")))
        if lead is not None:
            columns.setdefault(lead, column)
    return columns


def _unit(path: Path, lead: str, channel: Any) -> str:
    """Return the unit of a channel; without a sensitivity its numbers have none."""
    units = channel.get("ChannelSensitivityUnitsSequence", None)
    if not units or "ChannelSensitivity" not in channel:
        raise InputError(
            f"{path}: unknown unit of lead {lead} (no channel sensitivity); export the waveform "
            "calibrated in uV or mV"
        )
    return str(units[0].get("CodeValue", ""))
