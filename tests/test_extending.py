"""Each example of docs/extending.md runs as it stands, in fewer than 40 lines."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fascicle.forward.scenario import PRIMITIVES

PAGE = Path(__file__).parents[1] / "docs" / "extending.md"
SECTIONS = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
CODE = {
    section.partition("\n")[0]: "\n".join(re.findall(r"```python\n(.*?)```", section, re.DOTALL))
    for section in SECTIONS
}


def example(section: str) -> dict[str, object]:
    """The names that the example of a section leaves."""
    names: dict[str, object] = {"__name__": "example"}
    exec(compile(CODE[section], f"{PAGE}, {section}", "exec", dont_inherit=True), names)
    return names


@pytest.mark.parametrize("section", CODE)
def test_under_forty_lines(section):
    assert 5 < CODE[section].count("\n") < 40


def test_scenario_primitive(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    duration = example("Scenario primitive")["duration"]
    del PRIMITIVES["distal_disease"]
    assert duration["intrinsic"] + 5 < duration["distal"] < 300
