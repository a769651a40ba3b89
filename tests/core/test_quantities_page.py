"""docs/quantities.md against the table in the code."""

from __future__ import annotations

from pathlib import Path

from fascicle.core.quantities import QUANTITIES, Quantity, quantity

PAGE = Path(__file__).parents[2] / "docs" / "quantities.md"


def row(known: Quantity) -> str:
    def shown(pair):
        return " to ".join(f"{value:.4g}" for value in pair)

    cells = (
        f"`{known.name}`",
        known.unit,
        "" if known.default is None else f"{known.default:.4g}",
        "" if known.whole else shown(known.searched),
        shown(known.possible),
        known.meaning,
        known.changes.value,
    )
    return f"| {' | '.join(cells)} |"


def test_page_is_the_table():
    shown = [q for name, q in QUANTITIES.items() if "_fascicle_" not in name or name[-1] == "1"]
    expected = [row(known) for known in (*shown, quantity("region_1_conductivity"))]
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("| `")] == expected
