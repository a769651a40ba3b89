"""DICOM waveform objects (12-lead, general and ambulatory ECG)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, overload

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.core.leads import CHEST_LEADS, limb_leads_from
from fascicle.recording.readers.content import LARGEST_FILE, refuse_damaged
from fascicle.recording.readers.names import lead_name, lead_of_code
from fascicle.recording.readers.raw_recording import (
    Channel,
    RawRecording,
    ReadOptions,
    gain_of,
    narrowest_passband,
)
from fascicle.recording.recording import LONGEST, Filters, check_extent

_DEFLATE_RATIO = 1032  # at most, of zlib.net's technical details
_LONGEST_TEXT = 64  # characters, of DICOM's long strings (LO)
_MILLISECOND = 1e-3  # s
_LARGEST_SKEW = 0.5  # samples between channels of a group; less is multiplexing
_PREFIXES = {"MDC": "2:", "SCPECG": "5.6.3-9-"}  # of the codes of DICOM's CID 3001, ECG leads
_SAMPLES = {
    (8, "SB"): np.int8, (8, "UB"): np.uint8, (16, "SS"): np.int16, (16, "US"): np.uint16,
    (32, "SL"): np.int32, (32, "UL"): np.uint32,
}  # fmt: skip


@dataclass(frozen=True)
class _Group:
    """A multiplex group; its rate (Hz) and time offset (s) are None where it does not say them.

    `sources` are name and lead of each channel; the lead is None where it is none of the twelve.
    """

    item: Any
    number: int
    samples: int
    rate: float | None
    offset: float | None
    channels: Sequence[Any]
    sources: Sequence[tuple[str, str | None]]

    @property
    def leads(self) -> list[str]:
        """Standard names of its leads."""
        return [lead for _, lead in self.sources if lead is not None]


def read_dicom(path: Path, options: ReadOptions) -> RawRecording:
    """Read the leads of a DICOM waveform object.

    Of several multiplex groups the one with the most leads counts and, of those, the one with the
    most samples: the rhythm, not the median beat. Where it lacks leads, groups that have them are
    joined to it by their time offsets; each lead is NaN outside its own time.

    References
    ----------
    DICOM PS3.3, section C.10.9 (waveform module) and PS3.17, annex C (waveforms).
    """
    source = str(path)
    groups = [_group(item, k, source) for k, item in enumerate(_waveforms(path), start=1)]
    chosen = _chosen(groups, source)
    rate = options.agreed_rate(path, chosen[0].rate)
    starts = _starts(chosen, rate, source)
    length = max(start + group.samples for start, group in zip(starts, chosen, strict=True))
    check_extent(length, rate, source)
    channels = []
    for start, group in zip(starts, chosen, strict=True):
        channels += [found.placed(start, length) for found in _channels(group, rate, path)]
    provenance = {"multiplex_group": ", ".join(str(group.number) for group in chosen)}
    labels = ", ".join(filter(None, (_text(g.item, "MultiplexGroupLabel") for g in chosen)))
    provenance |= {"multiplex_group_label": labels} if labels else {}
    filters = _filters(chosen, source)
    return RawRecording(channels, rate, "DICOM waveform", filters, provenance)


def _waveforms(path: Path) -> Sequence[Any]:
    """Return the items of the waveform sequence, all of their elements decoded."""
    import pydicom
    from pydicom.errors import BytesLengthException, InvalidDicomError

    with (
        warnings.catch_warnings(),
        refuse_damaged(path, "DICOM", BytesLengthException, InvalidDicomError),
    ):
        warnings.simplefilter("ignore")
        _check_syntax(path, pydicom.filereader.read_file_meta_info(path))
        # From memory, so that no element is longer than the file
        dataset = pydicom.dcmread(BytesIO(path.read_bytes()))
        items = dataset.get("WaveformSequence", None)
        if isinstance(items, pydicom.Sequence) and items:
            for item in items:
                list(item.iterall())
            return list(items)
        encrypted = "encrypted " * ("EncryptedAttributesSequence" in dataset)
        kind = _text(dataset, "Modality") or "unknown"
        stored = getattr(dataset.get("SOPClassUID", None), "name", "") or "unknown object"
        raise InputError(
            f"{path}: {encrypted}DICOM file without a waveform (modality {kind}, "
            f"{printable(stored)}); give a DICOM ECG waveform without encryption"
        )


def _check_syntax(path: Path, meta: Any) -> None:
    """Refuse transfer syntaxes that waveforms are not stored in."""
    from pydicom import uid

    syntax = meta.get("TransferSyntaxUID", None)
    plain = (None, uid.ImplicitVRLittleEndian, uid.ExplicitVRLittleEndian)
    size = path.stat().st_size
    small = size * _DEFLATE_RATIO <= LARGEST_FILE
    if syntax not in plain and not (syntax == uid.DeflatedExplicitVRLittleEndian and small):
        raise InputError(
            f"{path}: transfer syntax is {printable(str(getattr(syntax, 'name', syntax)))}, in "
            f"which waveforms of {size / 2**20:.1f} MB are not read; export it as Explicit VR "
            "Little Endian"
        )


def _group(item: Any, number: int, source: str) -> _Group:
    """Describe an item of the waveform sequence without reading its samples."""
    channels = _items(item, "ChannelDefinitionSequence")
    samples = _number(item, "NumberOfWaveformSamples", source)
    declared = _number(item, "NumberOfWaveformChannels", source)
    if not channels or not samples or declared != len(channels):
        raise InputError(
            f"{source}: waveform {number} has {declared or 0:g} channels of {samples or 0:g} "
            f"samples and describes {len(channels)} channels; export the recording again"
        )
    offset = _number(item, "MultiplexGroupTimeOffset", source)
    return _Group(
        item=item,
        number=number,
        samples=int(samples),
        rate=_number(item, "SamplingFrequency", source),
        offset=None if offset is None else offset * _MILLISECOND,
        channels=channels,
        sources=[_source(channel, k, source) for k, channel in enumerate(channels, start=1)],
    )


def _source(channel: Any, number: int, source: str) -> tuple[str, str | None]:
    """Return the name of a channel and the lead that it is; a known code decides."""
    codes = _items(channel, "ChannelSourceSequence")
    meaning, code, scheme = (
        _text(codes[0], keyword) if codes else ""
        for keyword in ("CodeMeaning", "CodeValue", "CodingSchemeDesignator")
    )
    label = _text(channel, "ChannelLabel")
    name = meaning or label or f"channel {number}"
    prefix = _PREFIXES.get(scheme.upper())
    if prefix is None or not code.startswith(prefix):
        return name, lead_name(meaning) or lead_name(label)
    lead = lead_of_code(code)
    if lead_name(meaning) not in (None, lead):
        raise InputError(
            f"{source}: channel {number} has the code {code} of {lead or 'another lead'}, but is "
            f"called '{meaning}'; export the recording again"
        )
    return name, lead


def _chosen(groups: Sequence[_Group], source: str) -> list[_Group]:
    """Return the group that counts, and those that have what it lacks."""
    ranked = sorted(groups, key=lambda group: (-len(group.leads), -group.samples))
    chosen, found = [ranked[0]], list(ranked[0].leads)
    for group in ranked[1:]:
        complete = set(CHEST_LEADS) <= set(found) and limb_leads_from(found) is not None
        if complete or not group.leads or set(group.leads) & set(found):
            continue
        if group.rate != chosen[0].rate:
            raise InputError(
                f"{source}: leads {', '.join(group.leads)} are sampled at {group.rate or 0:g} Hz, "
                f"{', '.join(chosen[0].leads)} at {chosen[0].rate or 0:g} Hz; export all leads at "
                "one rate"
            )
        chosen.append(group)
        found += group.leads
    return chosen


def _starts(groups: Sequence[_Group], rate: float, source: str) -> list[int]:
    """Return the first sample of each group on their common time."""
    if len(groups) == 1:
        return [0]
    unknown = [group for group in groups if group.offset is None]
    if unknown:
        raise InputError(
            f"{source}: leads {', '.join(unknown[0].leads)} are in a waveform of their own without "
            "a time offset to the others; export all leads in one waveform"
        )
    offsets = np.array([group.offset for group in groups], dtype=np.float64)
    if np.ptp(offsets) > LONGEST:
        raise InputError(
            f"{source}: its leads are recorded {np.ptp(offsets):.0f} s apart; export all leads "
            "over the same time"
        )
    return [int(start) for start in np.round((offsets - offsets.min()) * rate)]


def _channels(group: _Group, rate: float, path: Path) -> list[Channel]:
    """Read the samples of a group.

    ``value = (sample * sensitivity * correction factor) + baseline`` (DICOM PS3.3, C.10.9.1.4);
    padding is NaN.
    """
    source = str(path)
    bits = _number(group.item, "WaveformBitsAllocated", source)
    interpretation = _text(group.item, "WaveformSampleInterpretation")
    kind = _SAMPLES.get((int(bits or 0), interpretation))
    if kind is None:
        raise InputError(
            f"{source}: samples are of {bits or 0:g} bits, interpretation '{interpretation}'; "
            "export them as 16 bit signed integers (SS)"
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
    with refuse_damaged(path, "DICOM"):
        samples = np.frombuffer(data, stored, count).reshape(group.samples, -1)
    padding = group.item.get("WaveformPaddingValue", None)
    padded = isinstance(padding, bytes) and len(padding) >= stored.itemsize
    channels = []
    for k, (channel, (name, lead)) in enumerate(zip(group.channels, group.sources, strict=True)):
        if lead is None:
            channels.append(Channel(name, np.full(group.samples, np.nan), None))
            continue
        _check_skew(channel, lead, rate, source)
        sensitivity = _sensitivity(channel, lead, source)
        values = samples[:, k] * sensitivity + _number(channel, "ChannelBaseline", source, 0.0)
        if padded:
            values[samples[:, k] == np.frombuffer(padding, stored, 1)] = np.nan
        units = _items(channel, "ChannelSensitivityUnitsSequence")
        unit = (_text(units[0], "CodeValue") or None) if units else None
        channels.append(Channel(name, values, unit, lead, gain_of(sensitivity, unit)))
    return channels


def _sensitivity(channel: Any, lead: str, source: str) -> float:
    """Return the units of one digit."""
    sensitivity = _number(channel, "ChannelSensitivity", source, 0.0)
    sensitivity *= _number(channel, "ChannelSensitivityCorrectionFactor", source, 1.0)
    if sensitivity == 0:
        raise InputError(
            f"{source}: unknown unit of lead {lead} (no channel sensitivity, or 0); export the "
            "waveform calibrated in uV or mV"
        )
    return sensitivity


def _check_skew(channel: Any, lead: str, rate: float, source: str) -> None:
    """Refuse a channel that is not of the same time as the others of its group."""
    of_time = _number(channel, "ChannelTimeSkew", source, 0.0) * rate
    skew = _number(channel, "ChannelSampleSkew", source, of_time)
    skew += _number(channel, "ChannelOffset", source, 0.0) * rate
    if abs(skew) > _LARGEST_SKEW:
        raise InputError(
            f"{source}: lead {lead} is {skew:g} samples apart from its group; export all leads "
            "over the same time"
        )


def _filters(groups: Sequence[_Group], source: str) -> Filters:
    """Return the narrowest pass band that the leads of some groups had in the recorder."""
    leads = [
        channel
        for group in groups
        for channel, (_, lead) in zip(group.channels, group.sources, strict=True)
        if lead is not None
    ]
    # the low frequency is where the pass band begins: that of the high-pass filter
    keywords = ("FilterLowFrequency", "FilterHighFrequency", "NotchFilterFrequency")
    return narrowest_passband(
        *([_number(lead, keyword, source, 0.0) for lead in leads] for keyword in keywords)
    )


def _items(item: Any, keyword: str) -> Sequence[Any]:
    """Return the items of a sequence; none where it is absent or something else."""
    from pydicom import Sequence as Items

    found = item.get(keyword, None)
    return list(found) if isinstance(found, Items) else []


def _text(item: Any, keyword: str) -> str:
    """Return a text of an item, fit for a message: damaged ones run on."""
    return printable(str(item.get(keyword, None) or "").strip()[:_LONGEST_TEXT])


@overload
def _number(item: Any, keyword: str, source: str) -> float | None: ...
@overload
def _number(item: Any, keyword: str, source: str, absent: float) -> float: ...
def _number(item: Any, keyword: str, source: str, absent: float | None = None) -> float | None:
    """Return a number of an item; `absent` where it is absent or empty."""
    value = item.get(keyword, None)
    if value is None or value == "":
        return absent
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
