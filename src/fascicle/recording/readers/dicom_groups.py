"""Multiplex groups of DICOM waveforms: what their channels are, and their samples in units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError, printable
from fascicle.recording.readers.names import lead_name, lead_of_code
from fascicle.recording.readers.raw_recording import Channel, gain_of, strictest
from fascicle.recording.recording import Filters

_LONGEST_TEXT = 64  # characters, of DICOM's long strings (LO)
_MILLISECOND = 1e-3  # s
_LARGEST_SKEW = 0.5  # samples between channels of a group; less is multiplexing
_PREFIXES = {"MDC": "2:", "SCPECG": "5.6.3-9-"}  # of the codes of DICOM's CID 3001, ECG leads
_SAMPLES = {
    (8, "SB"): np.int8, (8, "UB"): np.uint8, (16, "SS"): np.int16, (16, "US"): np.uint16,
    (32, "SL"): np.int32, (32, "UL"): np.uint32,
}  # fmt: skip


@dataclass(frozen=True)
class Group:
    """A multiplex group; its rate (Hz) and time offset (s) are None where it does not say them.

    `sources` are name and lead of each channel; the lead is None where it is none of the twelve.
    """

    item: Any
    number: int
    label: str
    samples: int
    rate: float | None
    offset: float | None
    channels: Sequence[Any]
    sources: Sequence[tuple[str, str | None]]

    @property
    def leads(self) -> list[str]:
        """Standard names of its leads."""
        return [lead for _, lead in self.sources if lead is not None]


def group_of(item: Any, number: int, source: str) -> Group:
    """Describe an item of the waveform sequence without reading its samples.

    Parameters
    ----------
    item : pydicom.Dataset
        The item, with all of its elements decoded.
    number : int
        Its place in the sequence, from 1.
    source : str
        What messages begin with.

    Raises
    ------
    InputError
        When an element that is needed is missing or makes no sense.
    """
    channels = _items(item, "ChannelDefinitionSequence")
    samples = _number(item, "NumberOfWaveformSamples", source)
    stated = _number(item, "NumberOfWaveformChannels", source)
    if not channels or not samples:
        raise InputError(
            f"{source}: waveform {number} has {len(channels)} channels of {samples or 0:g} "
            "samples; export the recording again"
        )
    if stated != len(channels):
        raise InputError(
            f"{source}: waveform {number} should have {stated or 0:g} channels, but describes "
            f"{len(channels)}; export the recording again"
        )
    offset = _number(item, "MultiplexGroupTimeOffset", source)
    return Group(
        item=item,
        number=number,
        label=_text(item, "MultiplexGroupLabel"),
        samples=int(samples),
        rate=_number(item, "SamplingFrequency", source),
        offset=None if offset is None else offset * _MILLISECOND,
        channels=channels,
        sources=[_source(channel, k, source) for k, channel in enumerate(channels, start=1)],
    )


def read_channels(group: Group, rate: float, source: str) -> list[Channel]:
    """Read the samples of a group.

    ``value = (sample * sensitivity * correction factor) + baseline`` (DICOM PS3.3, C.10.9.1.4);
    padding is NaN.

    Parameters
    ----------
    group : Group
        The group.
    rate : float
        Its samples per second (Hz).
    source : str
        What messages begin with.

    Raises
    ------
    InputError
        When samples are missing or stored in a way that is unknown, when a lead has no
        sensitivity, or when it is delayed against the others.
    """
    samples, padding = _samples(group, source)
    channels = []
    for k, (channel, (name, lead)) in enumerate(zip(group.channels, group.sources, strict=True)):
        if lead is None:
            channels.append(Channel(name, np.full(group.samples, np.nan), None))
            continue
        _check_skew(channel, lead, rate, source)
        sensitivity = _sensitivity(channel, lead, source)
        values = samples[:, k] * sensitivity + _default(channel, "ChannelBaseline", 0.0, source)
        values[samples[:, k] == padding] = np.nan
        unit = _unit(channel)
        channels.append(Channel(name, values, unit, lead, gain_of(sensitivity, unit)))
    return channels


def group_filters(groups: Sequence[Group], source: str) -> Filters:
    """Return the narrowest pass band that the leads of some groups had in the recorder.

    Parameters
    ----------
    groups : sequence of Group
        The groups whose leads are used.
    source : str
        What messages begin with.

    Raises
    ------
    InputError
        When a frequency is not a number.
    """
    leads = [
        channel
        for group in groups
        for channel, (_, lead) in zip(group.channels, group.sources, strict=True)
        if lead is not None
    ]

    def stated(keyword: str) -> list[float]:
        return [_default(channel, keyword, 0.0, source) for channel in leads]

    return strictest(
        # the low frequency is where the pass band begins: that of the high-pass filter
        highpass=stated("FilterLowFrequency"),
        lowpass=stated("FilterHighFrequency"),
        notch=stated("NotchFilterFrequency"),
    )


def _samples(group: Group, source: str) -> tuple[NDArray[Any], int | None]:
    """Return the samples (n, channels) as they are stored, and the value that is padding."""
    bits = _number(group.item, "WaveformBitsAllocated", source)
    interpretation = _text(group.item, "WaveformSampleInterpretation")
    kind = _SAMPLES.get((int(bits or 0), interpretation))
    if kind is None:
        raise InputError(
            f"{source}: samples are of {bits or 0:g} bits, interpretation "
            f"'{interpretation}'; export them as 16 bit signed integers (SS)"
        )
    element = group.item.get("WaveformData", None) and group.item["WaveformData"]
    data = b"" if element is None else element.value
    if not isinstance(data, bytes) or (element is not None and element.is_undefined_length):
        raise InputError(
            f"{source}: its waveform is encapsulated, as compressed data are; export it without "
            "compression"
        )
    stored = np.dtype(kind).newbyteorder("<")
    count = group.samples * len(group.channels)
    if len(data) < count * stored.itemsize:
        raise InputError(
            f"{source}: its waveform is truncated: {group.samples} samples of "
            f"{len(group.channels)} channels are {count * stored.itemsize} bytes, "
            f"{len(data)} found; export it again"
        )
    padding = group.item.get("WaveformPaddingValue", None)
    known = isinstance(padding, bytes) and len(padding) >= stored.itemsize
    samples = np.frombuffer(data, stored, count).reshape(group.samples, len(group.channels))
    return samples, int(np.frombuffer(padding, stored, 1)[0]) if known else None


def _source(channel: Any, number: int, source: str) -> tuple[str, str | None]:
    """Return the name of a channel and the lead that it is; a known code decides."""
    codes = _items(channel, "ChannelSourceSequence")
    meaning = _text(codes[0], "CodeMeaning") if codes else ""
    label = _text(channel, "ChannelLabel")
    name = meaning or label or f"channel {number}"
    code = _text(codes[0], "CodeValue") if codes else ""
    prefix = _PREFIXES.get(_text(codes[0], "CodingSchemeDesignator").upper()) if codes else None
    if prefix is None or not code.startswith(prefix):
        return name, lead_name(meaning) or lead_name(label)
    lead = lead_of_code(code)
    if lead_name(meaning) not in (None, lead):
        raise InputError(
            f"{source}: channel {number} has the code {code} of {lead or 'another lead'}, but is "
            f"called '{meaning}'; export the recording again"
        )
    return name, lead


def _sensitivity(channel: Any, lead: str, source: str) -> float:
    """Return the units of one digit."""
    sensitivity = _number(channel, "ChannelSensitivity", source)
    if sensitivity is None:
        raise InputError(
            f"{source}: unknown unit of lead {lead} (no channel sensitivity); export the waveform "
            "calibrated in uV or mV"
        )
    sensitivity *= _default(channel, "ChannelSensitivityCorrectionFactor", 1.0, source)
    if sensitivity == 0:
        raise InputError(
            f"{source}: sensitivity of lead {lead} is 0; export the waveform calibrated in uV or mV"
        )
    return sensitivity


def _unit(channel: Any) -> str | None:
    units = _items(channel, "ChannelSensitivityUnitsSequence")
    return (_text(units[0], "CodeValue") or None) if units else None


def _check_skew(channel: Any, lead: str, rate: float, source: str) -> None:
    """Refuse a channel that is not of the same time as the others of its group."""
    skew = _number(channel, "ChannelSampleSkew", source)
    if skew is None:
        skew = _default(channel, "ChannelTimeSkew", 0.0, source) * rate
    skew += _default(channel, "ChannelOffset", 0.0, source) * rate
    if abs(skew) > _LARGEST_SKEW:
        raise InputError(
            f"{source}: lead {lead} is {skew:g} samples apart from its group; export all leads "
            "over the same time"
        )


def _items(item: Any, keyword: str) -> Sequence[Any]:
    """Return the items of a sequence; none where it is absent or something else."""
    from pydicom import Sequence as Items

    found = item.get(keyword, None)
    return list(found) if isinstance(found, Items) else []


def _text(item: Any, keyword: str) -> str:
    """Return a text of an item, fit for a message: damaged ones run on."""
    return printable(str(item.get(keyword, None) or "").strip()[:_LONGEST_TEXT])


def _default(item: Any, keyword: str, absent: float, source: str) -> float:
    value = _number(item, keyword, source)
    return absent if value is None else value


def _number(item: Any, keyword: str, source: str) -> float | None:
    """Return a number of an item; None where it is absent or empty."""
    value = item.get(keyword, None)
    if value is None or value == "":
        return None
    try:
        number = float(value)
    except (ValueError, TypeError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(
            f"{source}: {keyword} is '{printable(str(value))[:40]}', not a number; export the "
            "recording again"
        )
    return number
