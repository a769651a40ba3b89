"""Whether a point or a comma between digits is a decimal mark or groups thousands."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from fascicle.core.errors import InputError

_SHOWN = 20  # characters of a number in a message


class Mark:
    """Evidence that a mark between digits is a decimal mark and does not group thousands."""

    def __init__(self, mark: str) -> None:
        self.mark = mark
        self.seen = ""
        self.proven = ""
        escaped = re.escape(mark)
        self._between = re.compile(rf"(?<!\d)\d*{escaped}\d+")
        # "0.125", ".5", "1234.5", "1.25", "1.2345", "1.234e-05" group no thousands
        start, stop = rf"(?<![\d{escaped}:])", rf"(?![\d{escaped}])"
        self._decimal = re.compile(
            rf"{start}(?:0?|\d{{4,}}){escaped}\d+|"
            rf"{start}\d+{escaped}(?:\d{{1,2}}|\d{{4,}}|\d+[eE][+-]?\d+){stop}"
        )

    def look(self, text: str) -> None:
        """Take the numbers of a row into account."""
        if self.proven or self.mark not in text:
            return
        if match := self._decimal.search(text):
            self.proven = match[0]
        elif not self.seen and (match := self._between.search(text)):
            self.seen = match[0]


def decimal_mark(path: Path, marks: Sequence[Mark], separator: str) -> str:
    """Return the decimal mark of a table with that separator, or refuse to guess."""
    proven = [mark for mark in marks if mark.proven]
    if len(proven) > 1:
        raise InputError(
            f"{path}: has decimal points ('{proven[0].proven[:_SHOWN]}') and decimal commas "
            f"('{proven[1].proven[:_SHOWN]}'); write all numbers with decimal points"
        )
    if proven:
        return proven[0].mark
    unclear = [mark for mark in marks if mark.seen]
    # with commas between the cells nobody groups thousands by points, nor do programs that align
    if any(mark.mark == "," or separator in ";\t" for mark in unclear):
        raise InputError(
            f"{path}: cannot tell whether '{unclear[0].seen[:_SHOWN]}' holds a decimal mark or "
            "groups thousands; write numbers with decimal points, and commas between the cells"
        )
    return "."
