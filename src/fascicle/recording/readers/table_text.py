"""Text tables: encoding, separator, decimal mark, header and units, found without guessing."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

from fascicle.core.errors import InputError
from fascicle.recording.readers.decimal_marks import Mark, decimal_mark
from fascicle.recording.readers.names import first_line

_BLOCK = 2**20  # characters that are looked at together
_LONGEST_LINE = 2**16  # characters; 256 columns of long names take less
_MOST_COLUMNS = 256
_MOST_LINES = 25_000_000  # rows of a lead and a time; the largest file has fewer of twelve leads
_FIRST_LINES = 1000  # where the header and its first rows must be
_HEAD = 20  # rows that must agree about the separator
BLANKS = " "  # stands for runs of blanks as the separator
_CONTROL = re.compile("[\x00-\x08\x0e-\x1f\x7f]")
_NUMBER = re.compile(r"[+-]?[.,]?\d.*", re.DOTALL)
_SEPARATOR_LINE = re.compile(r'"?sep=(?P<separator>[;,\t|])"?', re.IGNORECASE)  # written by Excel
_SHOWN, _SHOWN_COLUMNS = 30, 4  # characters of a cell, and columns, in a message


@dataclass(frozen=True)
class TextTable:
    """What must be known of a text table to read its cells.

    Attributes
    ----------
    path : Path
        The file.
    encoding, separator, quote, decimal : str
        As Python and pandas name them; the separator is a blank for runs of blanks.
    names : tuple of str
        Cells of the header.
    units : tuple of str
        Cells of the row of units under the header, as many as names; empty where there is none.
    remarks : tuple of str
        Lines that begin with ``#`` before the first row.
    first_row : int
        Lines of the file before the first row of samples.
    rows : int
        Rows of samples.
    remarks_between : bool
        Whether lines that begin with ``#`` follow the first row.
    """

    path: Path
    encoding: str
    separator: str
    quote: str
    decimal: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    remarks: tuple[str, ...]
    first_row: int
    rows: int
    remarks_between: bool

    @property
    def columns_shown(self) -> str:
        """The first columns' names, for messages."""
        first = ", ".join(shown(name) for name in self.names[:_SHOWN_COLUMNS])
        return first + " ..." * (len(self.names) > _SHOWN_COLUMNS)


def shown(text: str) -> str:
    """Quote text of a file for a message: one line, not long."""
    return repr(text if len(text) <= _SHOWN else f"{text[: _SHOWN - 4]} ...")


def open_table(path: Path) -> TextTable:
    """Find out how a table is written; the whole file is looked at, in bounded memory.

    Parameters
    ----------
    path : Path
        Text with cells separated by tabs, semicolons, commas or blanks; the first line that is not
        empty and does not begin with ``#`` names the columns.

    Raises
    ------
    InputError
        When the file is no text or no table, or what its commas mean cannot be told.
    """
    try:
        encoding = _encoding(path)
        with path.open(encoding=encoding) as file:
            return _open(path, encoding, file)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({first_line(error)})") from error


def _open(path: Path, encoding: str, file: TextIO) -> TextTable:
    numbered = enumerate((line.strip("\r\n") for line in file), start=1)
    said = ""
    remarks: list[str] = []
    head: list[tuple[int, str]] = []
    for number, line in numbered:
        if line.lstrip().startswith("#"):
            remarks.append(line.strip())
        elif not head and (match := _SEPARATOR_LINE.fullmatch(line.strip(" "))):
            said = match["separator"]
        elif line.strip():
            head.append((number, line))
        if len(head) > _HEAD or number >= _FIRST_LINES:
            break
    quote = "'" if head and head[0][1].lstrip().startswith("'") else '"'
    separator = _separator(path, [line for _, line in head], quote, said)
    names = _trimmed(_cells(head[0][1], separator, quote))
    under = _cells(head[1][1], separator, quote)
    has_units = any(under) and not any(_is_number(cell) for cell in under)
    first_row = head[1][0] if has_units else head[1][0] - 1
    file.seek(0)
    rows = islice(enumerate(file, start=1), first_row, None)
    count, decimal, between = _survey(path, rows, separator, quote, len(names))
    return TextTable(
        path, encoding, separator, quote, decimal, tuple(names),
        tuple(under[: len(names)]) if has_units else ("",) * len(names),
        tuple(remarks), first_row, count, between,
    )  # fmt: skip


def _encoding(path: Path) -> str:
    """Tell the encoding; refuse what is no text or has lines without end."""
    with path.open("rb") as file:
        mark = file.read(2)
    wide = mark in (b"\xff\xfe", b"\xfe\xff")
    # every byte is latin-1, whose letter µ is known
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "latin-1"):
        try:
            _check_text(path, encoding)
        except UnicodeDecodeError:
            continue
        return encoding
    raise InputError(f"{path}: not readable as text in UTF-16; save the table as text in UTF-8")


def _check_text(path: Path, encoding: str) -> None:
    line = 0  # characters since the last line end
    lines = 0
    with path.open(encoding=encoding) as file:
        while block := file.read(_BLOCK):
            if match := _CONTROL.search(block):
                raise InputError(
                    f"{path}: no text table (holds the byte {ord(match[0])}); save the recording "
                    "as CSV text in UTF-8"
                )
            lengths = [len(part) for part in block.split("\n")]
            lengths[0] += line
            line = lengths[-1]
            lines += len(lengths) - 1
            if max(lengths) > _LONGEST_LINE:
                raise InputError(
                    f"{path}: no table of samples (a line has more than {_LONGEST_LINE} "
                    "characters); save one row per sample and one column per lead"
                )
            if lines > _MOST_LINES:
                raise InputError(
                    f"{path}: more than {_MOST_LINES} lines; cut the recording, 10 s are enough"
                )


def _separator(path: Path, head: Sequence[str], quote: str, said: str) -> str:
    """Return the separator by which the header and the first rows have equally many cells."""
    if len(head) < 2:
        raise InputError(
            f"{path}: no row of samples in its first {_FIRST_LINES} lines; give a table with a "
            "time column and one column per lead"
        )
    widths: dict[str, tuple[int, int]] = {}
    for separator in [said] if said else ["\t", ";", ",", BLANKS]:
        width = len(_trimmed(_cells(head[0], separator, quote)))
        for line in head[1:]:
            cells = _cells(line, separator, quote)
            if len(cells) < width or any(cells[width:]):
                widths[separator] = width, len(cells)
                break
        else:
            if 2 <= width <= _MOST_COLUMNS:
                return separator
            widths[separator] = width, width
    columns, found = max(widths.values())
    if columns < 2 or columns > _MOST_COLUMNS or columns == found:
        raise InputError(
            f"{path}: no table of samples (its first line is {shown(head[0].strip())}); the first "
            "line must name the columns, such as time_ms,I_mV,II_mV"
        )
    raise InputError(
        f"{path}: header has {columns} cells, a row under it {found}; give all rows the cells of "
        "the header, and separate numbers with decimal commas by semicolons"
    )


def _cells(line: str, separator: str, quote: str) -> list[str]:
    """Split a line, with quotes and blanks around the cells taken away."""
    if separator == BLANKS:
        line = " ".join(line.split())
    reader = csv.reader([line], delimiter=separator, quotechar=quote, skipinitialspace=True)
    return [" ".join(cell.split()) for cell in next(reader, [])]


def _trimmed(cells: list[str]) -> list[str]:
    """Leave out empty cells at the end: some exporters end lines with a separator."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.strip("'\"[")) is not None or cell.lower() in ("nan", "na")


def _survey(
    path: Path, rows: Iterator[tuple[int, str]], separator: str, quote: str, width: int
) -> tuple[int, str, bool]:
    """Count the rows, refuse too long ones, and tell the decimal mark and remarks between."""
    marks = [Mark(mark) for mark in ".," if mark != separator]
    count, remarks_between = 0, False
    blanks = "\r\n " if separator == "\t" else "\r\n\t "
    for number, line in rows:
        text = line.strip(blanks)
        if not text:
            continue
        if text[0] == "#":
            remarks_between = True
            continue
        count += 1
        cells = text.split() if separator == BLANKS else text.split(separator)
        if len(cells) > width and any(_cells(text, separator, quote)[width:]):
            raise InputError(
                f"{path}: line {number} has more cells than the header, which has {width}; give "
                "all rows the cells of the header, and separate numbers with decimal commas by "
                "semicolons"
            )
        for mark in marks:
            mark.look(text)
    return count, decimal_mark(path, marks, separator), remarks_between
