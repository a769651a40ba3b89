"""Cells of text tables as numbers."""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.recording.readers.names import first_line
from fascicle.recording.readers.table_text import BLANKS, TextTable, shown

if TYPE_CHECKING:
    import pandas as pd

FIRST_ROWS = 1000  # enough to see a lead and to know its rate before all rows are read
# \d alone would also match digits of other scripts
_NUMBER = re.compile(r"[+-]?(?=[.,]?[0-9])[0-9]*(?:(?P<mark>[.,])[0-9]*)?(?:[eE][+-]?[0-9]+)?")


def read_columns(
    table: TextTable,
    columns: Collection[int],
    rows: int | None = None,
    repeated: Collection[int] = (),
) -> pd.DataFrame:
    """Read some columns.

    Parameters
    ----------
    table : TextTable
        What `open_table` found.
    columns : collection of int
        Their places in the header, counted from zero.
    rows : int, optional
        Number of first rows to read; by default all.
    repeated : collection of int
        Columns of few texts that repeat.

    Returns
    -------
    pandas.DataFrame
        Columns named by their places.
    """
    import pandas as pd

    with table.path.open(encoding=table.encoding) as file, warnings.catch_warnings():
        # a column of numbers and texts is refused with the cell, by `numbers`
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)
        for _ in range(table.first_row):
            file.readline()
        try:
            frame = pd.read_csv(
                file,
                sep=r"\s+" if table.separator == BLANKS else table.separator,
                header=None,
                names=list(range(len(table.names))),
                usecols=sorted(columns),
                index_col=False,
                decimal=table.decimal,
                quotechar=table.quote,
                comment="#" if table.remarks_between else None,
                skipinitialspace=True,
                nrows=rows,
                # the other ways crash at 1e4000000000000001 (pandas issue 63089)
                float_precision="round_trip",
                dtype=dict.fromkeys(repeated, "category"),
            )
        except (ValueError, OverflowError) as error:  # pandas' ParserError is a ValueError
            raise InputError(
                f"{table.path}: not a readable table ({first_line(error)}); save it as "
                "comma-separated text in UTF-8 with one header line"
            ) from error
    if rows is None and len(frame) != table.rows:
        raise InputError(
            f"{table.path}: {table.rows} lines of samples, but {len(frame)} rows; remove quotation "
            "marks that do not end, and line ends within them"
        )
    return frame


def numbers(table: TextTable, column: int, cells: pd.Series) -> NDArray[np.float64]:
    """Return cells of a column as numbers, (n,); empty cells are NaN.

    Raises
    ------
    InputError
        When a cell holds anything else, or a number that is not finite.
    """
    import pandas as pd

    if not pd.api.types.is_numeric_dtype(cells) or pd.api.types.is_bool_dtype(cells):
        values = np.array([_number(str(cell), table.decimal) for cell in cells], dtype=np.float64)
    else:
        values = cells.to_numpy(dtype=np.float64)
    wrong = ~np.isfinite(values) & cells.notna().to_numpy()
    expected = "every sample must be a finite number, all with the same decimal mark"
    refuse_cells(table, table.names[column], cells, wrong, expected)
    return np.asarray(values)


def refuse_cells(
    table: TextTable, column: str, cells: pd.Series, wrong: NDArray[np.bool_], expected: str
) -> None:
    """Name the first of a column's wrong cells, (n,), if there is one, and what is expected."""
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(
            f"{table.path}: column {shown(column)} holds {shown(str(cells.iloc[first]))} in row "
            f"{table.first_row + 1 + int(cells.index[first])}; {expected}"
        )


def _number(cell: str, decimal: str) -> float:
    """Return a cell as a number; NaN where it is none."""
    match = _NUMBER.fullmatch(cell.strip())
    if match is None or match["mark"] not in (None, decimal):
        return float("nan")
    return float(match[0].replace(decimal, "."))
