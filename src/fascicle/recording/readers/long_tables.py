"""Recordings as long tables: one row per lead and time, as digitised paper often comes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.core.leads import LEADS
from fascicle.recording.readers.raw_recording import Channel, Contents
from fascicle.recording.readers.read_options import Given
from fascicle.recording.readers.table_cells import FIRST_ROWS, numbers, read_columns
from fascicle.recording.readers.table_columns import (
    Column,
    Strip,
    choose_strips,
    lead_or_rhythm,
    split_unit,
    unit_of,
)
from fascicle.recording.readers.table_text import TextTable, shown
from fascicle.recording.readers.table_times import (
    TimeColumn,
    agreed_rate,
    rate_of,
    time_columns,
    times,
)
from fascicle.recording.recording import LONGEST, check_extent

if TYPE_CHECKING:
    import pandas as pd

_LEAD_COLUMN = ("lead", "leads", "lead name", "ableitung", "derivation", "channel", "signal name")
_VALUE_COLUMN = (
    "value",
    "values",
    "voltage",
    "amplitude",
    "potential",
    "signal",
    "ecg",
    "mv",
    "uv",
)
_SAME_SAMPLE = 0.5  # of a step, by which a lead may run ahead of the others from end to end


@dataclass(frozen=True)
class LongColumns:
    """The three columns of a long table."""

    lead: Column
    time: TimeColumn
    value: Column


def long_columns(columns: Sequence[Column]) -> LongColumns | None:
    """Return the columns of lead, time and value, or None where the table is not a long one."""
    if any(column.lead is not None for column in columns):
        return None
    names = {split_unit(c.name)[0].lower().replace("_", " "): c for c in columns}
    lead = next((names[name] for name in _LEAD_COLUMN if name in names), None)
    value = next((names[name] for name in _VALUE_COLUMN if name in names), None)
    clocks = time_columns(columns)
    if lead is None or value is None or not clocks:
        return None
    if value.unit is None and value.name.lower() in ("mv", "uv"):
        value = Column(value.place, value.name, value.name, None, False)
    return LongColumns(lead, clocks[0], value)


@dataclass(frozen=True)
class _Stretch:
    """One lead: its samples, and its times (s) by their rate (Hz) and their mean."""

    values: NDArray[np.float64]
    rate: float
    middle: float


def read_long(table: TextTable, columns: LongColumns, given: Given) -> Contents:
    """Read a long table; every lead has its own even times, at the rate of the others.

    Parameters
    ----------
    table : TextTable
        The table.
    columns : LongColumns
        Which of its columns are what.
    given : Given
        Sampling rate and unit for tables that do not say.

    Returns
    -------
    Contents
        Leads on common times, each moved by half a sample at most; NaN where one was not recorded.

    Raises
    ------
    InputError
        When times of a lead are uneven, or leads have different rates.
    """
    unit = unit_of(table, columns.value, given)
    places = [columns.lead.place, columns.time.place, columns.value.place]
    first = read_columns(table, places, FIRST_ROWS, repeated=places[:1])
    rate = _agreed(table, _stretches(table, columns, first, given), given)
    share = table.rows // (len(LEADS) + 1)  # a rhythm strip repeats a lead
    if share > LONGEST * rate:
        check_extent(share, rate, str(table.path))
    frame = read_columns(table, places, repeated=places[:1])
    stretches = _stretches(table, columns, frame, given)
    rate = _agreed(table, stretches, given)
    strips = []
    for name, row in _on_common_times(table, stretches, rate).items():
        lead, rhythm = lead_or_rhythm(name)
        strips.append(Strip(Channel(name, row, unit, lead), rhythm))
    channels, notes = choose_strips(strips, rate)
    names = map(str, frame[columns.lead.place].cat.categories)
    others = [Channel(name, np.empty(0), None) for name in names if name not in stretches]
    return Contents([*channels, *others], rate, "long table", notes=notes)


def _stretches(
    table: TextTable, columns: LongColumns, frame: pd.DataFrame, given: Given
) -> dict[str, _Stretch]:
    """Sort the rows by lead; rows without a value are left out."""
    frame = frame[frame[columns.value.place].notna()]
    stretches = {}
    for spelt, part in frame.groupby(columns.lead.place, observed=True):
        name = str(spelt)
        if lead_or_rhythm(name)[0] is None or len(part) < 2:
            continue
        cells = part[columns.time.place].dropna()
        if len(cells) != len(part):
            raise InputError(f"{table.path}: lead {shown(name)} lacks times; fill them in")
        clock, per_second = times(table, columns.time, cells, given)
        rate = rate_of(clock, per_second, f"of lead {shown(name)}", table.path)
        values = numbers(table, columns.value.place, part[columns.value.place])
        stretches[name] = _Stretch(values, rate, float(clock.mean() / per_second))
    if not stretches:
        found = [shown(str(name)) for name in frame[columns.lead.place].unique()[:4]]
        raise InputError(
            f"{table.path}: no lead in the column {shown(columns.lead.name)} (found: "
            f"{', '.join(found) or 'nothing'}); name them I, II, V1 to V6"
        )
    return stretches


def _agreed(table: TextTable, stretches: Mapping[str, _Stretch], given: Given) -> float:
    """Return the rate of all leads; the longest knows it best."""
    ordered = sorted(stretches.items(), key=lambda item: -len(item[1].values))
    return agreed_rate(table, [(f"lead {shown(name)}", s.rate) for name, s in ordered], given)


def _on_common_times(
    table: TextTable, stretches: Mapping[str, _Stretch], rate: float
) -> dict[str, NDArray[np.float64]]:
    """Put the leads where they belong on common times; NaN elsewhere."""
    firsts = {}
    for name, stretch in stretches.items():
        steps = len(stretch.values) - 1
        if abs(rate / stretch.rate - 1.0) * steps > _SAME_SAMPLE:
            raise InputError(
                f"{table.path}: lead {shown(name)} has {stretch.rate:g} samples per second, others "
                f"{rate:g}; resample all leads at one rate"
            )
        firsts[name] = stretch.middle * rate - steps / 2
    begin = min(firsts.values())
    length = max(firsts[name] - begin + len(s.values) for name, s in stretches.items())
    check_extent(round(length), rate, str(table.path))
    rows = {name: np.full(round(length) + 1, np.nan) for name in stretches}
    for name, stretch in stretches.items():
        start = round(firsts[name] - begin)
        rows[name][start : start + len(stretch.values)] = stretch.values
    stop = max(round(firsts[name] - begin) + len(s.values) for name, s in stretches.items())
    return {name: row[:stop] for name, row in rows.items()}
