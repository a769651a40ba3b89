"""What a heart does beside its intrinsic beat: stimuli, blocks, slow segments, delays, more trees.

With a His bundle the roots are joined above the trees: pacing one of them climbs to the bundle and
comes down the other branch, and a front that enters a tree from the tissue returns by the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import NoneType

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.quantities import SIDES, check, checked, default_of, quantity
from fascicle.core.ranges import check_items, check_kind, check_position, check_text, shown, within
from fascicle.forward.eikonal.activation import HisBundle
from fascicle.heart.sites import Sites
from fascicle.purkinje.tree import PurkinjeTree

FURTHEST_STIMULUS = 5.0  # mm; a stimulus further from the tissue, or from its tree, is a mistake
MOST_STIMULI = 1000  # of a scenario; rays from each to every vertex take their time


@dataclass(frozen=True)
class Stimulus:
    """An extra stimulus: an ectopic or pacing site.

    Attributes
    ----------
    time : float
        When it fires (ms).
    position : (x, y, z), optional
        Where (mm).
    tree : str, optional
        The tree whose node nearest to `position` it fires; without one, the myocardium.
    site : str, optional
        Where, by a name of `fascicle.heart.sites.Sites`, instead of by a position.
    radius : float
        What lies this near (mm) is fired, too: vertices of the myocardium, or nodes of the tree.
    part : str, optional
        Of the tree, if only nodes of its ``"bundle"``, ``"fascicle 1"``, … can be fired; branches
        may lie nearer.
    around : int, optional
        Of tissue that another stimulus captures, that one's number among those of the tissue;
        `Scenario.located` sets it.
    """

    time: float
    position: tuple[float, float, float] | None = None
    tree: str | None = None
    site: str | None = None
    radius: float = 0.0
    part: str | None = None
    around: int | None = None

    def __post_init__(self) -> None:
        if (self.position is None) == (self.site is None):
            raise InputError(
                f"stimulus at {self.time} ms: give either a position or a site, not "
                f"{'none' if self.site is None else 'both'}"
            )
        within("time", self.time, "stimulus: its time")
        if self.position is not None:
            check_position(self.position, f"stimulus at {self.time:g} ms: its position")
        for name in ("tree", "site", "part"):
            if getattr(self, name) is not None:
                check_text(getattr(self, name), f"stimulus at {self.time:g} ms: its {name}")
        if self.part is not None and self.tree is None:
            raise InputError(f"stimulus at {self.time} ms: its part '{self.part}' is of no tree")
        within("capture radius", self.radius, f"stimulus at {self.time:g} ms: its radius")

    @property
    def place(self) -> tuple[float, float, float]:
        """Its position (mm); that of a site only after `Scenario.located`."""
        if self.position is None:
            raise ValueError(f"where '{self.site}' is, has not been looked up")
        return self.position


@dataclass(frozen=True)
class Slowing:
    """Segments of a tree that conduct slowly or not at all.

    Attributes
    ----------
    tree : str
        ``"lv"``, ``"rv"``, or the name of a tree of your own.
    speed : float
        Factor on the speed in the tree; 0 blocks it.
    part : str, optional
        ``"bundle"`` or ``"fascicle 1"``, ``"fascicle 2"``, …; without part or sphere, all of it.
    centre : (x, y, z), optional
        Centre of a sphere (mm): the segments that end in it.
    radius : float, optional
        Its radius (mm).
    """

    tree: str
    speed: float
    part: str | None = None
    centre: tuple[float, float, float] | None = None
    radius: float | None = None

    def __post_init__(self) -> None:
        check_text(self.tree, "slowing: its tree")
        where = f"slowing of the {self.tree} tree"
        within("speed factor", self.speed, f"{where}: speed, a factor,")
        if self.part is not None:
            check_text(self.part, f"{where}: its part")
        if self.centre is not None:
            check_position(self.centre, f"{where}: its centre")
        if self.radius is not None:
            within("radius", self.radius, f"{where}: its radius")

    def segments(self, tree: PurkinjeTree) -> Booleans:
        """Which segments of its tree it slows, each by the node it ends in."""
        chosen = tree.parents >= 0  # no segment ends in the root
        of_part = f" of its {self.part}" if self.part is not None else ""
        if self.part is not None:
            chosen &= part_of(tree, self.part)
            if not chosen.any():
                raise InputError(
                    f"slowing of the {tree.side} tree: its {self.part} has no segment; the tree "
                    "forks at its root"
                )
        if (self.centre is None) != (self.radius is None):
            raise InputError(f"slowing of the {tree.side} tree: a sphere needs centre and radius")
        if self.centre is not None and self.radius is not None:
            distance = np.linalg.norm(tree.nodes - np.asarray(self.centre), axis=1)
            nearest = distance[chosen].min(initial=np.inf)
            chosen &= distance <= self.radius
            if not chosen.any():
                raise InputError(
                    f"slowing of the {tree.side} tree: no segment{of_part} ends in the sphere at "
                    f"{self.centre}; the nearest ends {nearest:.1f} mm from its centre"
                )
        return chosen


@dataclass(frozen=True)
class His:
    """A His bundle, whose branches join the roots of the heart's two trees and conduct both ways.

    The branch to the root that fires first takes the network's ``his_time``, the other one longer
    by the root time; so the intrinsic beat is the same with it as without.

    Attributes
    ----------
    time : float, optional
        When it fires (ms), inf if it does not; if not given, so that the first root fires at 0.
    root_time : float, optional
        t_RV − t_LV (ms), in place of the network's: 0 makes branches of equal times.
    left, right : float
        Factors on the speeds of its branches; 0 blocks both directions.
    """

    time: float | None = None
    root_time: float | None = None
    left: float = 1.0
    right: float = 1.0

    def __post_init__(self) -> None:
        if self.time is not None:
            within("firing time", self.time, "His bundle: its time")
        if self.root_time is not None:
            check(quantity("root_time"), self.root_time)
        for side in ("left", "right"):
            what = f"His bundle: {side}, a factor on the speed of that branch,"
            within("speed factor", getattr(self, side), what)

    def conducted(self, roots: Sequence[float], nearest: float) -> tuple[list[float], HisBundle]:
        """When it fires the left and the right root (ms), and what joins them.

        Parameters
        ----------
        roots : sequence of float
            When the left and the right root fire without it (ms).
        nearest : float
            From it to the root that fires first (ms).
        """
        fires = min(roots) - nearest if self.time is None else self.time
        down, branches = [], []
        for time, factor in zip(roots, (self.left, self.right), strict=True):
            usual = nearest + time - min(roots)
            takes = usual / factor if factor > 0 else np.inf
            # not fires + takes, which differs from the root's own time in the last digit
            own = time + (takes - usual)
            down.append(own if self.time is None else self.time + takes)
            branches.append(takes)
        return down, HisBundle(fires, branches)


@dataclass(frozen=True)
class Scenario:
    """A case to simulate on top of trees, root time and speed.

    Attributes
    ----------
    stimuli : tuple of Stimulus
        Extra stimuli.
    slowings : tuple of Slowing
        Slow or blocked segments; where they overlap the factors multiply.
    silent : tuple of str
        Trees whose root does not fire.
    anterograde_delay, retrograde_delay : float, optional
        Delays of the junctions from tree to myocardium and back (ms), in place of the network's;
        inf blocks that direction.
    trees : tuple of (PurkinjeTree, float)
        Trees beside the heart's own, and when their roots fire (ms).
    his : His, optional
        What joins the roots of the heart's own trees; without it a front that climbs to a root
        ends there.
    source : str, optional
        Where it was read from, for messages.
    description, reference : str
        What it is, and after whom, in a line; may be empty.
    """

    stimuli: tuple[Stimulus, ...] = ()
    slowings: tuple[Slowing, ...] = ()
    silent: tuple[str, ...] = ()
    anterograde_delay: float | None = None
    retrograde_delay: float | None = None
    trees: tuple[tuple[PurkinjeTree, float], ...] = ()
    his: His | None = None
    source: str | None = field(default=None, repr=False, compare=False)
    description: str = field(default="", repr=False, compare=False)
    reference: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        check_items(self.stimuli, Stimulus, "stimuli", "fascicle.Stimulus")
        check_items(self.slowings, Slowing, "slowings", "fascicle.Slowing")
        check_kind(self.silent, (list, tuple), "silent", "a list of names of trees")
        check_items(self.trees, tuple, "trees", "pairs (fascicle.PurkinjeTree, time)")
        for pair in self.trees:
            if len(pair) != 2 or not isinstance(pair[0], PurkinjeTree):
                raise InputError(f"trees: {shown(pair)} was given; give (PurkinjeTree, time)")
            within("time", pair[1], f"time of the tree '{pair[0].side}'")
        check_kind(self.his, (His, NoneType), "his", "a fascicle.His")
        for name in ("source", "description", "reference"):
            check_kind(getattr(self, name), (str, NoneType), f"{name} of a scenario", "a text")
        for name in ("anterograde_delay", "retrograde_delay"):
            value = getattr(self, name)
            if value is not None:
                checked({name: value})
        given = sum(stimulus.around is None for stimulus in self.stimuli)
        if given > MOST_STIMULI:
            raise InputError(f"{given} stimuli; give {MOST_STIMULI} at most")
        for name in self.silent:
            check_text(name, "a silent tree")

    def located(self, sites: Sites) -> Scenario:
        """The same with positions for the names of sites; then comes all that they capture.

        Raises
        ------
        InputError
            If there is no site of a name.
        """
        if not any(s.site is not None or s.radius > 0 for s in self.stimuli):
            return self
        found: list[Stimulus] = []
        captured: list[Stimulus] = []
        number, vertices = -1, sites.heart.vertices
        for stimulus in self.stimuli:
            place = stimulus.position
            if stimulus.site is not None:
                place = sites.position(stimulus.site)
            found.append(replace(stimulus, position=place, site=None))
            number += stimulus.tree is None
            if stimulus.tree is None and stimulus.radius > 0:
                near = np.linalg.norm(vertices - np.asarray(place), axis=1) <= stimulus.radius
                captured += [
                    Stimulus(stimulus.time, (x, y, z), around=number)
                    for x, y, z in vertices[near].tolist()
                ]
        return replace(self, stimuli=(*found, *captured))

    @property
    def owners(self) -> Integers:
        """The stimulus of the tissue, by its number, that each of the `points` belongs to."""
        of_tissue = [s for s in self.stimuli if s.tree is None]
        return np.array(
            [k if s.around is None else s.around for k, s in enumerate(of_tissue)], dtype=np.int64
        )

    @property
    def first_stimulus(self) -> float | None:
        """When the first stimulus is given, or the His bundle paced (ms); None if nothing is."""
        times = [stimulus.time for stimulus in self.stimuli]
        if self.his is not None and self.his.time is not None and np.isfinite(self.his.time):
            times.append(self.his.time)
        return min(times) if times else None

    @property
    def blocks(self) -> set[str]:
        """What it blocks, in words."""
        his = self.his or His()
        branches = {side for side in ("left", "right") if getattr(his, side) == 0}
        blocked = [slowing for slowing in self.slowings if slowing.speed == 0]
        return {f"the {side} bundle branch" for side in branches} | {
            f"{s.tree.upper()} {s.part or ('tree' if s.centre is None else f'tree at {s.centre}')}"
            for s in blocked
        }

    @property
    def points(self) -> Floats:
        """Positions of the stimuli in the myocardium (mm), shape (s, 3)."""
        positions = [s.place for s in self.stimuli if s.tree is None]
        return np.array(positions, dtype=float).reshape(-1, 3)

    @property
    def times(self) -> list[float]:
        """When they fire (ms)."""
        return [s.time for s in self.stimuli if s.tree is None]

    def check_stimuli(self, distances: Floats) -> None:
        """Refuse stimuli that are not in the myocardium, given how far they are from it (mm)."""
        for position, distance in zip(self.points, distances, strict=True):
            if distance > FURTHEST_STIMULUS:
                where = ", ".join(f"{x:g}" for x in position)
                raise InputError(
                    f"stimulus at ({where}): {distance:.1f} mm from the tissue; give a position in "
                    "it, in mm and in the heart's frame"
                )

    def node_times(self, trees: Sequence[PurkinjeTree]) -> list[tuple[int, int, float]]:
        """Stimuli in the trees as (tree, node, time)."""
        fired = []
        for stimulus in self.stimuli:
            if stimulus.tree is None:
                continue
            number = tree_number(trees, stimulus.tree)
            distance = np.linalg.norm(trees[number].nodes - np.asarray(stimulus.place), axis=1)
            if stimulus.part is not None:
                distance[~part_of(trees[number], stimulus.part)] = np.inf
            nearest = int(distance.argmin())
            if distance[nearest] > FURTHEST_STIMULUS:
                raise InputError(
                    f"stimulus at {stimulus.place}: the nearest node of the {stimulus.tree} "
                    f"tree is {distance[nearest]:.1f} mm away; give a position on it (within "
                    f"{FURTHEST_STIMULUS:g} mm)"
                )
            captured = {nearest, *np.flatnonzero(distance <= stimulus.radius).tolist()}
            fired += [(number, node, stimulus.time) for node in sorted(captured)]
        return fired

    def speeds(self, trees: Sequence[PurkinjeTree]) -> Floats:
        """Factor on the speed of every segment, tree by tree, each by the node it ends in."""
        factors = [np.ones(len(tree.nodes)) for tree in trees]
        for slowing in self.slowings:
            number = tree_number(trees, slowing.tree)
            factors[number][slowing.segments(trees[number])] *= slowing.speed
        return np.concatenate([*factors, np.empty(0)])

    def delays(self, values: Mapping[str, float]) -> dict[str, float]:
        """Delays of the junctions (ms): its own, or those among the quantities of a network."""
        return {
            name: own if (own := getattr(self, name)) is not None else values.get(name, 0.0)
            for name in ("anterograde_delay", "retrograde_delay")
        }

    def firing(
        self,
        trees: Sequence[PurkinjeTree],
        root_time: float | Sequence[float],
        values: Mapping[str, float],
    ) -> tuple[list[float], HisBundle | None]:
        """When each root fires (ms), inf where it is silent, and the His bundle if there is one.

        Parameters
        ----------
        trees : sequence of PurkinjeTree
            The heart's own, and those of the scenario.
        root_time : float or sequence of float
            Of the network: t_RV − t_LV, or when each of its roots fires (ms).
        values : mapping of name to float
            Quantities of the network, ``his_time`` perhaps among them.
        """
        names = [tree.side for tree in trees]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two trees are named '{name}'; give each a name of its own")
        his, roots = None, root_times(root_time)
        own_trees = len(trees) - len(self.trees)
        if len(roots) != own_trees:
            raise InputError(f"{len(roots)} root times for {own_trees} trees; give one a tree")
        if self.his is not None:
            self._check_joined(names)
            own = roots if self.his.root_time is None else root_times(self.his.root_time)
            roots, his = self.his.conducted(own, values.get("his_time", default_of("his_time")))
            his = replace(his, branches=[*his.branches, *(np.inf for _ in self.trees)])
        times = [*roots, *(time for _, time in self.trees)]
        for side in self.silent:
            times[tree_number(trees, side)] = np.inf
        return times, his

    def _check_joined(self, names: Sequence[str]) -> None:
        """Refuse a His bundle that has not two roots to fire."""
        if tuple(names[:2]) != SIDES:
            raise InputError(
                f"His bundle: it joins the trees {' and '.join(SIDES)}; known: {', '.join(names)}"
            )
        for side, branch in zip(SIDES, ("left", "right"), strict=True):
            if side in self.silent:
                raise InputError(
                    f"silent tree '{side}': its root hangs on the His bundle; block that branch "
                    f"({branch} = 0), or let the bundle not fire (time = inf)"
                )


def part_of(tree: PurkinjeTree, name: str) -> Booleans:
    """Which nodes end a segment of a part of a tree.

    Raises
    ------
    InputError
        If it has none of this name.
    """
    if name not in tree.parts:
        known = ", ".join(tree.parts)
        raise InputError(f"the {tree.side} tree has no part '{name}'; known: {known}")
    return tree.parts[name]


def tree_number(trees: Sequence[PurkinjeTree], side: str) -> int:
    """Which of the trees has this name.

    Raises
    ------
    InputError
        If none has.
    """
    names = [tree.side for tree in trees]
    if side not in names:
        raise InputError(f"there is no tree '{side}'; known: {', '.join(names)}")
    return names.index(side)


def root_times(root_time: float | Sequence[float]) -> Sequence[float]:
    """When the roots fire (ms): the left and the right one, the earlier at 0, or as given."""
    known = quantity("root_time")
    if isinstance(root_time, list | tuple | np.ndarray):
        return [check(known, time) for time in root_time]
    delay = check(known, root_time)
    return max(0.0, -delay), max(0.0, delay)
