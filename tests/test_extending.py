"""Each example of docs/extending.md runs as it stands, in fewer than 40 lines."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from fascicle.core.conduction_states import CONDUCTION_STATES, told_apart
from fascicle.core.errors import InputError
from fascicle.core.quantities import QUANTITIES, declare_state
from fascicle.forward.scenario import PRIMITIVES
from fascicle.networks.prior import Prior

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


def test_conduction_state():
    before = dict(CONDUCTION_STATES), QUANTITIES["conduction"]
    try:
        names = example("Conduction state")
        state = CONDUCTION_STATES["bifascicular block with a slow Purkinje network"]
        duration = names["duration"]
        assert duration[state.name] > duration["normal"] + 10
        assert state in told_apart()
        assert state.number == len(before[0])
        heart = names["model"].heart
        prior = Prior.of("posterior", {}, heart)
        (asked,) = prior.possible_states(state.name, heart)
        speed = next(p for p in prior.narrowed(asked).space.parameters if p.name == "cv")
        assert (speed.lower, speed.upper) == (1.0, 2.0)
        assert len(prior.possible_states({"normal": 0.9, state.name: 0.1}, heart)) == 2
        for wrong, message in (
            (replace(state), "is taken"),
            (replace(state, name="other", blocked=("left bundle",)), "'left bundle' cannot be"),
            (replace(state, name="other", ranges={"speed": (1, 2)}), "unknown parameter 'speed'"),
        ):
            with pytest.raises(InputError, match=message):
                declare_state(wrong)
    finally:
        CONDUCTION_STATES.clear()
        CONDUCTION_STATES.update(before[0])
        QUANTITIES["conduction"] = before[1]


def test_scenario_primitive(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    duration = example("Scenario primitive")["duration"]
    del PRIMITIVES["distal_disease"]
    assert duration["intrinsic"] + 5 < duration["distal"] < 300
