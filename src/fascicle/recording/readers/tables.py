"""Recordings as tables: a time column and one column per lead, or one row per lead and time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fascicle.core.errors import InputError
from fascicle.recording.readers.long_tables import long_columns, read_long
from fascicle.recording.readers.raw_recording import Channel, Contents
from fascicle.recording.readers.read_options import Given
from fascicle.recording.readers.table_cells import FIRST_ROWS, numbers, read_columns
from fascicle.recording.readers.table_columns import (
    Column,
    Strip,
    choose_strips,
    columns_of,
    unit_of,
)
from fascicle.recording.readers.table_text import TextTable, open_table, shown
from fascicle.recording.readers.table_times import (
    TimeColumn,
    agreed_rate,
    counter_columns,
    rate_of,
    time_columns,
    times,
)
from fascicle.recording.recording import check_extent

if TYPE_CHECKING:
    import pandas as pd


def read_table(path: Path, given: Given) -> Contents:
    """Read a table of samples.

    The separator is a tab, semicolon, comma or blanks; numbers may have decimal commas where no
    comma separates cells. The first line names the columns, with units there (``V1_uV``, ``V1
    [uV]``, ``V1/uV``) or in the row under it, as PhysioNet's `rdsamp` writes them. Times are in s,
    ms or us, or of a clock; without them the rate must be given. Cells may be empty where a lead
    was not recorded. A long table has one row per lead and time, in columns such as ``lead``,
    ``time_s`` and ``value_mV``.

    Parameters
    ----------
    path : Path
        The file.
    given : Given
        Sampling rate and unit for tables that do not say; they must not contradict the table.

    Returns
    -------
    Contents
        Columns that are no leads are named but not read. Where there are a lead and a rhythm strip
        of the same lead, the longer one is the lead.

    Raises
    ------
    InputError
        When the table cannot be read, or what its numbers mean cannot be told.
    """
    table = open_table(path)
    columns = columns_of(table)
    long = long_columns(columns)
    if long is not None:
        return read_long(table, long, given)
    leads = [column for column in columns if column.lead is not None]
    if not leads:
        raise InputError(
            f"{path}: no lead among the columns {table.columns_shown}; name them I, II, V1 to V6 "
            "with their unit (I_mV)"
        )
    units = {column.place: unit_of(table, column, given) for column in leads}
    clocks = time_columns(columns)
    frame, rate = _samples(table, leads, clocks, counter_columns(columns), given)
    strips = [
        Strip(
            Channel(c.name, numbers(table, c.place, frame[c.place]), units[c.place], c.lead),
            c.rhythm,
        )
        for c in leads
    ]
    channels, notes = choose_strips(strips, rate)
    used = {c.place for c in leads} | {c.place for c in clocks}
    others = [Channel(c.name, np.empty(0), None) for c in columns if c.place not in used]
    return Contents([*channels, *others], rate, "table", notes=notes)


def _samples(
    table: TextTable,
    leads: Sequence[Column],
    clocks: Sequence[TimeColumn],
    counters: Sequence[TimeColumn],
    given: Given,
) -> tuple[pd.DataFrame, float]:
    """Read leads and times, once the first rows show that the recording is not too long."""
    # sample numbers tell about gaps where no times do
    clocks = clocks if clocks else counters if given.sampling_rate is not None else ()
    places = [column.place for column in leads] + [clock.place for clock in clocks]
    first = read_columns(table, places, rows=FIRST_ROWS)
    check_extent(table.rows, _rate(table, clocks, first, given), str(table.path))
    frame = read_columns(table, places)
    if clocks:
        frame = frame.dropna(how="all")  # spreadsheets end with empty rows
    return frame, _rate(table, clocks, frame, given)


def _rate(
    table: TextTable, clocks: Sequence[TimeColumn], frame: pd.DataFrame, given: Given
) -> float:
    stated = []
    for clock in clocks:
        values, per_second = times(table, clock, frame[clock.place].dropna(), given)
        if len(values) != len(frame.dropna(how="all")):
            raise InputError(f"{table.path}: column {shown(clock.name)} lacks times; fill them in")
        where = f"the column {shown(clock.name)}"
        stated.append((where, rate_of(values, per_second, f"in {where}", table.path)))
    return agreed_rate(table, stated, given)
