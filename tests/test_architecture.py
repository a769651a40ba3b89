"""The pages on the layout and the equations name every package, and functions that are there."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE, EQUATIONS = (
    (REPOSITORY / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("architecture", "equations")
)
NAMES = sorted(set(re.findall(r"`((?:[a-z_0-9]+\.){1,3}[A-Za-z_]\w*)`", PAGE + EQUATIONS)))


def test_every_package_has_its_paragraph():
    packages = {p.parent.name for p in (REPOSITORY / "src" / "fascicle").glob("*/__init__.py")}
    assert packages == set(re.findall(r"^\| `([a-z]+)` \|", PAGE, re.MULTILINE))


def test_the_table_of_equations_is_not_empty():
    assert len(NAMES) > 15


@pytest.mark.parametrize("name", [n for n in NAMES if not n.endswith((".toml", ".py", ".nc"))])
def test_named_functions_exist(name: str):
    module, _, attribute = name.rpartition(".")
    assert hasattr(import_module(f"fascicle.{module}"), attribute)
