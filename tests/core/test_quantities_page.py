"""docs/quantities.md against the table in the code."""

from __future__ import annotations

from pathlib import Path

from fascicle.core.quantities import INFINITE, QUANTITIES, Quantity, quantity
from fascicle.core.ranges import RANGES, digits

PAGE = Path(__file__).parents[2] / "docs" / "quantities.md"


def row(known: Quantity) -> str:
    def shown(pair):
        return " to ".join(map(digits, pair))

    cells = (
        f"`{known.name}`",
        known.unit,
        "" if known.default is None else f"{known.default:.4g}",
        "" if known.is_integer else shown(known.prior_range),
        shown(known.valid_range) + (", or inf" if known.name in INFINITE else ""),
        known.meaning,
        known.changes.value,
    )
    return f"| {' | '.join(cells)} |"


def test_page_is_the_table():
    shown = [q for name, q in QUANTITIES.items() if "_fascicle_" not in name or name[-1] == "1"]
    expected = [row(known) for known in (*shown, quantity("region_1_conductivity"))]
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("| `")] == expected


def test_the_other_table_is_there_too():
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    for name, known in RANGES.items():
        assert f"| {name} | {known} | {known.meaning} |" in lines
