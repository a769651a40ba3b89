"""Scenario: pacing, blocks, slow conduction and delays imposed on a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import NoneType
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.declared import Table
from fascicle.core.errors import InputError
from fascicle.core.quantities import SIDES, check, quantity
from fascicle.core.ranges import check_items, check_kind, shown, within
from fascicle.forward.eikonal.activation import HisBundle
from fascicle.heart.sites import Sites
from fascicle.purkinje.tree import PurkinjeTree

Kind = TypeVar("Kind", bound="Primitive")
Position = tuple[float, float, float]


class Primitive(Table, table=""):
    """Element of a scenario: a subclass is a table of scenario files and changes a beat.

    The fields of the subclass are the keys of the table (`fascicle.core.declared.Table`), and
    `apply` changes the excitation by them. `fascicle.forward.primitives` has those of the package.
    """

    def __init_subclass__(cls, table: str, once: bool = False) -> None:
        super().__init_subclass__(table, once)
        PRIMITIVES[table] = cls

    def apply(self, excitation: Excitation) -> None:
        """Change an excitation, in place, before it is solved."""
        raise NotImplementedError

    @property
    def stimulus_time(self) -> float | None:
        """Time of its stimulus (ms); None if it has none."""
        return None

    @property
    def blocked(self) -> set[str]:
        """Names of the parts of the trees that it blocks."""
        return set()


PRIMITIVES: dict[str, type[Primitive]] = {}
"""Primitives, by the names of their tables."""


@dataclass
class Excitation:
    """Excitation of a network, before it is solved: what fires when, and how the trees conduct.

    The primitives of a scenario change it.

    Attributes
    ----------
    trees : tuple of PurkinjeTree
        The heart's own, left first, and those of the scenario.
    roots : list of float
        Firing time of each root (ms).
    sites : Sites
        The heart, and its sites by name.
    values : mapping of name to float
        Quantities of the network.
    delays : dict of name to float
        ``anterograde_delay`` and ``retrograde_delay`` of the junctions (ms).
    his : HisBundle, optional
        Bundle that joins the roots of the heart's own trees; without it a retrograde front ends at
        the root.
    inactive : set of int
        Trees whose root does not fire.
    node_times : list of (tree, node, time)
        Stimuli in the trees (ms).
    """

    trees: tuple[PurkinjeTree, ...]
    roots: list[float]
    sites: Sites
    values: Mapping[str, float]
    delays: dict[str, float]
    his: HisBundle | None = None
    inactive: set[int] = field(default_factory=set)
    node_times: list[tuple[int, int, float]] = field(default_factory=list)
    _stimuli: list[tuple[Position, float]] = field(default_factory=list)
    _captured: list[tuple[Position, float, int]] = field(default_factory=list)
    _speed: list[Floats] = field(default_factory=list)

    def tree(self, name: str) -> int:
        """Number of the tree of this name; InputError if there is none."""
        names = [tree.side for tree in self.trees]
        if name not in names:
            raise InputError(f"there is no tree '{name}'; known: {', '.join(names)}")
        return names.index(name)

    def part(self, tree: int, name: str) -> Booleans:
        """Whether a segment of a part of a tree, such as ``"bundle"``, ends at a node (n_nodes,).

        Of several fascicles the anterior and the posterior one are those whose ends lie furthest
        in these directions. InputError if the tree has no such part.
        """
        grown = self.trees[tree]
        parts = {**grown.parts}
        fascicles = [mask for name, mask in parts.items() if name.startswith("fascicle")]
        if len(fascicles) > 1:
            anterior = grown.nodes @ self.sites.anterior  # coordinates (mm)
            tips = [np.setdiff1d(np.flatnonzero(mask), grown.parents[mask]) for mask in fascicles]
            ends = [anterior[nodes[-1]] for nodes in tips]
            parts["anterior fascicle"] = fascicles[int(np.argmax(ends))]
            parts["posterior fascicle"] = fascicles[int(np.argmin(ends))]
        if name not in parts:
            raise InputError(
                f"the {grown.side} tree has no part '{name}'; known: {', '.join(parts)}"
            )
        return parts[name]

    def stimulate(self, position: Position, time: float, radius: float = 0.0) -> None:
        """Stimulate the myocardium at a position, and every vertex within the capture radius."""
        self._stimuli.append((position, time))
        if radius > 0:
            vertices = self.sites.heart.vertices
            near = vertices[np.linalg.norm(vertices - np.asarray(position), axis=1) <= radius]
            group = len(self._stimuli) - 1
            self._captured += [((x, y, z), time, group) for x, y, z in near.tolist()]

    def slow(self, tree: int, nodes: Booleans, factor: float) -> None:
        """Multiply the velocity of the segments that end in nodes of a tree; 0 blocks them."""
        if not self._speed:
            self._speed = [np.ones(len(grown.nodes)) for grown in self.trees]
        self._speed[tree][nodes] *= factor

    @property
    def stimuli(self) -> int:
        """Number of stimuli of the myocardium."""
        return len(self._stimuli)

    @property
    def points(self) -> Floats:
        """Stimulated points of the myocardium (mm): stimuli, then the vertices they capture."""
        points = [point for point, *_ in (*self._stimuli, *self._captured)]
        return np.array(points, dtype=float).reshape(-1, 3)

    @property
    def point_times(self) -> list[float]:
        """Time at which each of the `points` is stimulated (ms)."""
        captured = (time for _, time, _ in self._captured)
        return [*(time for _, time in self._stimuli), *captured]

    @property
    def capture_groups(self) -> Integers:
        """Number of the stimulus that each of the `points` belongs to."""
        groups = [*range(self.stimuli), *(group for *_, group in self._captured)]
        return np.array(groups, dtype=np.int64)

    @property
    def speed(self) -> ArrayLike:
        """Factor on the velocity of each segment, by the node it ends in, tree after tree."""
        return np.concatenate(self._speed) if self._speed else 1.0

    @property
    def root_times(self) -> list[float]:
        """Firing time of each root (ms); inf where it is inactive."""
        for k in range(len(SIDES)):  # the trees that a bundle joins come first
            if self.his is not None and k in self.inactive:
                raise InputError(
                    f"inactive root '{self.trees[k].side}': it hangs on the His bundle; block that "
                    "branch (left or right = 0), or let the bundle not fire (time = inf)"
                )
        return [np.inf if k in self.inactive else time for k, time in enumerate(self.roots)]


@dataclass(frozen=True)
class Scenario:
    """Pacing, blocks, slow conduction and delays to simulate in a heart and its network.

    Attributes
    ----------
    primitives : tuple of Primitive
        `Stimulus`, `SlowConduction`, `InactiveRoot`, `JunctionDelays`, `His`, or your own.
        They are kept, and applied, in the order of the tables of scenario files.
    trees : tuple of (PurkinjeTree, float)
        Trees in addition to the heart's own, with the firing times of their roots (ms).
    source : str, optional
        File that it was read from, for messages.
    description, reference : str
        Description in a line, and its literature; may be empty.
    """

    primitives: Sequence[Primitive] = ()
    trees: tuple[tuple[PurkinjeTree, float], ...] = ()
    source: str | None = field(default=None, repr=False, compare=False)
    description: str = field(default="", repr=False, compare=False)
    reference: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        check_items(self.primitives, Primitive, "primitives", "fascicle.Stimulus, fascicle.His, …")
        order = list(PRIMITIVES)
        in_order = sorted(self.primitives, key=lambda primitive: order.index(primitive.table))
        object.__setattr__(self, "primitives", tuple(in_order))
        kinds = [type(primitive) for primitive in self.primitives]
        for kind in kinds:
            if kind.once and kinds.count(kind) > 1:
                raise InputError(f"{kinds.count(kind)} times '{kind.table}'; give it once")
        if len(self.primitives) > 1000:  # rays from every stimulus to every vertex take long
            raise InputError(f"{len(self.primitives)} stimuli and the like; give 1000 at most")
        check_items(self.trees, tuple, "trees", "pairs (fascicle.PurkinjeTree, time)")
        for pair in self.trees:
            if len(pair) != 2 or not isinstance(pair[0], PurkinjeTree):
                raise InputError(f"trees: {shown(pair)} was given; give (PurkinjeTree, time)")
            within("time", pair[1], f"time of the tree '{pair[0].side}'")
        for name in ("source", "description", "reference"):
            check_kind(getattr(self, name), (str, NoneType), f"{name} of a scenario", "a text")

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Primitives of a kind."""
        return [primitive for primitive in self.primitives if isinstance(primitive, kind)]

    def mapped(self, change: Callable[[Primitive], Primitive]) -> Scenario:
        """Scenario with `change` applied to every primitive."""
        return replace(self, primitives=tuple(map(change, self.primitives)))

    @property
    def first_stimulus(self) -> float | None:
        """Time of the first stimulus or paced His bundle (ms); None without pacing."""
        times = (primitive.stimulus_time for primitive in self.primitives)
        return min((time for time in times if time is not None), default=None)

    @property
    def has_own_primitives(self) -> bool:
        """True if a primitive is the user's own, whose `apply` may change between two runs."""
        return any(not type(p).__module__.startswith("fascicle.") for p in self.primitives)

    @property
    def blocks(self) -> set[str]:
        """Names of the parts of the trees that are blocked."""
        return {block for primitive in self.primitives for block in primitive.blocked}

    def excitation(
        self,
        trees: Sequence[PurkinjeTree],
        root_time: float | Sequence[float],
        values: Mapping[str, float],
        sites: Sites,
    ) -> Excitation:
        """Excitation of a network in this scenario, to be solved.

        The trees are the heart's own, `values` quantities of the network, and `root_time` (ms) as
        in `root_times`. InputError if the scenario does not fit trees or heart.
        """
        roots = root_times(root_time)
        if len(roots) != len(trees):
            raise InputError(f"{len(roots)} root times for {len(trees)} trees; give one a tree")
        delays = {name: values.get(name, 0.0) for name in ("anterograde_delay", "retrograde_delay")}
        all_trees = (*trees, *(tree for tree, _ in self.trees))
        names = [tree.side for tree in all_trees]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two trees are named '{name}'; give each a name of its own")
        roots = [*roots, *(time for _, time in self.trees)]
        excitation = Excitation(all_trees, roots, sites, values, delays)
        for primitive in self.primitives:
            primitive.apply(excitation)
        return excitation


def root_times(root_time: float | Sequence[float]) -> list[float]:
    """Firing times of left and right root (ms) by their delay, the earlier at 0; or as given."""
    definition = quantity("root_time")
    if isinstance(root_time, list | tuple | np.ndarray):
        return [check(definition, time) for time in root_time]
    delay = check(definition, root_time)
    return [max(0.0, -delay), max(0.0, delay)]
