"""What the user says about a file, what a reader finds in it, and how a recording is made of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, printable
from fascicle.core.leads import CHEST_LEADS, INDEPENDENT_LEADS, LEADS, LIMB_LEADS, limb_leads_from
from fascicle.recording.missing_metadata import missing_unit
from fascicle.recording.readers.names import lead_name, millivolts, same_unit
from fascicle.recording.recording import Filters, Recording, check_extent, derive_limb_leads

_ROUNDING = 1e-6  # relative, by which two spellings of one sampling rate may differ


@dataclass(frozen=True)
class ReadOptions:
    """What the user says about a file that does not say it itself.

    Attributes
    ----------
    sampling_rate : float, optional
        Samples per second (Hz).
    unit : str, optional
        Unit of the leads: nV, uV, mV or V.
    """

    sampling_rate: float | None = None
    unit: str | None = None

    def agreed_rate(self, path: Path, declared: float | None) -> float:
        """Sampling rate (Hz) of the file or the user, who must not contradict each other."""
        rate = self.sampling_rate if declared is None else declared
        if rate is None:
            raise InputError(
                f"{path}: no sampling rate in the file; give it in Hz with --sampling-rate"
            )
        if self.sampling_rate is not None and not math.isclose(
            rate, self.sampling_rate, rel_tol=_ROUNDING
        ):
            raise InputError(
                f"{path}: its sampling rate is {rate:g} Hz, --sampling-rate says "
                f"{self.sampling_rate:g} Hz; leave the option out or correct the file"
            )
        return float(rate)


@dataclass(frozen=True)
class Channel:
    """One signal of a file.

    Attributes
    ----------
    name : str
        As it is spelt in the file.
    values : (n,) array
        Samples, in `unit`; NaN where there is none.
    unit : str, optional
        As it is spelt in the file; None where the file does not say.
    lead : str, optional
        Standard name of the lead where a code of the file says it; otherwise `name` decides.
    digits_per_millivolt : float, optional
        Gain of the digits in the file.
    """

    name: str
    values: Floats
    unit: str | None
    lead: str | None = None
    digits_per_millivolt: float | None = None

    def placed(self, start: int, length: int) -> Channel:
        """The same on a time axis of `length` samples, from `start` on; NaN where it has none."""
        values = np.full(length, np.nan)
        values[start : start + len(self.values)] = self.values
        return replace(self, values=values)


@dataclass(frozen=True)
class RawRecording:
    """Everything a reader found: channels, their rate (Hz), the format, the recorder's filters."""

    channels: Sequence[Channel]
    sampling_rate: float
    format: str
    filters: Filters = field(default_factory=Filters)
    provenance: dict[str, str] = field(default_factory=dict)

    @property
    def parts(self) -> dict[str, Any]:
        """The same as dictionaries, lists and arrays, as a child process can hand it over."""
        return vars(self) | {"channels": [*map(vars, self.channels)], "filters": vars(self.filters)}

    @classmethod
    def of_parts(cls, parts: dict[str, Any]) -> RawRecording:
        """What was taken apart by `parts`."""
        channels = [Channel(**channel) for channel in parts["channels"]]
        return cls(**(parts | {"channels": channels, "filters": Filters(**parts["filters"])}))


def narrowest_passband(
    highpass: Iterable[float], lowpass: Iterable[float], notch: Iterable[float]
) -> Filters:
    """Filters of leads that may differ in them: the narrowest band.

    Parameters
    ----------
    highpass, lowpass, notch : iterable of float
        Frequencies (Hz) of the leads' filters; 0 is no filter.
    """
    high, low, mains = ([f for f in found if f > 0] for found in (highpass, lowpass, notch))
    return Filters(max(high, default=None), min(low, default=None), min(mains, default=None))


def gain_of(step: float, unit: str | None) -> float | None:
    """Digits per mV where one digit is `step` of a unit; None where the unit is unknown.

    Nor has a step a gain that is too small for its inverse to be a number.
    """
    size = abs(step * (millivolts(unit) or 0.0)) if unit is not None else 0.0
    return 1 / size if size > np.finfo(float).tiny else None


def assemble(
    raw: RawRecording, source: str, options: ReadOptions, wanted: Sequence[str] | None = None
) -> Recording:
    """Make a recording of the channels that are leads; missing limb leads follow from two.

    Parameters
    ----------
    raw : RawRecording
        What the file holds.
    source : str
        What messages begin with.
    options : ReadOptions
        Its unit serves where a channel has none.
    wanted : sequence of str, optional
        Standard names of the leads to use; by default all that are there, and then all eight
        independent ones must be.

    Raises
    ------
    InputError
        When leads are missing or twice there, a unit is unknown, or the samples cannot be used.
    """
    leads, ignored = _by_lead(raw, source, wanted)
    _check_complete(list(leads), source, wanted)
    signal, gains = _in_millivolts(leads, source, options)
    check_extent(signal.shape[1], raw.sampling_rate, source)
    signal, derived = derive_limb_leads(signal, leads)
    _check_derived(signal, derived, source)
    return Recording(
        signal=signal,
        sampling_rate=raw.sampling_rate,
        source=source,
        provenance={"format": raw.format} | raw.provenance,
        filters=raw.filters,
        digits_per_millivolt=gains,
        derived=derived,
        ignored=tuple(ignored),
    )


def _by_lead(
    raw: RawRecording, source: str, wanted: Sequence[str] | None
) -> tuple[dict[str, Channel], list[str]]:
    """Sort the channels into leads and the rest, whose names are returned."""
    leads: dict[str, Channel] = {}
    ignored = []
    for channel in raw.channels:
        lead = channel.lead if channel.lead is not None else lead_name(channel.name)
        if lead is None or (wanted is not None and lead not in wanted):
            ignored.append(printable(channel.name))
        elif lead in leads:
            raise InputError(
                f"{source}: lead {lead} is there twice ('{printable(leads[lead].name)}' and "
                f"'{printable(channel.name)}'); keep one of them"
            )
        else:
            leads[lead] = channel
    return leads, ignored


def _check_complete(found: Sequence[str], source: str, wanted: Sequence[str] | None) -> None:
    """Refuse a file without the leads that are needed or wanted."""
    limb_known = limb_leads_from(found) is not None
    needed = INDEPENDENT_LEADS if wanted is None else wanted
    missing = [
        lead for lead in needed if lead not in found and not (lead in LIMB_LEADS and limb_known)
    ]
    if not missing:
        return
    usable = [lead for lead in LEADS if lead in found]
    advice = "two limb leads and V1 to V6 are needed"
    if limb_known and any(lead in CHEST_LEADS for lead in found):
        advice += f"; to go on without, name the leads to use: --leads {','.join(usable)}"
    raise InputError(
        f"{source}: lead{'s' * (len(missing) > 1)} {', '.join(missing)} missing (found: "
        f"{', '.join(usable) or 'none'}); {advice}"
    )


def _check_derived(signal: Floats, derived: Sequence[str], source: str) -> None:
    """Refuse limb leads that cannot follow because the two were not recorded together."""
    rows = [LEADS.index(lead) for lead in derived]
    empty = [LEADS[row] for row in rows if not np.isfinite(signal[row]).any()]
    if empty:
        raise InputError(
            f"{source}: lead{'s' * (len(empty) > 1)} {', '.join(empty)} missing, and no two limb "
            "leads were recorded at the same time to compute them from"
        )


def _in_millivolts(
    leads: Mapping[str, Channel], source: str, options: ReadOptions
) -> tuple[Floats, Floats]:
    """Leads as (12, n) mV and the gains (12,) of their digits; NaN for what is not there."""
    lengths = {lead: len(channel.values) for lead, channel in leads.items()}
    if len(set(lengths.values())) != 1:
        few, many = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        raise InputError(
            f"{source}: lead {few} has {lengths[few]} samples, lead {many} {lengths[many]}; export "
            "all leads over the same time and at one rate"
        )
    signal = np.full((len(LEADS), next(iter(lengths.values()))), np.nan)
    gains = np.full(len(LEADS), np.nan)
    for lead, channel in leads.items():
        row = LEADS.index(lead)
        scale = _scale(channel, lead, source, options, leads)
        with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused as a gap
            signal[row] = scale * channel.values
        if channel.digits_per_millivolt is not None:
            gains[row] = channel.digits_per_millivolt
    return signal, gains


def _scale(
    channel: Channel, lead: str, source: str, options: ReadOptions, leads: Mapping[str, Channel]
) -> float:
    """Return the mV of one unit of a channel."""
    declared = None if channel.unit is None else printable(channel.unit)
    if declared is not None and options.unit is not None and not same_unit(declared, options.unit):
        raise InputError(
            f"{source}: lead {lead} is in '{declared}', --unit says '{options.unit}'; leave the "
            "option out or correct the file"
        )
    unit = declared if declared is not None else options.unit
    scale = None if unit is None else millivolts(unit)
    if scale is None:
        found = "the file names none" if unit is None else f"'{unit}'"
        message = (
            f"{source}: unknown unit of lead {lead} ({found}); known are nV, uV, mV and V, give it "
            "in the file or by --unit"
        )
        if unit is not None:
            raise InputError(message)
        raise missing_unit(message, [each.values for each in leads.values() if each.unit is None])
    return scale
