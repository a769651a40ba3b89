"""What the columns of a table are: leads, rhythm strips, and the units they are in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.readers.names import lead_name, millivolts, plain_unit
from fascicle.recording.readers.raw_recording import Channel
from fascicle.recording.readers.read_options import Given
from fascicle.recording.readers.table_text import TextTable, shown

_UNIT = (
    r"(?:[nuµμm]?v|(?:nano|micro|milli)?volts?|ms|msecs?|milliseconds?|us|µs|μs|microseconds?|"
    r"s|secs?|seconds?)"
)
# "V1_uV", "V1 [uV]", "V1 (uV)", "V1/uV", "V1, uV", "V1 in uV": a name and its unit
_WITH_UNIT = re.compile(
    r"(?P<name>.+?)\s*(?:[\[(]\s*(?P<bracket>[^\])]*?)\s*[\])]|"
    rf"(?:[_ ]|\s*[/,:]\s*|[_ ]in[_ ])(?P<tail>{_UNIT}))",
    re.IGNORECASE,
)
_RHYTHM = re.compile(
    r"[\s_(.-]*(?<![a-z])(?:rhythm(?:[\s_]strip)?|long)(?![a-z])\)?[\s_.-]*", re.IGNORECASE
)
_LONGEST_NAME = 100  # characters; bounds what matching takes
_RENAMED = re.compile(r"(?P<name>.+)\.\d+")  # how pandas renames a column that is there twice
_UNIT_REMARK = re.compile(r"#+\s*units?\s*[:=]\s*(?P<unit>[^\s,;]+)", re.IGNORECASE)
_OWN_HEADER = ("time_ms", *LEADS)  # what this package writes, in mV
_PER_SECOND = (
    dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0)
    | dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e3)
    | dict.fromkeys(("us", "microsecond", "microseconds"), 1e6)
)


@dataclass(frozen=True)
class Column:
    """A column: its place, its name and unit in the file, the lead it holds, if any.

    `rhythm` says that the name calls it a rhythm strip, which may repeat a lead.
    """

    place: int
    name: str
    unit: str | None
    lead: str | None
    rhythm: bool


@dataclass(frozen=True)
class Strip:
    """A channel of a table, and whether its name calls it a rhythm strip."""

    channel: Channel
    rhythm: bool


def per_second(unit: str) -> float | None:
    """Return how many such units are a second, or None when the unit is unknown."""
    return _PER_SECOND.get(plain_unit(unit))


def columns_of(table: TextTable) -> list[Column]:
    """Return the columns of a table with their units, from the header or the row under it.

    Raises
    ------
    InputError
        When the header and the row of units disagree.
    """
    columns = []
    for place, (spelt, under) in enumerate(zip(table.names, table.units, strict=True)):
        renamed = _RENAMED.fullmatch(spelt)
        known = renamed["name"] if renamed and renamed["name"] in table.names else spelt
        name, unit = split_unit(known)
        below = under.strip(" ()[]'\"") or None
        lead, rhythm = lead_or_rhythm(name)
        if lead is not None or per_second(unit or "") is not None:
            _check_same(table, spelt, {"by its name": unit, "by the row under it": below})
        columns.append(Column(place, spelt, unit if unit is not None else below, lead, rhythm))
    return columns


def split_unit(name: str) -> tuple[str, str | None]:
    """Split the name of a column into the name proper and its unit, if it has one."""
    if len(name) > _LONGEST_NAME:
        return name, None
    if lead_or_rhythm(name)[0] is not None:  # "V1 (Wilson)", "II (rhythm)"
        return name, None
    match = _WITH_UNIT.fullmatch(name)
    if match is None:
        return name, None
    return match["name"], match["tail"] if match["bracket"] is None else match["bracket"]


def lead_or_rhythm(name: str) -> tuple[str | None, bool]:
    """Return the lead that a name stands for, and whether as a rhythm strip."""
    if len(name) > _LONGEST_NAME:
        return None, False
    rest, found = _RHYTHM.subn("", name, count=1)
    if found:
        return lead_name(rest), True
    return lead_name(name), False


def unit_of(table: TextTable, column: Column, given: Given) -> str | None:
    """Return the unit of a lead, which all that name it must agree about.

    Parameters
    ----------
    table : TextTable
        Its remarks may name the unit (``# unit: uV``).
    column : Column
        A lead.
    given : Given
        What the user says.

    Returns
    -------
    str or None
        None where nothing names it.

    Raises
    ------
    InputError
        When two of them disagree.
    """
    remarks = [m["unit"] for line in table.remarks if (m := _UNIT_REMARK.fullmatch(line))]
    stated = {
        "by the table": column.unit,
        "as in the tables of this package": "mV" if table.names == _OWN_HEADER else None,
        **{f"by the remark '# unit: {unit[:12]}'": unit for unit in remarks},
        "by --unit": given.unit,
    }
    return _check_same(table, column.name, stated)


def _check_same(table: TextTable, name: str, stated: Mapping[str, str | None]) -> str | None:
    """Return the first unit that is stated, once all agree."""
    units = [(how, unit) for how, unit in stated.items() if unit is not None]
    for how, unit in units[1:]:
        first_how, first = units[0]
        same_scale = any(
            scale(unit) is not None and scale(unit) == scale(first)
            for scale in (millivolts, per_second)
        )
        if unit != first and not same_scale:
            raise InputError(
                f"{table.path}: column {shown(name)} is in {shown(first)} {first_how}, in "
                f"{shown(unit)} {how}; correct the wrong one"
            )
    return units[0][1] if units else None


def choose_strips(
    strips: Sequence[Strip], sampling_rate: float
) -> tuple[list[Channel], dict[str, str]]:
    """Choose between a lead and a rhythm strip of the same lead: the longer one is the lead.

    On paper a lead takes its turn of a quarter of the width, and a rhythm strip of one lead runs
    along the whole of it.

    Parameters
    ----------
    strips : sequence of Strip
        Leads and rhythm strips.
    sampling_rate : float
        Samples per second (Hz).

    Returns
    -------
    channels : list of Channel
        The one left out is there under a name that is no lead.
    notes : dict
        What was chosen.
    """
    channels, notes = [], {}
    for strip in strips:
        channel = strip.channel
        rivals = [s for s in strips if s.channel.lead == channel.lead and s.rhythm != strip.rhythm]
        if len(rivals) == 1 and channel.lead is not None:
            rival = rivals[0].channel
            mine, other = (np.isfinite(c.values).sum() / sampling_rate for c in (channel, rival))
            if mine > other or (mine == other and not strip.rhythm):
                notes[f"strip_of_{channel.lead}"] = (
                    f"'{channel.name}' ({mine:.2f} s) is lead {channel.lead}, '{rival.name}' "
                    f"({other:.2f} s) is left out: the longer one serves"
                )
            else:
                channel = replace(channel, name=f"{channel.name} (left out)", lead=None)
        channels.append(channel)
    return channels, notes
