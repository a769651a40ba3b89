"""The table of a cohort: a patient a row."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from fascicle.core.errors import InputError, one_line
from fascicle.core.files import as_path, check_file
from fascicle.core.ranges import shown
from fascicle.heart.folder import DEFAULT_HEART
from fascicle.study.settings import FitSettings

NEEDED = ("patient", "heart", "recording")
COLUMNS = (*NEEDED, "scenario", "settings", *FitSettings.model_fields)
SEPARATORS = ",;\t"  # spreadsheets write the second where the comma is a decimal point
NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"  # a folder's on every system, and as it is in a link
Item = TypeVar("Item")
PART = r"(\d{1,9})/(\d{1,9})"


@dataclass(frozen=True)
class Row:
    """A patient.

    Attributes
    ----------
    patient : str
        Name of the patient and of the study.
    heart : path or str
        Folder, or ``"default"``.
    recording : Path
        A target (.nc), or a recording in any format of `fascicle.read_recording`.
    scenario : Path, optional
        In which it was recorded, if that was not the intrinsic beat.
    settings_file : Path, optional
        TOML file of settings and parameters.
    settings : mapping of name to value
        Fields of `FitSettings`, which count more than those of the file.
    """

    patient: str
    heart: Path | str
    recording: Path
    scenario: Path | None = None
    settings_file: Path | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


def read_table(path: Path | str) -> list[Row]:
    """Read the table of a cohort; its paths count from its folder.

    Parameters
    ----------
    path : path
        Text in UTF-8: a line that names the columns, then a line for each patient. Columns are
        separated by commas, semicolons or tabs.

    Raises
    ------
    InputError
        With the line, if it is not such a table, names a patient twice, or has an impossible
        setting.
    """
    path = as_path(path, "table")
    check_file(path, (".csv", ".tsv"), "table of patients")
    lines = _lines(path)
    if not lines:
        raise InputError(f"{path}: is empty; name the columns, such as {','.join(NEEDED)}")
    (_, columns), *cells = lines
    _check_columns(path, columns)
    rows: dict[str, Row] = {}
    for number, values in cells:
        where = f"{path}, line {number}"
        if len(values) != len(columns):
            raise InputError(
                f"{where}: has {len(values)} cells where the first line names {len(columns)} "
                "columns; put a text that holds the separator between double quotes"
            )
        row = _row(path.parent, where, dict(zip(columns, values, strict=True)))
        if row.patient.lower() in rows:  # some systems do not tell capitals apart
            raise InputError(f"{where}: patient '{row.patient}' is there twice; give another name")
        rows[row.patient.lower()] = row
    if not rows:
        raise InputError(f"{path}: has no patient; write a line for each below the columns")
    return list(rows.values())


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Cells of the lines that are not empty, with their numbers from 1."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        separator = max(SEPARATORS, key=text.partition("\n")[0].count)
        reader = csv.reader(text.splitlines(keepends=True), delimiter=separator, strict=True)
        lines = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{path}: is no table in text ({one_line(error)}); save it as CSV (UTF-8)"
        ) from None
    return [(number, cells) for number, cells in lines if any(cells)]


def _check_columns(path: Path, columns: Sequence[str]) -> None:
    """Refuse a first line that does not name the columns."""
    for name in columns:
        if name not in COLUMNS:
            raise InputError(
                f"{path}, line 1: unknown column {shown(name)}; known: {', '.join(COLUMNS)}"
            )
        if columns.count(name) > 1:
            raise InputError(f"{path}, line 1: column '{name}' is there twice; keep one")
    for name in NEEDED:
        if name not in columns:
            raise InputError(
                f"{path}, line 1: no column '{name}'; name the columns there, such as "
                f"{','.join(NEEDED)}"
            )


def _row(folder: Path, where: str, cells: Mapping[str, str]) -> Row:
    """A row of its cells; an empty one says nothing."""
    given = {name: cell for name, cell in cells.items() if cell}
    for name in NEEDED:
        if name not in given:
            raise InputError(f"{where}: no {name} is given; fill the cell")
    if not re.fullmatch(NAME, given["patient"]):
        raise InputError(
            f"{where}: {shown(given['patient'])} cannot be the name of a folder; use letters from "
            "a to z, digits, '-', '_' and '.', the first a letter or a digit"
        )
    paths = {
        name: folder.absolute() / as_path(given[name], f"{where}: {name}")
        for name in ("heart", "recording", "scenario", "settings")
        if name in given
    }
    try:
        settings = {
            name: getattr(FitSettings(**{name: cell}), name)
            for name, cell in given.items()
            if name in FitSettings.model_fields
        }
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return Row(
        given["patient"],
        DEFAULT_HEART if given["heart"] == DEFAULT_HEART else paths["heart"],
        paths["recording"],
        paths.get("scenario"),
        paths.get("settings"),
        settings,
    )


def part_of(rows: Sequence[Item], only: str | None) -> list[Item]:
    """Rows i, i + n, i + 2n, ... of ``"i/n"``, counted from 1; all of them without.

    Raises
    ------
    InputError
        If it is no such part.
    """
    if only is None:
        return list(rows)
    found = re.fullmatch(PART, only)
    first, step = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= first <= step:
        raise InputError(f"--only is {shown(only)}; give i/n with i from 1 to n, such as 1/20")
    return list(rows[first - 1 :: step])
