"""Recordings as tables: a time column and one column per lead, or one row per lead and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, printable
from fascicle.recording.missing_metadata import missing_rate, missing_time_unit
from fascicle.recording.readers.metadata import declared_rate
from fascicle.recording.readers.raw_recording import Channel, RawRecording, ReadOptions
from fascicle.recording.readers.table_text import Column, Table, lead_or_rhythm, open_table
from fascicle.recording.recording import check_extent

_TIMES = ("time", "t", "timestamp", "elapsed time")
_COUNTERS = (  # of samples; the last is what pandas calls a column without a name
    "sample", "samples", "sample #", "samp #", "sample number", "index", "unnamed: 0"
)  # fmt: skip
_LEADS = ("lead", "leads", "lead name", "channel")
_VALUES = ("value", "values", "voltage", "amplitude", "potential", "signal", "ecg")
_UNEVEN = 0.5  # of a step; more is a gap, less is rounding of the times
_SAME_RATE = 2e-3  # relative; more is no rounding of the times
_SAME_UNIT = 0.1  # relative, between steps of times and of the rate that is known
_LATEST = 1e18  # in any unit; us since 1970 are below
_RATE_DIGITS = 6  # after the decimal point; more is rounding of binary numbers


def read_table(path: Path, options: ReadOptions) -> RawRecording:
    """Read a table of samples by the schema in ``docs/recordings.md``.

    Columns that are no leads are named but not read. Where there are a lead and a rhythm strip of
    the same lead, the longer one is the lead.
    """
    table = open_table(path)
    leads = [column for column in table.columns if column.lead is not None]
    times = [c for c in table.columns if c.quantity in _TIMES or _is_time(c)]
    times = times or [column for column in table.columns if column.quantity in _COUNTERS]
    named = {column.quantity: column for column in table.columns}
    lead = next((named[name] for name in _LEADS if name in named), None)
    value = next((named[name] for name in _VALUES if name in named), None)
    if not leads and lead is not None and value is not None and times:
        return _read_long(table, (lead, times[0], value), options)
    if not leads:
        raise InputError(
            f"{path}: no lead among the columns {table.shown}; name them I, II, V1 to V6 with "
            "their unit (I_mV)"
        )
    values = np.array([table.numbers(column) for column in [*leads, *times]])
    if times:
        values = values[:, ~np.isnan(values).all(axis=0)]  # spreadsheets end with empty rows
    evidence = []
    for column, clock in zip(times, values[len(leads) :], strict=True):
        where = f"in the column '{printable(column.name)}'"
        evidence.append(
            (where, _rate_of(table, clock, _scale(table, column, clock, options), where))
        )
    rate = _agreed_rate(table, options, evidence)
    if rate is None:
        raise missing_rate(
            f"{path}: no time column among {table.shown}; add one named time_ms or time_s, or "
            "give the rate in Hz by --sampling-rate",
            values.shape[1],
        )
    channels = [
        Channel(column.name, row, table.unit_of(column), column.lead)
        for column, row in zip(leads, values, strict=False)
    ]
    others = [c.name for c in table.columns if c not in leads and c not in times]
    return _raw_recording(channels, [c.rhythm for c in leads], rate, others, "table")


def _is_time(column: Column) -> bool:
    """Whether a column is named after a unit of time alone, as ``seconds``."""
    return column.unit is None and column.per_second is not None


def _read_long(
    table: Table, columns: tuple[Column, Column, Column], options: ReadOptions
) -> RawRecording:
    """Read one row per lead and time; each lead has even times, at the rate of the others.

    Leads come on common times, each moved by half a sample at most; NaN where it was not recorded.
    """
    named, times, values = table.cells(columns[0]), *map(table.numbers, columns[1:])
    kept = ~np.isnan(values) & named.notna().to_numpy()
    stretches = {}
    for name, rows in named[kept].astype(str).groupby(named[kept]).indices.items():
        if lead_or_rhythm(str(name))[0] is not None and len(rows) > 1:
            clock = times[kept][rows]
            clock /= _scale(table, columns[1], clock, options)
            stretches[str(name)] = clock, values[kept][rows]
    if not stretches:
        raise InputError(
            f"{table.path}: no lead in the column '{printable(columns[0].name)}'; name them I, II, "
            "V1 to V6"
        )
    # the longest lead knows the rate best
    ordered = sorted(stretches.items(), key=lambda item: -len(item[1][0]))
    evidence = [
        (f"of lead '{name}'", _rate_of(table, clock, 1.0, f"of lead '{name}'"))
        for name, (clock, _) in ordered
    ]
    rate = _agreed_rate(table, options, evidence)
    assert rate is not None  # every lead has one
    firsts = {
        name: float(clock.mean()) * rate - (len(clock) - 1) / 2
        for name, (clock, _) in stretches.items()
    }
    starts = {name: round(first - min(firsts.values())) for name, first in firsts.items()}
    length = max(starts[name] + len(clock) for name, (clock, _) in stretches.items())
    check_extent(length, rate, str(table.path))
    channels = []
    for name, (clock, row) in stretches.items():
        ahead = (clock - clock.mean()) * rate - np.arange(len(clock))
        if np.ptp(ahead) > _UNEVEN:
            raise InputError(
                f"{table.path}: lead '{printable(name)}' is not sampled at the {rate:g} Hz of the "
                "others; resample all leads at one rate"
            )
        channel = Channel(name, row, table.unit_of(columns[2]), lead_or_rhythm(name)[0])
        channels.append(channel.placed(starts[name], length))
    rhythm = [lead_or_rhythm(name)[1] for name in stretches]
    others = sorted(set(named.dropna().astype(str)) - set(stretches))
    return _raw_recording(channels, rhythm, rate, others, "long table")


def _raw_recording(
    channels: Sequence[Channel],
    rhythm: Sequence[bool],
    rate: float,
    others: Sequence[str],
    kind: str,
) -> RawRecording:
    """Choose between a lead and a rhythm strip of it: on paper, the longer one serves."""
    chosen, choices = [], {}
    for channel, strip in zip(channels, rhythm, strict=True):
        rivals = [
            other
            for other, other_strip in zip(channels, rhythm, strict=True)
            if other.lead == channel.lead and other_strip != strip
        ]
        if len(rivals) == 1:
            mine, other = (np.isfinite(c.values).sum() / rate for c in (channel, rivals[0]))
            if mine > other or (mine == other and not strip):
                choices[f"strip_of_{channel.lead}"] = (
                    f"'{channel.name}' ({mine:.2f} s) is lead {channel.lead}, '{rivals[0].name}' "
                    f"({other:.2f} s) is left out: the longer one serves"
                )
            else:
                channel = replace(channel, name=f"{channel.name} (left out)", lead=None)
        chosen.append(channel)
    chosen += [Channel(name, np.empty(0), None) for name in others]
    return RawRecording(chosen, rate, kind, provenance=choices)


def _agreed_rate(
    table: Table, options: ReadOptions, evidence: Sequence[tuple[str, float]] = ()
) -> float | None:
    """Rate (Hz) that the user, a comment (``# fs: 500``) and the times agree about, if any says it.

    The user's counts first, then that of a comment: those of times may have been rounded.
    """
    declared = declared_rate(table.metadata, table.path)
    rates = [("by --sampling-rate", options.sampling_rate), ("by a comment", declared), *evidence]
    found = [(who, rate) for who, rate in rates if rate is not None]
    for who, rate in found[1:]:
        if not abs(rate - found[0][1]) <= _SAME_RATE * found[0][1]:
            raise InputError(
                f"{table.path}: sampling rate is {found[0][1]:g} Hz {found[0][0]}, {rate:g} Hz "
                f"{who}; correct the wrong one"
            )
    return found[0][1] if found else None


def _scale(table: Table, column: Column, times: Floats, options: ReadOptions) -> float:
    """Return how many units of a time column are a second.

    Where its name has no unit, the rate of the user or a comment must be known, and tells it: times
    step by 1/rate (s), 1000/rate (ms) or 1 (numbers of samples).
    """
    if column.per_second is not None:
        return column.per_second
    rate = _agreed_rate(table, options)
    if rate is None:
        raise missing_time_unit(
            f"{table.path}: unknown unit of the time column '{printable(column.name)}'; name it "
            "time_ms or time_s, or give the sampling rate in Hz by --sampling-rate",
            _step(times),
        )
    step = _step(times)
    for scale in (1.0, 1e3, rate):
        if abs(step * rate / scale - 1.0) <= _SAME_UNIT:
            return scale
    raise InputError(
        f"{table.path}: column '{printable(column.name)}' steps by {step:g}, which at the {rate:g} "
        "Hz of --sampling-rate is neither s nor ms nor a number of samples; correct one of them"
    )


def _rate_of(table: Table, times: Floats, scale: float, where: str) -> float:
    """Rate (Hz) of even times, `scale` of whose units are a second, by least squares.

    Times may be rounded, by less than half a step. `where` says in messages whose they are.
    """
    step = _step(times)
    # the step is no number where there are too few times or one is missing or far too large
    if not step > 0 or (np.diff(times) < 0).any():
        raise InputError(
            f"{table.path}: times {where} are missing or do not increase from row to row; sort or "
            "correct them"
        )
    if np.ptp(times - times[0] - step * np.arange(len(times))) > _UNEVEN * step:
        steps = np.diff(times)
        k = int(np.argmax(np.abs(steps - step)))
        raise InputError(
            f"{table.path}: samples are not evenly spaced ({1000 * steps[k] / scale:g} ms after "
            f"{times[k] / scale:g} s, {1000 * step / scale:.4g} ms on average); resample, cut the "
            "recording to a part without gaps, or write the times with more digits"
        )
    return round(scale / step, _RATE_DIGITS)


def _step(times: Floats) -> float:
    """Mean step of times, by least squares; NaN where there is none."""
    order = np.arange(len(times)) - (len(times) - 1) / 2
    if len(times) < 2 or not np.abs(times).max() <= _LATEST:
        return float("nan")
    return float(order @ (times - times[0]) / (order @ order))
