"""What a heart does beside its own beat: stimuli, blocks, slow segments, delays, more trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fascicle.core.arrays import Booleans, Floats
from fascicle.core.errors import InputError
from fascicle.core.quantities import checked
from fascicle.purkinje.tree import PurkinjeTree

FURTHEST_STIMULUS = 5.0  # mm; a stimulus further from the tissue, or from its tree, is a mistake


@dataclass(frozen=True)
class Stimulus:
    """An extra stimulus: an ectopic or pacing site.

    Attributes
    ----------
    time : float
        When it fires (ms).
    position : (x, y, z)
        Where (mm).
    tree : str, optional
        The tree whose node nearest to `position` it fires; without one, the myocardium.
    """

    time: float
    position: tuple[float, float, float]
    tree: str | None = None


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

    def segments(self, tree: PurkinjeTree) -> Booleans:
        """Which segments of its tree it slows, each by the node it ends in."""
        chosen = tree.parents >= 0  # no segment ends in the root
        of_part = f" of its {self.part}" if self.part is not None else ""
        if self.part is not None:
            if self.part not in tree.parts:
                known = ", ".join(tree.parts)
                raise InputError(f"the {tree.side} tree has no part '{self.part}'; known: {known}")
            chosen &= tree.parts[self.part]
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
    orthodromic_delay, antidromic_delay : float, optional
        Delays of the junctions from tree to myocardium and back (ms), in place of the network's;
        inf blocks that direction.
    trees : tuple of (PurkinjeTree, float)
        Trees beside the heart's own, and when their roots fire (ms).
    source : str, optional
        Where it was read from, for messages.
    """

    stimuli: tuple[Stimulus, ...] = ()
    slowings: tuple[Slowing, ...] = ()
    silent: tuple[str, ...] = ()
    orthodromic_delay: float | None = None
    antidromic_delay: float | None = None
    trees: tuple[tuple[PurkinjeTree, float], ...] = ()
    source: str | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("orthodromic_delay", "antidromic_delay"):
            value = getattr(self, name)
            if value is not None:
                checked({name: value})
        for slowing in self.slowings:
            if not 0 <= slowing.speed < np.inf:
                raise InputError(
                    f"slowing of the {slowing.tree} tree: speed {slowing.speed:g} is a factor; "
                    "give 0 (block) or more"
                )
        for stimulus in self.stimuli:
            if not np.isfinite([stimulus.time, *stimulus.position]).all():
                raise InputError(
                    f"stimulus at {stimulus.position}, at {stimulus.time} ms: time and position "
                    "must be finite"
                )

    @property
    def points(self) -> Floats:
        """Positions of the stimuli in the myocardium (mm), shape (s, 3)."""
        positions = [s.position for s in self.stimuli if s.tree is None]
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
            distance = np.linalg.norm(trees[number].nodes - np.asarray(stimulus.position), axis=1)
            node = int(distance.argmin())
            if distance[node] > FURTHEST_STIMULUS:
                raise InputError(
                    f"stimulus at {stimulus.position}: the nearest node of the {stimulus.tree} "
                    f"tree is {distance[node]:.1f} mm away; give a position on it (within "
                    f"{FURTHEST_STIMULUS:g} mm)"
                )
            fired.append((number, node, stimulus.time))
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
            for name in ("orthodromic_delay", "antidromic_delay")
        }

    def root_times(self, trees: Sequence[PurkinjeTree], root_times: Sequence[float]) -> list[float]:
        """When each root fires (ms), inf where it is silent."""
        names = [tree.side for tree in trees]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two trees are named '{name}'; give each a name of its own")
        times = [*root_times, *(time for _, time in self.trees)]
        for side in self.silent:
            times[tree_number(trees, side)] = np.inf
        return times


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
