"""Growth of a Purkinje tree from a chart and parameters (paper: Álvarez-Barrientos et al.)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.parameters import Infeasible
from fascicle.core.quantities import Quantity, checked, declare, default_of, fascicles, quantity
from fascicle.core.ranges import check_kind
from fascicle.heart.endocardium import Endocardium
from fascicle.kernels import growth
from fascicle.mesh.measures import unit
from fascicle.purkinje.chart import Chart
from fascicle.purkinje.tree import PurkinjeTree

Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class GrowthTerm:
    """A term in the direction of growth: d ← normalise(d + term), at every segment of a branch.

    Attributes
    ----------
    function : function
        Called as ``function(tip, nearest, metric, values)``; for arguments and result see
        `fascicle.kernels.growth.repulsion`, the term of the paper. Numba compiles it; it may call
        `repulsion` and functions under `numba.njit`.
    parameters : tuple of Quantity
        Parameters of the function; simulations then take them like any other quantity.
    values : tuple of float, optional
        Values of the parameters; their defaults if not given.
    """

    function: Callable[[tuple[float, float, float, float], Triple, Triple, Floats], Pair]
    parameters: tuple[Quantity, ...] = ()
    values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for parameter in self.parameters:
            declare(parameter)
        if not self.values:
            values = tuple(float(parameter.default or 0.0) for parameter in self.parameters)
            object.__setattr__(self, "values", values)

    def __reduce__(self) -> tuple[Any, ...]:
        return GrowthTerm, (self.function, self.parameters, self.values)

    @property
    def numbers(self) -> dict[str, float]:
        """Values by the names of the parameters."""
        return {p.name: v for p, v in zip(self.parameters, self.values, strict=True)}

    def with_values(self, values: Mapping[str, float]) -> GrowthTerm:
        """Return the term with the values of those of its parameters that `values` names."""
        changed = checked({name: values.get(name, v) for name, v in self.numbers.items()})
        return replace(self, values=tuple(changed.values()))


REPULSION = GrowthTerm(growth.repulsion, (quantity("repulsion"),))


@cache
def _grow(term: Callable[..., Pair]) -> Any:
    """Compiled growth with a term; Numba caches that of the built-in term on disk."""
    if term is growth.repulsion:
        return growth.make_grow(term, cache=True)
    return growth.make_grow(register_jitable(term), cache=False)


@dataclass(frozen=True)
class GrowthRules:
    """Rules of growth that the paper holds fixed while the bundles and fascicles vary.

    Attributes
    ----------
    branch_length, segments : float and int
        Length of a branch (mm), and its number of segments.
    branch_angle : float
        Angle between a branch and its parent (rad).
    generations : int
        Number of generations of branches.
    clearance : float
        Distance, in lengths of a segment, to nodes of branches other than itself and its sister at
        which a branch stops.
    term : GrowthTerm
        Term that is added to the direction of growth; by default w = 0.1 times the direction away
        from the nearest node, that of the sister branch included.

    Raises
    ------
    InputError
        If a number is impossible.
    """

    branch_length: float = default_of("branch_length")
    segments: int = int(default_of("segments"))
    branch_angle: float = default_of("branch_angle")
    generations: int = int(default_of("generations"))
    clearance: float = default_of("clearance")
    term: GrowthTerm = field(default=REPULSION)

    def __post_init__(self) -> None:
        check_kind(self.term, GrowthTerm, "term", "a fascicle.GrowthTerm")
        checked(self.numbers)

    @property
    def numbers(self) -> dict[str, float]:
        """All quantities, those of the term included."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "term"}
        return values | self.term.numbers

    def with_values(self, values: Mapping[str, float]) -> GrowthRules:
        """Return the rules with the values of those of their quantities that `values` names."""
        changes: dict[str, Any] = {
            name: int(values[name]) if quantity(name).is_integer else values[name]
            for name in self.numbers.keys() - self.term.numbers.keys()
            if name in values
        }
        return replace(self, **changes, term=self.term.with_values(values))


class Seed(NamedTuple):
    """Start of a bundle in the disk, and its unit heading there."""

    point: Floats
    triangle: int
    heading: Floats


def find_seed(endocardium: Endocardium, chart: Chart) -> Seed:
    """Start of the bundle: the root vertex, in the triangle that the heading points into.

    Raises `InputError` if there is none, or root and direction are one vertex.
    """
    root, direction = endocardium.root, endocardium.direction
    point = chart.points[root]
    offset = chart.points[direction] - point
    if offset.any():
        heading = unit(offset)
        for triangle, corner in np.argwhere(chart.triangles == root):
            first, second = chart.points[np.roll(chart.triangles[triangle], -corner)[1:]] - point
            # the heading lies between the two edges that leave the root, counter-clockwise
            if _cross(first, heading) >= 0 and _cross(heading, second) >= 0:
                return Seed(point, int(triangle), heading)
    raise InputError(
        f"{endocardium.side.upper()} seeds: from root {root} the direction vertex {direction} is "
        "the same or lies outside the endocardium; choose one towards the apex"
    )


def _cross(a: Floats, b: Floats) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def with_angles(
    chart: Chart, seed: Seed, parameters: Mapping[str, float], apical: Floats, anterior: Floats
) -> dict[str, float]:
    """Parameters with the angles of left fascicles in place of their directions.

    A direction counts from the tangent of the endocardium that points most to the apex, where the
    bundle ends, towards the one that points most anteriorly; `apical` and `anterior` are vectors
    (3,) of the heart. The angle, in the disk, is the one to the bundle.
    """
    values = dict(parameters)
    directions = {name: values.pop(name) for name in parameters if "_fascicle_direction_" in name}
    if not directions:
        return values
    heading, (u, v) = seed.heading, seed.point
    length = parameters["lv_initial_length"]
    triangle = growth.walk(u, v, seed.triangle, *heading, length, chart)[2]
    corners = chart.triangles[triangle]
    across = np.diff(chart.points[corners], axis=0)
    jacobian = np.linalg.solve(across, np.diff(chart.vertices[corners], axis=0)).T  # ∂x/∂u
    metric = jacobian.T @ jacobian

    def tangent(vector: Floats, *orthogonal: Floats) -> Floats:
        """Direction in the disk, of unit length in the metric, nearest to a vector."""
        along = np.linalg.solve(metric, jacobian.T @ vector)
        for other in orthogonal:
            along = along - (along @ metric @ other) * other
        return np.asarray(along / np.sqrt(along @ metric @ along))

    to_apex = tangent(apical)
    forwards = tangent(anterior, to_apex)
    for name, direction in directions.items():
        towards = np.cos(direction) * to_apex + np.sin(direction) * forwards
        angle = np.arctan2(_cross(heading, towards), heading @ towards)
        values[name.replace("direction", "angle")] = float(angle)
    return values


def grow_from_parameters(
    side: str, chart: Chart, seed: Seed, parameters: Mapping[str, float], rules: GrowthRules
) -> PurkinjeTree | Infeasible:
    """Grow a tree: bundle, fascicles from its end, then generations of branches.

    Each segment obeys d ← normalise(d + w∇d_CP(x)), x ← x + (l_b/N_s)·d (equation 1 of the
    paper), with unit vectors and distances of the endocardium's own metric, or with another term.
    The outcome is an `Infeasible` where the bundle or a fascicle would leave the endocardium.

    The parameters, of both sides, are lengths (mm) of the bundle and of as many fascicles as are
    named, and their angles to it (rad, counter-clockwise in the disk seen from inside the cavity).

    Notes
    -----
    d_CP is the distance to the nearest node already in the tree, those of the branch itself and
    the one it starts from excepted. The sister branch repels, as in the published code
    (fractal-tree, purkinje-uv), but here only by nodes of earlier rounds. There the branch that
    grows second is also repelled by the node that its sister has just got, so that left and right
    differ. In neither code does the sister stop a branch. Other differences: in the published code
    the start node repels as well, a branch has one segment more than N_s, a branch keeps the node
    by which it comes too near to another (here it does not), and lengths are measured with one
    scale factor per triangle instead of its metric.
    """
    numbers = range(1, fascicles(side, parameters) + 1)
    lengths = [parameters[f"{side}_fascicle_length_{k}"] for k in numbers]
    lengths = [parameters[f"{side}_initial_length"], *lengths]
    limits = growth.Rules(
        step=float(rules.branch_length / rules.segments),
        segments=int(rules.segments),
        generations=int(rules.generations),
        branch_angle=float(rules.branch_angle),
        clearance=float(rules.clearance),
    )
    status, missing, grown = _grow(rules.term.function)(
        seed,
        float(lengths[0]),
        np.array(lengths[1:], float),
        np.array([parameters[f"{side}_fascicle_angle_{k}"] for k in numbers], float),
        limits,
        np.array(rules.term.values, float),
        chart,
    )
    if status == growth.TOO_LARGE:
        raise InputError(
            f"the {side.upper()} tree grows to more than {limits.most_nodes} nodes, or "
            f"{limits.most_ends} ends at a time; choose fewer generations or segments, a larger "
            "clearance or longer branches"
        )
    if status == growth.GROWN:
        return tree_of_nodes(side, grown, chart)
    return tree_outside(side, status, lengths[status], missing, grown[-1:], chart)


def tree_of_nodes(side: str, nodes: NDArray[np.void], chart: Chart) -> PurkinjeTree:
    """Purkinje tree of the nodes, an array of NODE, that were grown in a chart."""
    parents, labels, triangles = (
        nodes[name].astype(np.int64) for name in ("parent", "branch", "triangle")
    )
    lengths = nodes["length"].copy()
    return PurkinjeTree(side, growth.lift(nodes, chart), parents, lengths, labels, triangles)


def tree_outside(
    side: str, branch: int, length: float, missing: float, end: NDArray[np.void], chart: Chart
) -> Infeasible:
    """Outcome of a path that met the base at node `end` (1,), `missing` mm short of its length."""
    part, name = "bundle", "initial_length"
    if branch > 0:
        part, name = f"fascicle {branch}", f"fascicle_length_{branch}"
    place = ", ".join(f"{x:.1f}" for x in growth.lift(end, chart)[0].tolist())
    return Infeasible(
        f"{side.upper()} {part} leaves the endocardium after {length - missing:.1f} of "
        f"{length:.1f} mm, at ({place}) mm on the base",
        "shorten it",
        f"{side}_{name}",
        length - missing,
    )
