"""Text tables: their cells by pandas, their columns by the names in the header."""

from __future__ import annotations

import codecs
import contextlib
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line, printable
from fascicle.core.leads import LEADS
from fascicle.recording.readers.metadata import Entry, declared_unit, entry_of
from fascicle.recording.readers.names import lead_name, millivolts, plain_unit, same_unit

if TYPE_CHECKING:
    import pandas as pd

LARGEST_TABLE = 256 * 2**20  # bytes; 30 min of 12 leads at 1000 Hz take 200 MB
_MOST_COLUMNS = 256
_SEPARATORS = "\t;,"  # the first of them in the header separates the cells
_COMMENT = re.compile(r"^[ \t]*#+[ \t]*(.*)$", re.MULTILINE)
_DECLARATION = re.compile(r"([\w -]{1,40}?)\s*[:=]\s*(\S.{0,40}?)\s*")  # "fs: 500"
_BRACKETS = re.compile(r"(?P<name>.+?)\s*[\[(]\s*(?P<unit>[^\])]*?)\s*[\])]")  # "V1 [uV]"
_TAIL = re.compile(r"(?P<name>.+?)(?:[_ ]in[_ ]|[_ ]|\s*/\s*)(?P<unit>[^_ /]+)")  # "V1_uV", "V1/uV"
_RHYTHM = re.compile(
    r"[\s_(.-]*(?<![a-z])(?:rhythm(?:[\s_]strip)?|long)(?![a-z])\)?[\s_.-]*", re.IGNORECASE
)
_LONGEST_NAME = 100  # characters; bounds what matching takes
_RENAMED = re.compile(r"(?P<name>.+)\.\d+")  # how pandas renames a column that is there twice
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_CLOCK = re.compile(r"^'(?:(\d{1,4}):)?(\d{1,4}):(\d{1,4}\.\d{1,9})'", re.ASCII | re.MULTILINE)
_OWN_HEADER = ["time_ms", *LEADS]  # what this package writes, in mV
_PER_SECOND = (
    dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0)
    | dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e3)
    | dict.fromkeys(("us", "microsecond", "microseconds"), 1e6)
)


@dataclass(frozen=True)
class Column:
    """A column: its name and the unit in it, as in the file, and the lead that it holds, if any.

    `quantity` is the name without the unit, in small letters with blanks for underscores; `rhythm`
    says that the name is that of a rhythm strip, which may repeat a lead.
    """

    name: str
    quantity: str
    unit: str | None
    lead: str | None
    rhythm: bool

    @property
    def per_second(self) -> float | None:
        """How many of the column's units are a second; None where it has no unit of time."""
        return _PER_SECOND.get(plain_unit(self.quantity if self.unit is None else self.unit))


@dataclass(frozen=True)
class Table:
    """Cells of a table, whose columns are named by their places, and what its comments declare."""

    path: Path
    frame: pd.DataFrame
    columns: Sequence[Column]
    metadata: Sequence[Entry]

    @property
    def shown(self) -> str:
        """The first columns' names, for messages."""
        first = ", ".join(f"'{printable(column.name[:30])}'" for column in self.columns[:4])
        return first + " ..." * (len(self.columns) > 4)

    def cells(self, column: Column) -> pd.Series:
        """Cells of a column as they are."""
        return self.frame[self.columns.index(column)]

    def unit_of(self, column: Column) -> str | None:
        """Unit of a lead, which its header and the comments must agree about."""
        commented = declared_unit(self.metadata, self.path, column.name)
        own = [column.name for column in self.columns] == _OWN_HEADER
        unit = "mV" if own else column.unit
        if unit is not None and commented is not None and not same_unit(unit, commented):
            raise InputError(
                f"{self.path}: column '{printable(column.name)}' is in '{printable(unit)}', a "
                f"comment says '{commented}'; correct the wrong one"
            )
        return commented if unit is None else unit

    def numbers(self, column: Column) -> Floats:
        """Cells of a column as numbers (n,); empty cells are NaN."""
        import pandas as pd

        cells = self.cells(column)
        if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
            values = cells.to_numpy(dtype=np.float64)
        else:  # not by pandas' own conversion, which crashes as its reader does, see `_parsed`
            texts = cells.astype(str).str.strip()
            values = np.array([float(t) if _NUMBER.fullmatch(t) else np.nan for t in texts])
        wrong = ~np.isfinite(values) & cells.notna().to_numpy()
        if wrong.any():
            first = int(np.argmax(wrong))
            raise InputError(
                f"{self.path}: column '{printable(column.name)}' holds "
                f"'{printable(str(cells.iloc[first])[:40])}' in row {first + 1} of samples; every "
                "cell must be a number, all with the same decimal mark, or empty"
            )
        return np.asarray(values)


def open_table(path: Path) -> Table:
    """Read a table of the schema in ``docs/recordings.md``.

    Text with cells separated by tabs, semicolons or commas; lines that begin with ``#`` are
    comments, the first other line names the columns. Numbers may have decimal commas where no
    comma separates cells.
    """
    if path.stat().st_size > LARGEST_TABLE:
        raise InputError(
            f"{path}: tables of more than {LARGEST_TABLE / 2**20:.0f} MB are not read; cut the "
            "recording, 10 s are enough"
        )
    text = _text(path)
    comments = _COMMENT.findall(text)
    text = _one_header(_COMMENT.sub("", text).lstrip("\n"))
    header = text.partition("\n")[0]
    separator = next((mark for mark in _SEPARATORS if mark in header), None)
    if separator is None or header.count(separator) > _MOST_COLUMNS:
        raise InputError(
            f"{path}: no table of samples (its first line is '{printable(header[:40])}'); the "
            "first line must name the columns, separated by commas, semicolons or tabs, such as "
            "time_ms,I_mV,II_mV"
        )
    frame, columns = _parsed(path, text, separator, ".")
    if separator != "," and _not_numeric(frame, columns):
        with_commas, _ = _parsed(path, text, separator, ",")
        if _not_numeric(with_commas, columns) < _not_numeric(frame, columns):
            frame = with_commas
    declared = [match for line in comments if (match := _DECLARATION.fullmatch(line.strip()))]
    metadata = [entry for match in declared if (entry := entry_of(match[1], match[2])) is not None]
    return Table(path, frame, columns, metadata)


def _text(path: Path) -> str:
    """Return the text of a file, with line ends that pandas and regular expressions know."""
    content, text = path.read_bytes(), ""
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # "Unicode" of Excel
    # every byte is latin-1, whose letter µ is where Windows has it
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "latin-1"):
        with contextlib.suppress(UnicodeDecodeError):
            text = content.decode(encoding)
            break
    if not text or "\0" in text:
        raise InputError(f"{path}: no text in UTF-8; save the table as CSV text in UTF-8")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _one_header(text: str) -> str:
    """Join the names and units that PhysioNet's ``rdsamp`` writes in two rows of single quotes.

    Its clock times (``'0:10.002'``) become seconds.
    """
    names, _, rest = text.partition("\n")
    if not names.startswith("'"):
        return text
    if rest.startswith("'") and not _CLOCK.match(rest):
        units, _, rest = rest.replace("hh:mm:ss.mmm", "s", 1).partition("\n")
        pairs = zip(names.split(","), units.split(","), strict=False)
        names = ",".join(f"{name} [{unit}]" for name, unit in pairs)
    rest = _CLOCK.sub(lambda at: f"{60 * (60 * int(at[1] or 0) + int(at[2])) + float(at[3])}", rest)
    return names.replace("'", "") + "\n" + rest


def _parsed(
    path: Path, text: str, separator: str, decimal: str
) -> tuple[pd.DataFrame, list[Column]]:
    """Return the cells, by the places of their columns, and the columns."""
    import pandas as pd

    try:
        with warnings.catch_warnings():
            # cells beyond those of the header are not dropped
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                BytesIO(text.encode()),
                sep=separator,
                decimal=decimal,
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
                # the other ways crash at 1e4000000000000001 (pandas issue 63089)
                float_precision="round_trip",
            )
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        raise InputError(
            f"{path}: not a readable table ({one_line(error)}); give every row the cells of the "
            "header, and separate numbers with decimal commas by semicolons"
        ) from error
    for _, cells in frame.select_dtypes(object).items():
        if cells.astype(str).str.contains("\n", regex=False).any():
            raise InputError(f"{path}: a quotation mark is not closed in its line; remove it")
    names = [str(name) for name in frame.columns]
    frame.columns = range(len(names))
    return frame, [_column(name, names) for name in names]


def _not_numeric(frame: pd.DataFrame, columns: Sequence[Column]) -> int:
    """Count the leads, times and values whose cells are not all numbers."""
    numeric = set(frame.select_dtypes("number").columns)
    return len({k for k, column in enumerate(columns) if column.lead or column.unit} - numeric)


def _column(spelt: str, names: Sequence[str]) -> Column:
    """Tell what a column holds from its name."""
    renamed = _RENAMED.fullmatch(spelt[:_LONGEST_NAME])
    name = (renamed["name"] if renamed and renamed["name"] in names else spelt).strip()
    unit = None
    lead, rhythm = lead_or_rhythm(name)
    if lead is None and len(name) <= _LONGEST_NAME:  # "V1 (Wilson)" has no unit
        match = _BRACKETS.fullmatch(name) or _TAIL.fullmatch(name)
        known = match is not None and (
            millivolts(match["unit"]) is not None or plain_unit(match["unit"]) in _PER_SECOND
        )
        if match is not None and (known or match[0].endswith(("]", ")"))):
            name, unit = match["name"], match["unit"]
            lead, rhythm = lead_or_rhythm(name)
    return Column(spelt, name.lower().replace("_", " "), unit, lead, rhythm)


def lead_or_rhythm(name: str) -> tuple[str | None, bool]:
    """Return the lead that a name stands for, and whether as a rhythm strip."""
    if len(name) > _LONGEST_NAME:
        return None, False
    rest, found = _RHYTHM.subn("", name, count=1)
    return (lead_name(rest), True) if found else (lead_name(name), False)
