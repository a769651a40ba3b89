"""Sampling rates of tables: from time columns, remarks and the user, who must agree."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.recording.readers.read_options import Given
from fascicle.recording.readers.table_cells import numbers, refuse_cells
from fascicle.recording.readers.table_columns import Column, per_second, split_unit
from fascicle.recording.readers.table_text import TextTable, shown

if TYPE_CHECKING:
    import pandas as pd

_TIMES = (
    "time", "t", "elapsed time", "relative time", "timestamp", "time stamp", "zeit", "tiempo",
    "temps", "tempo", "время",
)  # fmt: skip
_COUNTERS = (
    "", "samp #", "sample #", "sample", "samples", "sample number", "sample no", "sample index",
    "index", "n", "unnamed: 0",
)  # fmt: skip
# "0:00.002", "10:15:00.002", "2020-02-01T10:15:00.002Z", "[10:15:00.002 01/02/2020]"
_CLOCK = (
    r"^['\"\[]*(?:\d{4}-\d\d-\d\d[ T])?"
    r"(?:(?P<h>\d{1,2}):)?(?P<m>\d{1,2}):(?P<s>\d{1,2}(?:[.,]\d+)?)"
    r"Z?(?: \d\d/\d\d/\d{4})?['\"\]]*$"
)
_RATE_REMARK = re.compile(
    r"#+\s*(?:fs|sfreq|sampl(?:e|ing)[ _-]?(?:rate|frequency))\s*(?:[\[(_]hz[\])]?)?\s*[:=]\s*"
    r"(?P<rate>\d{1,9}(?:\.\d{1,9})?)\s*(?:hz)?",
    re.IGNORECASE,
)
_UNEVEN = 0.5  # of a step; more is a gap, less is rounding of the time column
_ROUNDING = 1.25  # of the last digit of the times: what rounding moves them from even steps
_FEWEST_ODD = 3  # steps that rounding makes longer or shorter; fewer may as well be gaps
_COARSEST = 2.0  # steps that may be in the last digit of the times
_SAME_RATE = 2e-3  # relative; more is no rounding of the times
_LATEST = 1e18  # in any unit; us since 1970 are below
_SAME_UNIT = 0.1  # relative, between steps of times and of the rate given
_RATE_DIGITS = 6  # after the decimal point; more is rounding of binary numbers


@dataclass(frozen=True)
class TimeColumn:
    """A column of times; how many of its units are a second is None where nothing says it."""

    place: int
    name: str
    per_second: float | None


def time_columns(columns: Sequence[Column]) -> list[TimeColumn]:
    """Return the columns whose names say that they hold times."""
    found = []
    for column in columns:
        name = split_unit(column.name)[0].lower().replace("_", " ")
        of_name = per_second(name)
        if of_name is not None or name in _TIMES:
            unit = per_second(column.unit) if column.unit is not None else of_name
            found.append(TimeColumn(column.place, column.name, unit))
    return found


def counter_columns(columns: Sequence[Column]) -> list[TimeColumn]:
    """Return the columns whose names say that they number the samples."""
    return [
        TimeColumn(column.place, column.name, None)
        for column in columns
        if column.name.lower().replace("_", " ").strip("'\"") in _COUNTERS
    ]


def times(
    table: TextTable, column: TimeColumn, cells: pd.Series, given: Given
) -> tuple[NDArray[np.float64], float]:
    """Return the times of a column and how many of their units are a second.

    Parameters
    ----------
    table : TextTable
        The table.
    column : TimeColumn
        Which column it is.
    cells : (n,) Series
        Its cells: numbers, or times of a clock.
    given : Given
        Its rate tells the unit of times without one: they step by 1/rate, 1000/rate or 1.

    Raises
    ------
    InputError
        When the unit is unknown, or a cell is no time.
    """
    if cells.dtype == object and ":" in str(cells.iloc[0] if len(cells) else ""):
        return _clock(table, column, cells), 1.0
    values = numbers(table, column.place, cells)
    if column.per_second is not None:
        return values, column.per_second
    if given.sampling_rate is None:
        raise InputError(
            f"{table.path}: unknown unit of the time column {shown(column.name)}; name it time_ms "
            "or time_s, or give the rate in Hz by --sampling-rate"
        )
    step, rate = _step(values), given.sampling_rate
    # s, ms, or numbers of samples; whether they fit exactly is seen once gaps are excluded
    scale = min((1.0, 1000.0, rate), key=lambda scale: abs(step * rate / scale - 1.0))
    if abs(step * rate / scale - 1.0) <= _SAME_UNIT:
        return values, scale
    raise InputError(
        f"{table.path}: column {shown(column.name)} steps by {step:g}, which at the {rate:g} Hz of "
        "--sampling-rate is neither s nor ms nor a count of samples; correct one of them"
    )


def _clock(table: TextTable, column: TimeColumn, cells: pd.Series) -> NDArray[np.float64]:
    """Seconds of times of a clock; a missing cell is NaN."""
    parts = cells.astype(str).str.extract(_CLOCK)
    wrong = parts["s"].isna().to_numpy() & cells.notna().to_numpy()
    refuse_cells(
        table, column.name, cells, wrong, "times must be numbers, or all be written hh:mm:ss.mmm"
    )
    hours = parts["h"].fillna("0").astype(float).to_numpy()
    minutes = parts["m"].astype(float).to_numpy()
    seconds = parts["s"].str.replace(",", ".").astype(float).to_numpy()
    return np.asarray(3600.0 * hours + 60.0 * minutes + seconds)


def rate_of(values: NDArray[np.float64], scale: float, where: str, source: Path) -> float:
    """Return the sampling rate of increasing, evenly spaced times.

    Parameters
    ----------
    values : (n,) array
        Times; they may be rounded.
    scale : float
        How many of their units are a second.
    where : str
        Whose times they are, for messages.
    source : Path
        What messages begin with.

    Returns
    -------
    float
        Samples per second (Hz), by least squares over all times.

    Raises
    ------
    InputError
        When times are missing, do not increase, have gaps or are too coarse.
    """
    if len(values) < 2:
        raise InputError(f"{source}: {len(values)} rows of samples; give at least two beats")
    step = _step(values)
    # the step is no number where a time is too large to subtract
    if not step > 0 or (np.diff(values) < 0).any():
        raise InputError(
            f"{source}: times {where} do not increase from row to row; sort or correct them"
        )
    residual = values - values[0] - step * np.arange(len(values))
    if np.ptp(residual) > _UNEVEN * step:
        _check_rounding(values, step, float(np.ptp(residual)), scale, f"{source}")
    return round(scale / step, _RATE_DIGITS)


def _step(values: NDArray[np.float64]) -> float:
    """Mean step of times, by least squares; NaN where there is none."""
    order = np.arange(len(values)) - (len(values) - 1) / 2
    if len(values) < 2 or np.abs(values).max() > _LATEST:
        return float("nan")
    return float(order @ (values - values[0]) / (order @ order))


def _check_rounding(
    values: NDArray[np.float64], step: float, spread: float, scale: float, source: str
) -> None:
    """Refuse times that are uneven, unless rounding to their last digit explains it."""
    digit = _last_digit(values)
    rounding = spread <= _ROUNDING * digit
    steps = np.diff(values)
    odd = np.count_nonzero(np.abs(steps - np.median(steps)) > digit / 2)
    if rounding and digit <= _COARSEST * step and odd >= _FEWEST_ODD:
        return
    if rounding and digit > _COARSEST * step:
        raise InputError(
            f"{source}: times are rounded to {1000 * digit / scale:g} ms but step by "
            f"{1000 * step / scale:.3g} ms; write them with more digits, or leave the column "
            "out and give the rate in Hz by --sampling-rate"
        )
    k = int(np.argmax(np.abs(steps - step)))
    raise InputError(
        f"{source}: samples are not evenly spaced ({1000 * steps[k] / scale:g} ms after "
        f"{values[k] / scale:g} s, {1000 * step / scale:.4g} ms on average); resample, or "
        "cut the recording to a part without gaps"
    )


def _last_digit(values: NDArray[np.float64]) -> float:
    """Return the largest power of ten that all values are multiples of; zero if none."""
    for digits in range(7):
        scaled = values * 10.0**digits
        if (np.abs(scaled - np.rint(scaled)) <= 1e-6 + 1e-12 * np.abs(scaled)).all():
            return float(10.0**-digits)
    return 0.0


def agreed_rate(table: TextTable, stated: Sequence[tuple[str, float]], given: Given) -> float:
    """Return the sampling rate that the user, the remarks and the time columns agree about.

    Parameters
    ----------
    table : TextTable
        Its remarks may state the rate (``# sampling_rate: 500``).
    stated : sequence of (str, float)
        Who else states a rate (Hz).
    given : Given
        What the user says.

    Returns
    -------
    float
        Samples per second (Hz): what the user says, or else a remark, or else the first of
        `stated`, which may have been rounded.

    Raises
    ------
    InputError
        When they disagree by more than rounding, or nothing states the rate.
    """
    remarks = [m["rate"] for line in table.remarks if (m := _RATE_REMARK.fullmatch(line))]
    rates = [("a remark", float(rate)) for rate in remarks] + list(stated)
    if given.sampling_rate is not None:
        rates = [("--sampling-rate", given.sampling_rate), *rates]
    if not rates:
        raise InputError(
            f"{table.path}: no time column among {table.columns_shown}; add one named time_ms or "
            "time_s, or give the rate in Hz by --sampling-rate"
        )
    who, rate = rates[0]
    for other_who, other in rates[1:]:
        if not abs(other - rate) <= _SAME_RATE * rate:
            raise InputError(
                f"{table.path}: sampling rate is {rate:g} Hz by {who}, {other:g} Hz by {other_who}"
                "; correct the wrong one"
            )
    return rate
