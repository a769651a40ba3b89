"""Blocks of the conduction states, in any scenario."""

from __future__ import annotations

from dataclasses import replace

from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.forward.primitives import His, SlowConduction
from fascicle.forward.scenario import Primitive, Scenario


def in_state(scenario: Scenario, conduction: float) -> Scenario:
    """Add the blocks of a conduction state, a value of ``conduction``, to a scenario.

    A bundle branch is not blocked if the scenario has a His bundle with a root time of its own:
    pacing that recruits both branches.
    """
    blocked = [*CONDUCTION_STATES.values()][int(conduction)].blocked
    if not blocked:
        return scenario
    his = scenario.of(His)
    left, right = (float(f"{side} bundle branch" not in blocked) for side in ("left", "right"))
    if left * right == 0.0 and not his:
        his = [His(left=left, right=right)]
    elif left * right == 0.0 and his[0].root_time is None:
        his = [replace(his[0], left=his[0].left * left, right=his[0].right * right)]
    fascicles: list[Primitive] = [
        SlowConduction(tree="lv", part=part.removeprefix("left "), speed=0.0)
        for part in blocked
        if part.endswith("fascicle")
    ]
    others = (primitive for primitive in scenario.primitives if not isinstance(primitive, His))
    return replace(scenario, primitives=(*his, *fascicles, *others))
