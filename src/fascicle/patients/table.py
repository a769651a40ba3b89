"""The table of a cohort: one patient a row."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from fascicle.core.errors import FileError, ValueRefusedError, given_in, one_line
from fascicle.core.files import as_path, check_file
from fascicle.core.ranges import shown
from fascicle.heart.folder import DEFAULT_HEART
from fascicle.patients.patient import Patient
from fascicle.study.settings import FitSettings

NEEDED = ("patient", "heart", "recording")  # columns


def read_table(path: Path | str, cohort: Path) -> list[Patient]:
    """Read the table of a cohort; paths are relative to the table's folder.

    The first line names the columns, separated by commas, semicolons or tabs; each further line
    describes a patient. Error messages name the line.
    """
    path = as_path(path, "table")
    check_file(path, (".csv", ".tsv"), "table of patients")
    patients: dict[str, Patient] = {}
    for number, cells in _lines(path):
        with given_in(f"{path}, line {number}"):
            patient = _patient(path.parent.absolute(), cells, cohort)
            # some file systems ignore case
            if patients.setdefault(patient.name.lower(), patient) is not patient:
                raise FileError(f"patient '{patient.name}' is there twice; give another name")
    if not patients:
        raise FileError(f"{path}: has no patient; write a line for each below the columns")
    return list(patients.values())


def _lines(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Numbers of the lines that are not empty, with their non-empty cells by column."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        # spreadsheets write semicolons where the comma is a decimal point
        separator = max(",;\t", key=text.partition("\n")[0].count)
        reader = csv.DictReader(text.splitlines(keepends=True), delimiter=separator, strict=True)
        columns = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = columns
        lines = [(reader.line_num, cells) for cells in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(
            f"{path}: is not a table in text ({one_line(error)}); save it as CSV (UTF-8)"
        ) from None
    known = (*NEEDED, "scenario", "settings", *FitSettings.model_fields)
    wrong = [name for name in columns if name not in known or columns.count(name) > 1]
    wrong += [name for name in NEEDED if name not in columns]
    if wrong:
        raise FileError(
            f"{path}, line 1: column {shown(wrong[0])} is unknown, missing or there twice; name "
            f"each column there, such as {','.join(NEEDED)}; known are {', '.join(known)}"
        )
    for number, cells in lines:
        if None in cells or None in cells.values():  # one too many, or too few
            raise FileError(
                f"{path}, line {number}: has other columns than the {len(columns)} of the first "
                "line; put a text that holds the separator between double quotes"
            )
    given = [(k, {n: c.strip() for n, c in cells.items() if c.strip()}) for k, cells in lines]
    return [(number, cells) for number, cells in given if cells]


def _patient(folder: Path, given: Mapping[str, str], cohort: Path) -> Patient:
    """Make a patient from the cells of a line."""
    for name in NEEDED:
        if name not in given:
            raise FileError(f"no {name} is given; fill the cell")
    # valid as a folder name on every system, and unescaped in a link
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", given["patient"]):
        raise FileError(
            f"{shown(given['patient'])} cannot be the name of a folder; use letters from a to z, "
            "digits, '-', '_' and '.', the first a letter or a digit"
        )
    paths = {
        name: folder / as_path(given[name], name)
        for name in ("heart", "recording", "scenario", "settings")
        if name in given
    }
    fields = {name: cell for name, cell in given.items() if name in FitSettings.model_fields}
    settings = FitSettings(**fields)
    return Patient(
        given["patient"],
        cohort,
        DEFAULT_HEART if given["heart"] == DEFAULT_HEART else paths["heart"],
        paths["recording"],
        paths.get("scenario"),
        paths.get("settings"),
        {name: getattr(settings, name) for name in fields},
    )


def part_of(patients: Sequence[Patient], only: str | None) -> list[Patient]:
    """Patients i, i + n, i + 2n, ... of ``"i/n"``, counted from 1; all of them without."""
    if only is None:
        return list(patients)
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", only) if isinstance(only, str) else None
    first, step = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= first <= step:
        raise ValueRefusedError(
            f"--only is {shown(only)}; give i/n with i from 1 to n, such as 1/20"
        )
    return list(patients[first - 1 :: step])
