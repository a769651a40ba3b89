"""Primitives of scenarios: stimuli, slow conduction, inactive roots, delays, the His bundle.

A His bundle joins the roots of the two trees by its branches. Pacing of one root then activates the
bundle retrogradely and the other root anterogradely, and so does a front that enters a tree from
the myocardium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, cast

import numpy as np
from pydantic import BeforeValidator

from fascicle.core.conduction_states import CONDUCTION_STATES
from fascicle.core.declared import (
    CaptureRadius,
    Delay,
    FiringTime,
    Name,
    Point,
    Radius,
    SpeedFactor,
    Time,
)
from fascicle.core.errors import InputError
from fascicle.core.quantities import SIDES, default_of
from fascicle.core.ranges import check_text
from fascicle.forward.eikonal.activation import HisBundle
from fascicle.forward.scenario import Excitation, Primitive, Scenario, root_times
from fascicle.heart.sites import CoordinateSite


def _site(value: Any) -> str | CoordinateSite:
    """Check a site: a name, or ventricular coordinates, which may be given as a mapping."""
    if isinstance(value, Mapping):
        return CoordinateSite.of(value)
    if not isinstance(value, CoordinateSite):
        check_text(value, "'site'")
    return cast("str | CoordinateSite", value)


Site = Annotated[str | CoordinateSite, BeforeValidator(_site)]
FURTHEST_STIMULUS = 5.0  # mm from the tissue or the tree; beyond it a position is an error


class Stimulus(Primitive, table="stimulus"):
    """A pacing or ectopic site: in the myocardium, or in a tree its node nearest to the site."""

    time: Annotated[Time, "when it fires"]
    position: Annotated[Point | None, "where, within 5 mm of the tissue or the tree"] = None
    tree: Annotated[Name | None, "the tree whose node it fires; without, the myocardium"] = None
    site: Annotated[
        Site | None, "where, by name or ventricular coordinates, in place of a position"
    ] = None
    radius: Annotated[CaptureRadius, "what lies within it is captured, too"] = 0.0
    part: Annotated[Name | None, "stimulated part of the tree, as in `slow_conduction`"] = None

    def __post_init__(self) -> None:
        if (self.position is None) == (self.site is None):
            count = "none" if self.site is None else "both"
            raise InputError(f"give either a position or a site, not {count}")
        if self.part is not None and self.tree is None:
            raise InputError(f"part '{self.part}' is given without its tree")

    @property
    def stimulus_time(self) -> float:
        """Time of the stimulus (ms)."""
        return self.time

    def apply(self, excitation: Excitation) -> None:
        """Stimulate the myocardium, or the captured nodes of the tree."""
        place = self.position
        if place is None:
            assert self.site is not None
            place = excitation.sites.position(self.site)
        if self.tree is None:
            excitation.stimulate(place, self.time, self.radius)
            return
        tree = excitation.tree(self.tree)
        distance = np.linalg.norm(excitation.trees[tree].nodes - np.asarray(place), axis=1)
        if self.part is not None:
            distance[~excitation.part(tree, self.part)] = np.inf
        nearest = int(distance.argmin())
        if distance[nearest] > FURTHEST_STIMULUS:
            raise InputError(
                f"stimulus at {place}: the nearest node of the {self.tree} tree is "
                f"{distance[nearest]:.1f} mm away; give a position on it (within "
                f"{FURTHEST_STIMULUS:g} mm)"
            )
        captured = {nearest, *np.flatnonzero(distance <= self.radius).tolist()}
        excitation.node_times += [(tree, node, self.time) for node in sorted(captured)]


class SlowConduction(Primitive, table="slow_conduction"):
    """Segments of a tree that conduct slowly or not at all; overlapping factors multiply."""

    tree: Annotated[Name, '`"lv"`, `"rv"`, or the name of an additional tree']
    speed: Annotated[SpeedFactor, "factor on the speed; 0 blocks both directions"]
    part: Annotated[
        Name | None,
        '`"bundle"`, `"fascicle 1"`, …, `"anterior fascicle"`, `"posterior fascicle"`; without it '
        "the whole tree",
    ] = None
    centre: Annotated[Point | None, "centre of a sphere: only segments that end in it"] = None
    radius: Annotated[Radius | None, "its radius"] = None

    def __post_init__(self) -> None:
        if (self.centre is None) != (self.radius is None):
            raise InputError("a sphere needs centre and radius")

    @property
    def blocked(self) -> set[str]:
        """Name of the blocked part."""
        tree_name = "tree" if self.centre is None else f"tree at {self.centre}"
        return {f"{self.tree.upper()} {self.part or tree_name}"} if self.speed == 0 else set()

    def apply(self, excitation: Excitation) -> None:
        """Multiply the conduction velocity of the segments by the factor."""
        number = excitation.tree(self.tree)
        tree = excitation.trees[number]
        chosen = tree.parents >= 0  # a segment belongs to the node at its end, the root has none
        if self.part is not None:
            chosen &= excitation.part(number, self.part)
        if not chosen.any():
            raise InputError(
                f"slow conduction in the {tree.side} tree: its {self.part} has no segment; the "
                "tree forks at its root"
            )
        if self.centre is not None:
            distance = np.linalg.norm(tree.nodes - np.asarray(self.centre), axis=1)
            nearest = distance[chosen].min()
            chosen &= distance <= self.radius
            if not chosen.any():
                of_part = f" of its {self.part}" if self.part is not None else ""
                raise InputError(
                    f"slow conduction in the {tree.side} tree: no segment{of_part} ends in the "
                    f"sphere at {self.centre}; the nearest ends {nearest:.1f} mm from its centre"
                )
        excitation.slow(number, chosen, self.speed)


class InactiveRoot(Primitive, table="inactive_root"):
    """A tree whose root does not fire."""

    tree: Annotated[Name, '`"lv"`, `"rv"`, or the name of an additional tree']

    def apply(self, excitation: Excitation) -> None:
        """Keep the root from firing."""
        excitation.inactive.add(excitation.tree(self.tree))


class JunctionDelays(Primitive, table="delay", once=True):
    """Delays of all junctions, in place of the network's; inf blocks that direction."""

    anterograde: Annotated[Delay | None, "from tree to myocardium"] = None
    retrograde: Annotated[Delay | None, "from myocardium to tree"] = None

    def apply(self, excitation: Excitation) -> None:
        """Replace the network's delays."""
        for direction in self.key_names():
            if getattr(self, direction) is not None:
                excitation.delays[f"{direction}_delay"] = getattr(self, direction)


class His(Primitive, table="his", once=True):
    """A His bundle, whose branches join the roots of the heart's two trees and conduct both ways.

    Conduction from the bundle to the root that fires first takes the network's ``his_time``; to the
    other root it takes longer, by the delay between the roots. So a His bundle does not change the
    intrinsic beat.
    """

    time: Annotated[
        FiringTime | None, "when it fires, inf: not at all; without, so that the first root is at 0"
    ] = None
    root_time: Annotated[Time | None, "t_RV − t_LV in place of the network's (ms)"] = None
    left: Annotated[SpeedFactor, "factor on the speed of its left branch; 0 blocks it"] = 1.0
    right: Annotated[SpeedFactor, "the same of its right branch"] = 1.0

    @property
    def stimulus_time(self) -> float | None:
        """Time at which the bundle is paced (ms); None if it is not."""
        return self.time if self.time is not None and np.isfinite(self.time) else None

    @property
    def blocked(self) -> set[str]:
        """Names of the blocked bundle branches."""
        factors = {"left": self.left, "right": self.right}
        return {f"the {side} bundle branch" for side, factor in factors.items() if factor == 0}

    def apply(self, excitation: Excitation) -> None:
        """Join the roots of the heart's two trees by the bundle."""
        names = [tree.side for tree in excitation.trees]
        if tuple(names[:2]) != SIDES:
            raise InputError(
                f"His bundle: it joins the trees {' and '.join(SIDES)}; known: {', '.join(names)}"
            )
        firing = excitation.roots[:2] if self.root_time is None else root_times(self.root_time)
        his_time = excitation.values.get("his_time", default_of("his_time"))
        excitation.roots[:2], his = self.conducted(firing, his_time)
        unjoined = [np.inf] * (len(excitation.trees) - 2)
        excitation.his = replace(his, branches=[*his.branches, *unjoined])

    def conducted(self, roots: Sequence[float], nearest: float) -> tuple[list[float], HisBundle]:
        """Activation times (ms) of the left and the right root, and the bundle that joins them.

        `roots` are the firing times (ms) of the roots without the bundle, `nearest` is the travel
        time (ms) from the bundle to the root that fires first.
        """
        fires = min(roots) - nearest if self.time is None else self.time
        arrivals, branches = [], []
        for time, factor in zip(roots, (self.left, self.right), strict=True):
            unslowed = nearest + time - min(roots)
            travel_time = unslowed / factor if factor > 0 else np.inf
            # equal to `time` if the branch is not slowed, which `fires` + travel time is not quite
            activated = time + (travel_time - unslowed)
            arrivals.append(activated if self.time is None else self.time + travel_time)
            branches.append(travel_time)
        return arrivals, HisBundle(fires, branches)


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
