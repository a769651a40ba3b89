"""ECG recordings from the files that clinics and archives have: read, then checked once."""

from __future__ import annotations

import glob
import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line, printable
from fascicle.core.files import as_path, packaged_heart
from fascicle.core.isolated import read_isolated
from fascicle.core.leads import (
    ADDITIONAL_LEADS,
    CHEST_LEADS,
    INDEPENDENT_LEADS,
    LEADS,
    LIMB_LEADS,
    limb_leads_from,
)
from fascicle.core.ranges import check_items, check_kind, check_text, number
from fascicle.recording import choices
from fascicle.recording.readers.formats import READERS, reader_of
from fascicle.recording.readers.names import additional_lead_name, lead_name, millivolts, same_unit
from fascicle.recording.recording import (
    Filters,
    Recording,
    bridge_gaps,
    check_extent,
    derive_limb_leads,
    in_groups,
    is_span,
    lead_spans,
    leave_out_pulses,
    missing_rate,
    missing_unit,
)


@dataclass(frozen=True)
class Channel:
    """Signal of a file."""

    name: str  # as it is spelt in the file
    values: Floats  # (n,) samples, in `unit`; NaN where there is none
    unit: str | None = None  # as it is spelt in the file; None where the file does not say
    lead: str | None = None  # lead by a code in the file; None: by `name`
    gain: float | None = None  # digits of the file in one `unit`
    missing: tuple[float, ...] = ()  # written for a missing sample, in `unit`; see `without_fill`

    def placed(self, start: int, length: int, beyond: float = np.nan) -> Channel:
        """Channel on a time axis of `length` samples, from `start` on; `beyond` elsewhere."""
        values = np.full(length, beyond)
        values[start : start + len(self.values)] = self.values
        return replace(self, values=values)


@dataclass(frozen=True)
class RawRecording:
    """Channels and metadata that a reader finds in a file."""

    channels: Sequence[Channel]  # in any order; those that are no leads are left out
    sampling_rate: float | None = None  # Hz; None where the file does not say
    format: str = ""  # name of the format; by default the reader's
    filters: Filters = field(default_factory=Filters)  # filters of the recorder
    provenance: dict[str, str] = field(default_factory=dict)  # text about the file
    remarks: tuple[str, ...] = ()  # faults of the file, and how they were mended


def read_recording(
    path: str | Path,
    *,
    leads: Sequence[str] | None = None,
    sampling_rate: float | None = None,
    unit: str | None = None,
    shared_gain: bool = False,
    digits_per_mv: float | None = None,
    invert: Sequence[str] = (),
    swap: Sequence[str] = (),
) -> Recording:
    """Read a 12-lead recording, as `fascicle target` does with options of the same names.

    Parameters
    ----------
    path : path
        WFDB header (or the record name without suffix), DICOM waveform, HL7 aECG, MUSE XML,
        SCP-ECG, EDF, HDF5, MATLAB, a table or another of the formats in ``docs/recordings.md``,
        or of those added by `register_reader`; or ``"camps-dti004"``, the packaged beat of the
        subject whose heart is packaged under this name.
    leads : sequence of str, optional
        Leads to use: of `fascicle.core.leads.LEADS` and `ADDITIONAL_LEADS`, by default all, or any
        channels of the file by their names, such as a vest's. Limb leads are computed where two of
        them are used.
    sampling_rate : float, optional
        Samples per second (Hz), for files that do not say.
    unit : str, optional
        Unit of the leads (nV, uV, mV, V), for files that do not say.
    shared_gain : bool
        Give all leads one gain, in place of the file's.
    digits_per_mv : float, optional
        That gain: the file's numbers per mV; by default 1000.
    invert : sequence of str
        Leads that were recorded upside down.
    swap : sequence of str
        Reversed limb electrodes or leads, such as ``RA-LA`` or ``V1-V2``.

    Returns
    -------
    Recording
        Leads in mV, in the order of `fascicle.core.leads.LEADS`, and additional ones, which must
        have been recorded with them.

    Raises
    ------
    InputError
        When the file cannot be used; the message says why and what to do.
    """
    name, packaged = path, packaged_heart(path)
    path = existing_file(as_path(path, "recording") if packaged is None else packaged / "ecg.csv")
    if leads is not None:
        check_items(leads, str, "leads", f"names of leads, such as {', '.join(LEADS)}, V7, X")
    if sampling_rate is not None:
        number(sampling_rate, "sampling_rate")
    if unit is not None:
        check_text(unit, "unit")
    check_kind(shared_gain, bool, "shared_gain", "True or False")
    check_items(invert, str, "invert", "names of leads")
    check_items(swap, str, "swap", "pairs such as RA-LA")
    reader = reader_of(path)
    if reader.isolated:
        # such as the signal file of a WFDB header
        siblings = path.parent.glob(f"{glob.escape(path.stem)}.*")
        companions = tuple(sibling for sibling in siblings if sibling != path and sibling.is_file())
        raw: RawRecording = read_isolated(
            read_raw, path, companions=companions, format=reader.format, sampling_rate=sampling_rate
        )
    else:
        raw = read_raw(path, reader.format, sampling_rate)
    recording = _assemble(raw, str(path if packaged is None else name), leads, sampling_rate, unit)
    notes = {
        "source_sha256": sha256_of([path]),
        "choice_leads": None if leads is None else ", ".join(leads),
        "choice_sampling_rate_hz": None if sampling_rate is None else f"{sampling_rate:g}",
        "choice_unit": unit,
    }
    chosen = {name: text for name, text in notes.items() if text is not None}
    recording = replace(
        recording,
        provenance=recording.provenance | chosen,
        amplitude_stated=unit is not None or shared_gain,
    )
    if digits_per_mv is not None and not shared_gain:
        raise InputError("--digits-per-mv is the gain of --shared-gain; give both or neither")
    if shared_gain:
        gain = 1000.0 if digits_per_mv is None else digits_per_mv
        recording = choices.share_gain(recording, gain)
    for lead in invert:
        recording = choices.invert(recording, lead_name(lead) or lead)
    for text in swap:
        pair = [part.strip() for part in re.split(r"[-,]", text)]
        if len(pair) != 2:
            raise InputError(f"--swap {text}: give two names, such as RA-LA or V1-V2")
        # leads by their standard names, electrodes in capitals
        first, second = (lead_name(name) or name.upper() for name in pair)
        recording = choices.swap(recording, first, second)
    return recording


def read_raw(path: Path, format: str, sampling_rate: float | None) -> RawRecording:
    """Read a file of a format; an unexpected exception of the reader means that it is damaged."""
    reader = next(reader for reader in READERS if reader.format == format)
    try:
        raw: RawRecording = reader.read(path, sampling_rate)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise InputError(
            f"{path}: damaged, truncated or unusual {format} file ({one_line(error)}); export it "
            "again"
        ) from error
    return raw if raw.format else replace(raw, format=format)


def existing_file(path: Path) -> Path:
    """Return the file itself, or the WFDB header of a record name."""
    if path.is_file():
        return path
    header = path.with_name(path.name + ".hea") if path.name else path
    if header.is_file():
        return header
    problem = "is not an ordinary file" if path.exists() else "no such file"
    raise InputError(f"{path}: {problem}; give one recording file")


def _assemble(
    raw: RawRecording,
    source: str,
    selected: Sequence[str] | None = None,
    sampling_rate: float | None = None,
    unit: str | None = None,
) -> Recording:
    """Make a recording of the channels that are leads; missing limb leads follow from two.

    The content of a file is checked here alone, for consistency and against the user's statements.
    """
    channels, ignored = _by_lead(raw, source, selected)
    silent = [lead for lead, channel in channels.items() if lead in LEADS and not _moves(channel)]
    if len(silent) == len([lead for lead in channels if lead in LEADS]):
        silent = []  # an error about the samples of these is raised instead
    channels = {lead: channel for lead, channel in channels.items() if lead not in silent}
    _check_complete(list(channels), silent, source, selected)
    leads = {lead: channel for lead, channel in channels.items() if lead in LEADS}
    lengths = {lead: len(channel.values) for lead, channel in leads.items()}
    few, many = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
    rate = raw.sampling_rate if raw.sampling_rate is not None else sampling_rate
    if rate is None:
        message = f"{source}: no sampling rate in the file; give it in Hz by --sampling-rate"
        raise missing_rate(message, lengths[many])
    if sampling_rate is not None and not math.isclose(rate, sampling_rate, rel_tol=1e-6):
        raise InputError(
            f"{source}: its sampling rate is {rate:g} Hz, --sampling-rate says {sampling_rate:g} "
            "Hz; leave the option out or correct the file"
        )
    check_extent(lengths[many], rate, source)
    if lengths[few] != lengths[many]:
        raise InputError(
            f"{source}: lead {few} has {lengths[few]} samples, lead {many} {lengths[many]}; export "
            "all leads over the same time and at one rate"
        )
    signal = np.full((len(LEADS), lengths[many]), np.nan)
    gains = np.full(len(LEADS), np.nan)
    for lead, channel in leads.items():
        row, scale = LEADS.index(lead), _scale(channel, lead, source, unit, leads)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite samples are refused as gaps
            values = scale * without_fill(channel, rate)
        signal[row] = np.where(np.isfinite(values), values, np.nan)
        if channel.gain is not None and math.isfinite(channel.gain):
            gains[row] = abs(channel.gain) / scale
    more, left_out = _additional(channels, lengths[many], rate, source, unit)
    lost = f"not recorded, constant or empty from start to end: {', '.join(silent)}"
    signal, pulses = leave_out_pulses(np.array([*signal, *more.values()]), rate)
    signal, repairs = bridge_gaps(signal, rate, (*LEADS, *more))
    signal, additional = signal[: len(LEADS)], dict(zip(more, signal[len(LEADS) :], strict=True))
    shortest = 1 if in_groups(lead_spans(signal), rate) else signal.shape[1]
    for lead in [lead for lead, values in additional.items() if not is_span(values, shortest)]:
        left_out.append(lead)
        del additional[lead]
    if left_out and selected is not None:
        raise InputError(
            f"{source}: lead {left_out[0]} is constant, was not recorded all of the time that the "
            "others were, or has no unit of a potential; leave it out of --leads"
        )
    signal, derived = derive_limb_leads(signal, leads)
    for lead in derived:
        if not np.isfinite(signal[LEADS.index(lead)]).any():
            raise InputError(
                f"{source}: lead {lead} missing, and no two limb leads were recorded at the same "
                "time to compute it from"
            )
    return Recording(
        signal=signal,
        sampling_rate=rate,
        source=source,
        provenance={"format": raw.format} | raw.provenance,
        remarks=(*raw.remarks, *([lost] if silent else []), *pulses, *repairs),
        from_file=True,
        filters=raw.filters,
        digits_per_millivolt=gains,
        derived=derived,
        ignored=(*ignored, *(printable(channels[lead].name) for lead in left_out)),
        additional=additional,
    )


def _additional(
    channels: Mapping[str, Channel], length: int, rate: float, source: str, unit: str | None
) -> tuple[dict[str, Floats], list[str]]:
    """Potentials (n,), mV, of additional leads, and names of those that cannot be used.

    Only potentials are leads: X, Y and Z may also be the axes of an accelerometer. Where no
    electrode was connected, recorders may write a constant.
    """
    potentials, left_out = {}, []
    for lead, channel in channels.items():
        if lead in LEADS:
            continue
        values, scale = without_fill(channel, rate), millivolts(channel.unit or unit or "")
        if len(values) == length and _moves(channel) and scale is not None:
            potentials[lead] = _scale(channel, lead, source, unit, channels) * values
        else:
            left_out.append(lead)
    return potentials, left_out


def _by_lead(
    raw: RawRecording, source: str, selected: Sequence[str] | None
) -> tuple[dict[str, Channel], list[str]]:
    """Sort the channels into leads and the rest, whose names are returned."""
    leads: dict[str, Channel] = {}
    ignored = []
    for channel in raw.channels:
        lead = channel.lead or lead_name(channel.name) or additional_lead_name(channel.name)
        if lead is None and selected is not None:
            # without its unit
            name = re.sub(r"[ _(\[]+[num]?v[)\]]?$", "", channel.name.strip().casefold())
            lead = next((candidate for candidate in selected if candidate.casefold() == name), None)
        repeated = selected is None and lead in leads and lead not in LEADS
        if lead is None or repeated or (selected is not None and lead not in selected):
            ignored.append(printable(channel.name))
        elif lead in leads:
            raise InputError(
                f"{source}: lead {lead} is there twice ('{leads[lead].name}' and "
                f"'{channel.name}'); keep one of them"
            )
        else:
            leads[lead] = channel
    return leads, ignored


def _moves(channel: Channel) -> bool:
    """True if a channel has more than one value: writers fill unrecorded ones with a constant."""
    recorded = channel.values[np.isfinite(channel.values)]
    return recorded.size > 0 and bool((recorded != recorded[0]).any())


def _check_complete(
    leads: Sequence[str], silent: Sequence[str], source: str, selected: Sequence[str] | None
) -> None:
    """Refuse a file without the leads needed or selected; `silent` ones hold no signal."""
    limb_known = limb_leads_from(leads) is not None
    needed = INDEPENDENT_LEADS if selected is None else selected
    available = {*leads, *(LIMB_LEADS if limb_known else ())}
    missing = [lead for lead in needed if lead not in available]
    if not missing:
        return
    usable = [lead for lead in (*LEADS, *ADDITIONAL_LEADS) if lead in leads]
    advice = "two limb leads and V1 to V6 are needed"
    if limb_known and any(lead in CHEST_LEADS for lead in leads):
        advice += f"; to go on without, name the leads to use: --leads {','.join(usable)}"
    listing = f"found: {', '.join(usable) or 'none'}"
    listing += f"; constant or empty: {', '.join(silent)}" if silent else ""
    raise InputError(
        f"{source}: lead{'s' * (len(missing) > 1)} {', '.join(missing)} missing ({listing}); "
        f"{advice}"
    )


def _scale(
    channel: Channel, lead: str, source: str, stated: str | None, leads: Mapping[str, Channel]
) -> float:
    """Return the size (mV) of a channel's unit."""
    if channel.unit is not None and stated is not None and not same_unit(channel.unit, stated):
        raise InputError(
            f"{source}: lead {lead} is in '{channel.unit}', --unit says '{stated}'; leave the "
            "option out or correct the file"
        )
    unit = channel.unit if channel.unit is not None else stated
    scale = None if unit is None else millivolts(unit)
    if scale is None:
        spelling = "the file names none" if unit is None else f"'{unit}'"
        message = (
            f"{source}: unknown unit of lead {lead} ({spelling}); known are nV, uV, mV and V, give "
            "it in the file or by --unit"
        )
        if unit is not None:
            raise InputError(message)
        raise missing_unit(
            message, [other.values for other in leads.values() if other.unit is None]
        )
    return scale


def without_fill(channel: Channel, rate: float) -> Floats:
    """Samples (n,) of a channel at a rate (Hz), NaN where a fill value says that one is missing.

    A fill value may be one that the signal takes, such as 0. A run of it is signal where the
    neighbours run into it, by at most twice their own steps or the 90th percentile of all steps,
    and where it lasts no longer than 0.1 s or twice the longest run of any other value.
    """
    values = np.array(channel.values, dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    for fill in channel.missing:
        starts = np.flatnonzero(np.diff(values, prepend=np.nan))
        lengths = np.diff(starts, append=len(values))
        filled = values[starts] == fill
        if not filled.any():
            continue
        longest = max(0.1 * rate, 2.0 * lengths[~filled].max(initial=0))
        starts, lengths = starts[filled], lengths[filled]
        padded = np.pad(values, 2, constant_values=np.nan)
        # the two samples before each run, and the two after it
        before, after = padded[[starts + 1, starts]], padded[starts + lengths + [[2], [3]]]
        step = np.fmax(np.abs(before[0] - before[1]), np.abs(after[0] - after[1]))
        usual = np.nanpercentile(np.abs(np.diff(values)), 90.0)
        jump = np.fmax(np.abs(before[0] - fill), np.abs(after[0] - fill))
        lost = (jump > 2.0 * np.fmax(step, usual)) | (lengths > longest)
        for start, length in zip(starts[lost], lengths[lost], strict=True):
            values[start : start + length] = np.nan
    return values


def sha256_of(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of files, one after another."""
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            hashlib.file_digest(file, lambda: digest)  # goes on with what is hashed already
    return digest.hexdigest()


def narrowest_passband(
    highpass: Iterable[float], lowpass: Iterable[float], notch: Iterable[float]
) -> Filters:
    """Common filters (Hz, 0: none) of leads whose filters may differ: the narrowest band."""
    high, low, mains = (
        [f for f in frequencies if f > 0] for frequencies in (highpass, lowpass, notch)
    )
    return Filters(max(high, default=None), min(low, default=None), min(mains, default=None))
