"""Recordings as tables: a time column and one column per lead."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fascicle.errors import InputError
from fascicle.io.recordings.contents import Channel, Contents, Given
from fascicle.io.recordings.names import first_line
from fascicle.leads import LEADS

# "V1_uV", "V1 [uV]", "V1 (uV)": a name and its unit
_WITH_UNIT = re.compile(
    r"\s*(?P<name>.+?)\s*(?:[\[(]\s*(?P<bracket>[^\])]*?)\s*[\])]|[_ ](?P<tail>[nuµμm]?v|ms|s))\s*",
    re.IGNORECASE,
)
_PER_SECOND = {"ms": 1000.0, "s": 1.0}
_UNEVEN = 0.5  # of a step; more is a gap, less is rounding of the time column


def read_table(path: Path, given: Given) -> Contents:
    """Read a table with ``time_ms`` or ``time_s`` and leads whose units are in the header."""
    table = _table(path)
    names = [str(column) for column in table.columns]
    time_column, per_second = _time_column(path, names)
    rate = _rate(path, _numbers(path, table, time_column) / per_second)
    written_here = names == ["time_ms", *LEADS]
    channels = []
    for name in names:
        if name != time_column:
            quantity, unit = _split(name)
            unit = "mV" if written_here else unit
            channels.append(Channel(quantity, _numbers(path, table, name), unit))
    return Contents(channels, rate, "table")


def _table(path: Path) -> Any:
    import pandas as pd

    try:
        with path.open(encoding="utf-8-sig") as file:
            header = next((line for line in file if line.strip() and line[0] != "#"), "")
        separator = max(",;\t", key=header.count)
        table = pd.read_csv(path, sep=separator, comment="#", skipinitialspace=True)
    except (ValueError, OSError) as error:  # pandas' ParserError and EmptyDataError are ValueErrors
        raise InputError(
            f"{path}: not a readable CSV table ({first_line(error)}); save it as comma-separated "
            "text in UTF-8 with one header line"
        ) from error
    if len(table) < 2:
        raise InputError(f"{path}: {len(table)} rows of samples; give at least two beats")
    return table.rename(columns=lambda name: str(name).strip())


def _split(name: str) -> tuple[str, str | None]:
    """Split a column name into the name proper and its unit, if it has one."""
    match = _WITH_UNIT.fullmatch(name)
    if match is None:
        return name.strip(), None
    unit = match["tail"] if match["bracket"] is None else match["bracket"]
    return match["name"], unit


def _time_column(path: Path, names: list[str]) -> tuple[str, float]:
    """Find the time column and how many of its units are a second."""
    for name in names:
        quantity, unit = _split(name)
        if quantity.lower() in ("time", "t"):
            if unit is None or unit.lower() not in _PER_SECOND:
                raise InputError(
                    f"{path}: unknown units of the time column '{name}'; name it time_ms or time_s"
                )
            return name, _PER_SECOND[unit.lower()]
    raise InputError(
        f"{path}: no time column among {', '.join(names[:4])}{' ...' * (len(names) > 4)}; add one "
        "named time_ms or time_s"
    )


def _numbers(path: Path, table: Any, name: str) -> NDArray[np.float64]:
    """Return a column as numbers, (n,); empty cells are NaN."""
    import pandas as pd

    column = table[name]
    numbers = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64)
    wrong = np.flatnonzero(np.isnan(numbers) & column.notna().to_numpy())
    if wrong.size:
        raise InputError(
            f"{path}: column '{name}' holds {str(column.iloc[wrong[0]])[:20]!r} in row "
            f"{wrong[0] + 2}; every sample must be a number with a decimal point"
        )
    return np.asarray(numbers)


def _rate(path: Path, seconds: NDArray[np.float64]) -> float:
    """Return the sampling rate (Hz) of increasing, evenly spaced times."""
    steps = np.diff(seconds)
    step = (seconds[-1] - seconds[0]) / len(steps)
    if not np.isfinite(seconds).all() or step <= 0 or (steps <= 0).any():
        raise InputError(f"{path}: times do not increase from row to row; sort or correct them")
    uneven = np.flatnonzero(np.abs(steps - step) > _UNEVEN * step)
    if uneven.size:
        k = int(uneven[0])
        raise InputError(
            f"{path}: samples are not evenly spaced ({1000 * steps[k]:g} ms after row {k + 2}, "
            f"{1000 * step:g} ms on average); resample, or cut the recording to a part without gaps"
        )
    return float(1.0 / step)
