"""DICOM waveform objects (12-lead, general and ambulatory ECG), by pydicom.

ecgdatakit reads one multiplex group of a file only: of leads recorded in turns of three it would
lose nine.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.errors import InputError, printable
from fascicle.core.leads import CHEST_LEADS, limb_leads_from
from fascicle.recording.readers.names import lead_name, lead_of_code, millivolts
from fascicle.recording.readers.read import Channel, RawRecording, narrowest_passband, without_fill


class _MultiplexGroup:
    """A multiplex group: its metadata, and the leads that are recorded in it.

    `sources` are name and lead of each channel; the lead is None for a channel that is none of the
    twelve.
    """

    def __init__(self, item: Any, index: int) -> None:
        self.item, self.index = item, index
        self.samples = int(item.NumberOfWaveformSamples)
        self.rate = _number(item, "SamplingFrequency")
        self.channels = _items(item, "ChannelDefinitionSequence")
        if item.NumberOfWaveformChannels != len(self.channels):
            raise ValueError(f"waveform {index + 1} describes {len(self.channels)} channels")
        self.sources = [_source(channel, k) for k, channel in enumerate(self.channels, start=1)]
        self.leads = [lead for _, lead in self.sources if lead is not None]
        offset = _number(item, "MultiplexGroupTimeOffset", math.nan)
        self.start = offset * 1e-3 * (self.rate or math.nan)  # samples; NaN if the rate is 0
        label = _text(item, "MultiplexGroupLabel").upper()
        self.averaged = _text(item, "WaveformOriginality") == "DERIVED" or "MEDIAN" in label


def read_dicom(path: Path, sampling_rate: float | None) -> RawRecording:
    """Read the leads of a DICOM waveform object.

    Of several multiplex groups the one with the most leads is read and, of those, the one with the
    most samples: the rhythm, not the median beat. Where it lacks leads, groups that have them are
    joined to it by their time offsets, and those that continue its leads, such as a rhythm strip;
    each lead is NaN outside its own time. A channel that is constant in one group and not in
    another is not recorded in the first.

    References
    ----------
    DICOM PS3.3, section C.10.9 (waveform module) and PS3.17, annex C (waveforms).
    """
    import pydicom
    from pydicom import uid
    from pydicom.waveforms import multiplex_array

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # some writers leave out the preamble before the data set
        dataset = pydicom.dcmread(path, force=path.suffix.lower() == ".dcm")
        items = _items(dataset, "WaveformSequence")
        for item in items:
            list(item.iterall())  # decodes all elements
    plain = (uid.ExplicitVRLittleEndian, uid.ImplicitVRLittleEndian)
    if "TransferSyntaxUID" not in dataset.file_meta:
        dataset.file_meta.TransferSyntaxUID = plain[bool(dataset.original_encoding[0])]
    if not items:
        kind = _text(dataset, "Modality") or "unknown"
        stored = getattr(dataset.get("SOPClassUID", None), "name", "") or "unknown object"
        raise InputError(
            f"{path}: DICOM file without a waveform (modality {kind}, {printable(stored)}); give a "
            "DICOM ECG waveform without encryption"
        )
    syntax = dataset.file_meta.TransferSyntaxUID
    compressed = any(
        item["WaveformData"].is_undefined_length  # encapsulated
        or item.WaveformSampleInterpretation in ("MB", "AB")  # mu-law, A-law
        for item in items
    )
    if compressed or syntax not in (*plain, uid.DeflatedExplicitVRLittleEndian):
        raise InputError(
            f"{path}: its waveform is compressed or big-endian ({printable(syntax.name)}); export "
            "it as Explicit VR Little Endian"
        )
    remarks = [remark for item in items for remark in _mended(item)]
    groups = [_MultiplexGroup(item, k) for k, item in enumerate(items)]
    if len(groups) > 1:
        # leads are not recorded in groups in which they are constant, if they move in another
        moving = []
        for group in groups:
            rows = zip(group.sources, multiplex_array(dataset, group.index).T, strict=True)
            moving.append({lead for (_, lead), row in rows if np.ptp(row) > 0})
        anywhere = set().union(*moving)
        for group, recorded in zip(groups, moving, strict=True):
            empty = anywhere - recorded
            group.leads = [lead for lead in group.leads if lead not in empty]
    chosen = _chosen(groups, path)
    rate = chosen[0].rate or sampling_rate or math.nan
    starts = [0]
    if len(chosen) > 1:
        offsets = np.array([group.start for group in chosen])
        if not np.isfinite(offsets).all():
            raise InputError(
                f"{path}: its leads are in several waveforms without time offsets; export all "
                "leads in one waveform"
            )
        starts = [int(start) for start in np.round(offsets - offsets.min())]
    length = max(start + group.samples for start, group in zip(starts, chosen, strict=True))
    channels: list[Channel] = []
    for start, group in zip(starts, chosen, strict=True):
        for channel in _channels(group, multiplex_array(dataset, group.index), path):
            unpadded = replace(channel, values=without_fill(channel, rate), missing=())
            channels.append(unpadded.placed(start, length))
    channels, joined = _joined_parts(channels)
    provenance = {"multiplex_group": ", ".join(str(group.index + 1) for group in chosen)} | joined
    labels = [_text(group.item, "MultiplexGroupLabel") for group in chosen]
    provenance |= {"multiplex_group_label": ", ".join(filter(None, labels))} if any(labels) else {}
    leads = [
        channel
        for group in chosen
        for channel, (_, lead) in zip(group.channels, group.sources, strict=True)
        if lead is not None
    ]
    # the low frequency is where the pass band begins: that of the high-pass filter
    keywords = ("FilterLowFrequency", "FilterHighFrequency", "NotchFilterFrequency")
    filters = narrowest_passband(*([_number(lead, word) for lead in leads] for word in keywords))
    return RawRecording(
        channels,
        chosen[0].rate or None,
        filters=filters,
        provenance=provenance,
        remarks=tuple(remarks),
    )


def _mended(item: Any) -> list[str]:
    """Correct a group's stated size where the true one is certain; return remarks on the change."""
    described, data = len(_items(item, "ChannelDefinitionSequence")), len(item.WaveformData)
    channels, samples = item.NumberOfWaveformChannels, item.NumberOfWaveformSamples
    frame = described * item.get("WaveformBitsAllocated", 0) // 8
    held = data // frame if frame else 0
    if held == samples and channels != described:
        item.NumberOfWaveformChannels = described
        return [f"states {channels} channels in a waveform and describes {described}, all its data"]
    if channels == described and 0 < held < samples:
        item.NumberOfWaveformSamples = held
        return [f"states {samples} samples in a waveform and holds {held}, which are read"]
    return []


def _source(channel: Any, number: int) -> tuple[str, str | None]:
    """Return the name of a channel and the lead that it is; a known code decides."""
    codes = _items(channel, "ChannelSourceSequence")
    meaning, code, scheme = (
        _text(codes[0], keyword) if codes else ""
        for keyword in ("CodeMeaning", "CodeValue", "CodingSchemeDesignator")
    )
    label = _text(channel, "ChannelLabel")
    # DICOM's CID 3001, ECG leads
    prefix = {"MDC": "2:", "SCPECG": "5.6.3-9-"}.get(scheme.upper())
    has_code = prefix is not None and code.startswith(prefix)
    lead = lead_of_code(code) if has_code else lead_name(meaning) or lead_name(label)
    return meaning or label or f"channel {number}", lead


def _chosen(groups: Sequence[_MultiplexGroup], path: Path) -> list[_MultiplexGroup]:
    """Return the group to read and those joined to it; averaged beats are the last resort."""
    rhythms = [group for group in groups if not group.averaged]
    chosen = _join(rhythms, path) if rhythms else []
    if not _is_complete({lead for group in chosen for lead in group.leads}):
        chosen = _join(groups, path)
    return sorted(chosen, key=lambda group: group.index)


def _is_complete(leads: Collection[str]) -> bool:
    return set(CHEST_LEADS) <= set(leads) and limb_leads_from(leads) is not None


def _join(groups: Sequence[_MultiplexGroup], path: Path) -> list[_MultiplexGroup]:
    """Return the group with the most leads, and groups with other leads or its continuation."""
    ranked = sorted(groups, key=lambda group: (-len(group.leads), -group.samples))
    first, leads = ranked[0], set(ranked[0].leads)
    if _is_complete(leads):
        return [first]
    chosen = [first]
    for group in ranked[1:]:
        adds = bool(set(group.leads) - leads) and not _is_complete(leads)
        if adds and group.rate != first.rate:
            raise InputError(
                f"{path}: leads {', '.join(group.leads)} are sampled at {group.rate:g} Hz, "
                f"{', '.join(first.leads)} at {first.rate:g} Hz; export all leads at one rate"
            )
        in_time = group.rate == first.rate and math.isfinite(group.start)
        if adds or (group.leads and in_time):
            chosen.append(group)
            leads |= set(group.leads)
    return chosen


def _joined_parts(channels: Sequence[Channel]) -> tuple[list[Channel], dict[str, str]]:
    """Make one channel of a lead's parts in several groups, the longest first, and say so.

    Where parts leave a gap between them, the longest alone counts.
    """
    by_lead: dict[str, list[Channel]] = {}
    for channel in channels:
        by_lead.setdefault(channel.lead or channel.name, []).append(channel)
    joined, notes = [], {}
    for lead, parts in by_lead.items():
        ranked = sorted(parts, key=lambda part: -int(np.isfinite(part.values).sum()))
        values = ranked[0].values.copy()
        for part in ranked[1:]:
            if (part.unit, part.gain) == (ranked[0].unit, ranked[0].gain):
                values = np.where(np.isnan(values), part.values, values)
        recorded = np.flatnonzero(np.isfinite(values))
        if recorded.size and len(recorded) == recorded[-1] + 1 - recorded[0]:
            ranked[0] = replace(ranked[0], values=values)
        joined.append(ranked[0])
        if len(parts) > 1 and ranked[0].lead is not None:
            note = f"lead {lead} is that of {len(parts)} groups, joined in time"
            notes[f"strip_of_{lead}"] = note
    return joined, notes


def _channels(group: _MultiplexGroup, samples: Any, path: Path) -> list[Channel]:
    """Turn the digits of a group into physical values.

    ``value = (sample * sensitivity * correction factor) + baseline`` (DICOM PS3.3, C.10.9.1.4);
    padding becomes the fill value of the channel.
    """
    padding = group.item.get("WaveformPaddingValue", None)
    stated = isinstance(padding, bytes) and len(padding) >= samples.itemsize
    pads = np.frombuffer(padding, samples.dtype, 1) if stated else np.empty(0)
    channels = []
    for k, (channel, (name, lead)) in enumerate(zip(group.channels, group.sources, strict=True)):
        if lead is None:
            channels.append(Channel(name, np.full(len(samples), np.nan)))
        if lead is None or lead not in group.leads:
            continue
        of_time = _number(channel, "ChannelTimeSkew") * group.rate
        skew = _number(channel, "ChannelSampleSkew", of_time)
        skew += _number(channel, "ChannelOffset") * group.rate
        if abs(skew) > 0.5:  # samples; less is multiplexing
            raise InputError(
                f"{path}: lead {lead} is {skew:g} samples apart from its group; export all leads "
                "over the same time"
            )
        sensitivity = _number(channel, "ChannelSensitivity")
        sensitivity *= _number(channel, "ChannelSensitivityCorrectionFactor", 1.0)
        if sensitivity == 0:
            raise InputError(
                f"{path}: unknown unit of lead {lead} (no channel sensitivity, or 0); export the "
                "waveform calibrated in uV or mV"
            )
        baseline = _number(channel, "ChannelBaseline")
        values, missing = samples[:, k] * sensitivity + baseline, pads * sensitivity + baseline
        units = _items(channel, "ChannelSensitivityUnitsSequence")
        spelt = [_text(code, word) for code in units[:1] for word in ("CodeValue", "CodeMeaning")]
        unit = next((text for text in spelt if millivolts(text)), next(filter(None, spelt), None))
        channels.append(Channel(name, values, unit, lead, 1 / sensitivity, tuple(missing)))
    return channels


def _items(item: Any, keyword: str) -> Sequence[Any]:
    """Return the items of a sequence; none where it is absent or something else."""
    from pydicom import Sequence as Items

    items = item.get(keyword, None)
    return list(items) if isinstance(items, Items) else []


def _text(item: Any, keyword: str) -> str:
    """Return a text of an item, shortened for a message as damaged ones may be long."""
    return printable(str(item.get(keyword, None) or "").strip()[:64])


def _number(item: Any, keyword: str, absent: float = 0.0) -> float:
    """Return a number of an item; `absent` where it is absent or empty."""
    value = item.get(keyword, None)
    if value is None or value == "":
        return absent
    if not math.isfinite(number := float(value)):
        raise ValueError(f"{keyword} is {number}")
    return number
