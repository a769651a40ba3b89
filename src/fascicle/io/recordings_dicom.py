"""DICOM waveform objects (12-lead ECG, general ECG)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.io.recordings_names import (
    assemble,
    first_line,
    lead_name,
    lead_of_code,
    millivolts,
)
from fascicle.recording.recording import Recording

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


def read_dicom(path: Path) -> Recording:
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
    leads: dict[str, NDArray[np.float64]] = {
        lead: _scale(path, lead, definitions[column]) * values[:, column]
        for lead, column in groups[best].items()
    }
    provenance = {"format": "DICOM waveform", "multiplex_group": str(best + 1)}
    return assemble(leads, rates[best], str(path), provenance)


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


def _scale(path: Path, lead: str, channel: Any) -> float:
    """Return the mV of one unit of a channel."""
    units = channel.get("ChannelSensitivityUnitsSequence", None)
    unit = str(units[0].get("CodeValue", "")) if units else ""
    scale = millivolts(unit)
    if scale is None or "ChannelSensitivity" not in channel:
        found = f"'{unit}'" if unit and scale is None else "no channel sensitivity"
        raise InputError(
            f"{path}: unknown units of lead {lead} ({found}); export the waveform calibrated in uV "
            "or mV"
        )
    return scale
