"""Blocks of the conduction states, in any scenario."""

from __future__ import annotations

from dataclasses import replace

from fascicle.core.quantities import CONDUCTION
from fascicle.forward.primitives import His, SlowConduction
from fascicle.forward.scenario import Primitive, Scenario

ANTERIOR, POSTERIOR = (
    SlowConduction(tree="lv", part=f"{which} fascicle", speed=0.0)
    for which in ("anterior", "posterior")
)
BLOCKED: dict[str, tuple[Primitive, ...]] = {
    "left bundle branch block": (His(left=0.0),),
    "left anterior fascicular block": (ANTERIOR,),
    "left posterior fascicular block": (POSTERIOR,),
    "right bundle branch block": (His(right=0.0),),
    "right bundle branch and left anterior fascicular block": (His(right=0.0), ANTERIOR),
}


def in_state(scenario: Scenario, conduction: float) -> Scenario:
    """Add the blocks of a conduction state, a number of `CONDUCTION`, to a scenario.

    A bundle branch is not blocked if the scenario has a His bundle with a root time of its own:
    pacing that recruits both branches.
    """
    blocked = BLOCKED.get(CONDUCTION[int(conduction)], ())
    if not blocked:
        return scenario
    state_his = [primitive for primitive in blocked if isinstance(primitive, His)]
    scenario_his = scenario.of(His)
    if state_his and scenario_his:
        (block,), (his,) = state_his, scenario_his
        if his.root_time is None:
            his = replace(his, left=his.left * block.left, right=his.right * block.right)
        state_his = [his]
    rest = (p for p in (*blocked, *scenario.primitives) if not isinstance(p, His))
    return replace(scenario, primitives=(*(state_his or scenario_his), *rest))
