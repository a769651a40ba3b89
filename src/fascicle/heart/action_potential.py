"""The action potential of the ECG as a table."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import ClassVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line, printable
from fascicle.core.files import as_path, check_file


@dataclass(frozen=True, eq=False)
class TabulatedPotential:
    """Action potential U, linear between the samples of a table; an `ActionPotential`.

    Attributes
    ----------
    times : (n,) array
        Times of the samples (ms since activation), increasing.
    potentials : (n,) array
        Transmembrane potentials of the samples (mV).
    """

    columns: ClassVar[list[str]] = ["time_ms", "potential_mV"]

    times: Floats
    potentials: Floats

    @property
    def span(self) -> tuple[float, float]:
        """See `ActionPotential`."""
        return float(self.times[0]), float(self.times[-1])

    def __call__(self, time: Floats) -> Floats:
        """See `ActionPotential`; constant before and after the table."""
        return np.asarray(np.interp(time, self.times, self.potentials))


def read_action_potential(path: str | PathLike[str]) -> TabulatedPotential:
    """Read the action potential U(t) of the ECG from a table, for `ForwardModel`.

    Between samples U is linear, outside the table constant. The ECG is a QRS complex alone if the
    table ends in the plateau; repolarisation, the same in all cells, adds a T wave opposite to the
    QRS.

    Parameters
    ----------
    path : path
        CSV file with the columns ``time_ms`` (ms since activation, increasing; the upstroke is
        within 5 ms of 0) and ``potential_mV`` (mV), with at least 10 samples.

    Returns
    -------
    TabulatedPotential
        U (mV) as a function of the time since activation (ms).

    Raises
    ------
    InputError
        If the file is missing or not such a table.
    """
    file = as_path(path, "action potential", "the path of a CSV file")
    check_file(file, (".csv",), "action potential")
    remedy = "give a CSV file with the header time_ms,potential_mV and two numbers in every row"
    try:
        text = file.read_text(encoding="utf-8-sig")
        table = [row for row in csv.reader(text.splitlines(), strict=True) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file}: not a readable table ({one_line(error)}); {remedy}") from error
    header = [name.strip() for name in table[0]] if table else []
    if header != TabulatedPotential.columns:
        raise InputError(f"{file}: its header is '{printable(','.join(header))[:60]}'; {remedy}")
    rows = [_numbers(file, row, number) for number, row in enumerate(table[1:], 1)]
    times, potentials = np.array(rows).reshape(-1, 2).T
    _check(str(file), times, potentials)
    return TabulatedPotential(times, potentials)


def write_action_potential(path: Path, table: TabulatedPotential) -> None:
    """Write a table that `read_action_potential` reads back exactly."""
    rows = zip(table.times.tolist(), table.potentials.tolist(), strict=True)
    text = "\n".join([",".join(table.columns), *(f"{time!r},{value!r}" for time, value in rows)])
    path.write_text(f"{text}\n", encoding="utf-8")


def _numbers(file: Path, row: list[str], number: int) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError:
        values = []
    if len(values) != 2 or not np.isfinite(values).all():
        text = printable(",".join(row))[:60]
        raise InputError(f"{file}: row {number} of samples is '{text}'; give two numbers")
    return values


def _check(file: str, times: Floats, potentials: Floats) -> None:
    if len(times) < 10:
        raise InputError(f"{file}: {len(times)} samples; give 10 or more")
    # the ECG ends at most 2000 ms after the last activation; more than 200 mV means µV
    for name, values, limit in (("time_ms", times, 2000.0), ("potential_mV", potentials, 200.0)):
        furthest = values[np.abs(values).argmax()]
        if abs(furthest) > limit:
            raise InputError(f"{file}: {name} reaches {furthest:g}; give -{limit:g} to {limit:g}")
    if len(back := np.flatnonzero(np.diff(times) <= 0)):
        before, after = times[back[0]], times[back[0] + 1]
        raise InputError(
            f"{file}: time_ms goes from {before:g} to {after:g} ms in row {back[0] + 2} of "
            "samples; give increasing times"
        )
    if np.ptp(potentials) < 1.0:  # mV: a table in V, or one without an upstroke
        raise InputError(
            f"{file}: potential_mV changes by {np.ptp(potentials):g} mV in all; give an action "
            f"potential in mV, which rises by 1 mV or more"
        )
    steepest = int((np.diff(potentials) / np.diff(times)).argmax())
    upstroke = float(times[steepest : steepest + 2].mean())
    if abs(upstroke) > 5.0:  # ms; the ECG would be shifted by as much
        raise InputError(
            f"{file}: the steepest rise is at {upstroke:g} ms; give times since the upstroke "
            f"(within 5 ms of 0)"
        )
