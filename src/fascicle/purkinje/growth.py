"""From chart and parameters to a Purkinje tree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.quantities import check, checked, default_of, fascicles, quantity
from fascicle.heart.endocardium import Endocardium
from fascicle.kernels import growth
from fascicle.kernels.arrays import Rules
from fascicle.mesh.measures import unit
from fascicle.purkinje.chart import Chart
from fascicle.purkinje.tree import InvalidTree, PurkinjeTree


@dataclass(frozen=True)
class GrowthRules:
    """What the paper holds fixed while the bundles and fascicles vary.

    Attributes
    ----------
    branch_length : float
        Length of a branch (mm).
    segments : int
        Segments a branch is laid in.
    repulsion : float
        Weight w of the direction away from the nearest node, the sister branch's included.
    branch_angle : float
        Angle between a branch and its parent (rad).
    generations : int
        How often the ends branch.
    clearance : float
        A branch stops nearer than this many segments to a node that is neither its own nor its
        sister's.

    Raises
    ------
    InputError
        If a number is impossible.
    """

    branch_length: float = default_of("branch_length")
    segments: int = int(default_of("segments"))
    repulsion: float = default_of("repulsion")
    branch_angle: float = default_of("branch_angle")
    generations: int = int(default_of("generations"))
    clearance: float = default_of("clearance")

    def __post_init__(self) -> None:
        checked({field.name: getattr(self, field.name) for field in fields(self)})

    def with_values(self, values: Mapping[str, float]) -> GrowthRules:
        """The same with other values of the quantities in `values` that concern it."""
        changes: dict[str, Any] = {
            field.name: int(values[field.name])
            if quantity(field.name).is_integer
            else values[field.name]
            for field in fields(self)
            if field.name in values
        }
        return replace(self, **changes)


class Seed(NamedTuple):
    """Where a bundle starts in the disk, and its unit heading there."""

    point: Floats
    triangle: int
    heading: Floats


def find_seed(endocardium: Endocardium, chart: Chart) -> Seed:
    """Start of the bundle: the root vertex, in the triangle that the heading points into.

    Raises
    ------
    InputError
        If root and direction are one vertex, or the heading points out of the endocardium.
    """
    side = endocardium.side.upper()
    point = chart.points[endocardium.root]
    offset = chart.points[endocardium.direction] - point
    if not offset.any():
        raise InputError(
            f"{side} seeds: root and direction are the same vertex ({endocardium.root}); "
            "give two different ones"
        )
    heading = unit(offset)
    for triangle in np.flatnonzero((chart.triangles == endocardium.root).any(axis=1)):
        corner = int(np.flatnonzero(chart.triangles[triangle] == endocardium.root)[0])
        first, second = (
            chart.points[chart.triangles[triangle, (corner + k) % 3]] - point for k in (1, 2)
        )
        # the heading lies between the two edges that leave the root, counter-clockwise
        if _cross(first, heading) >= 0 and _cross(heading, second) >= 0:
            return Seed(point, int(triangle), heading)
    raise InputError(
        f"{side} seeds: from root {endocardium.root} the direction vertex "
        f"{endocardium.direction} lies outside the endocardium; choose one towards the apex"
    )


def _cross(a: Floats, b: Floats) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def grow_tree(
    side: str,
    chart: Chart,
    seed: Seed,
    bundle_length: float,
    fascicle_lengths: Sequence[float],
    fascicle_angles: Sequence[float],
    rules: GrowthRules,
) -> PurkinjeTree | InvalidTree:
    """Grow a tree: bundle, fascicles from its end, then generations of branches.

    Each segment obeys d ← normalise(d + w∇d_CP(x)), x ← x + (l_b/N_s)·d (equation 1 of the
    paper), with unit vectors and distances of the endocardium's own metric.

    Parameters
    ----------
    side : str
        ``"lv"`` or ``"rv"``.
    chart : Chart
        The endocardium's map to the disk.
    seed : Seed
        Start and heading of the bundle.
    bundle_length : float
        Length of the bundle (mm).
    fascicle_lengths, fascicle_angles : sequences of the same length
        Length (mm) of each fascicle and its angle to the bundle (rad, counter-clockwise in the
        disk seen from inside the cavity).
    rules : GrowthRules
        What is held fixed.

    Returns
    -------
    PurkinjeTree or InvalidTree
        `InvalidTree` where the bundle or a fascicle would leave the endocardium.

    Notes
    -----
    d_CP is the distance to the nearest node already in the tree, those of the branch itself and
    the one it starts from excepted. The sister branch repels, as in the published code
    (fractal-tree, purkinje-uv), but here only with nodes laid in earlier rounds. There the branch
    that moves second also sees the node that its sister has just laid, so that left and right
    differ. Neither code lets the sister stop a branch. Other differences: the published code lets
    the start node repel as well, gives a branch one segment more than N_s, lays a node before it
    finds that it is too near another (here it is not laid), and measures with one factor of scale
    per triangle instead of its metric.
    """
    length, angle = (quantity(f"lv_fascicle_{what}_1") for what in ("length", "angle"))
    for known, values in ((length, (bundle_length, *fascicle_lengths)), (angle, fascicle_angles)):
        for value in values:
            check(known, value)
    status, missing, grown = growth.grow(
        seed,
        float(bundle_length),
        np.asarray(fascicle_lengths, float),
        np.asarray(fascicle_angles, float),
        Rules(
            step=float(rules.branch_length / rules.segments),
            segments=int(rules.segments),
            generations=int(rules.generations),
            repulsion=float(rules.repulsion),
            branch_angle=float(rules.branch_angle),
            clearance=float(rules.clearance),
        ),
        chart,
    )
    if status == growth.TOO_LARGE:
        raise InputError(
            f"the {side.upper()} tree grows to more than {growth.MOST_NODES} nodes, or "
            f"{growth.MOST_SPROUTS} ends at a time; choose fewer generations or segments, a larger "
            "clearance or longer branches"
        )
    if status == growth.GROWN:
        return tree_of_nodes(side, grown, chart)
    lengths = (bundle_length, *fascicle_lengths)
    return tree_outside(side, status, lengths[status], missing, grown[-1:], chart)


def tree_of_nodes(side: str, nodes: NDArray[np.void], chart: Chart) -> PurkinjeTree:
    """The tree of nodes, an array of NODE, that were grown in a chart."""
    return PurkinjeTree(
        side,
        growth.lift(nodes, chart),
        nodes["parent"].astype(np.int64),
        nodes["length"].copy(),
        nodes["branch"].astype(np.int64),
        nodes["triangle"].astype(np.int64),
    )


def tree_outside(
    side: str, branch: int, wanted: float, missing: float, end: NDArray[np.void], chart: Chart
) -> InvalidTree:
    """The outcome where a stretch leaves the endocardium.

    Parameters
    ----------
    side, branch, wanted
        See `InvalidTree`.
    missing : float
        How much of it could not be laid (mm).
    end : (1,) array of NODE
        Where it met the base.
    chart : Chart
        In which it was grown.
    """
    position = tuple(growth.lift(end, chart)[0].tolist())
    return InvalidTree(side, branch, wanted - missing, wanted, position)


def grow_from_parameters(
    side: str, chart: Chart, seed: Seed, parameters: Mapping[str, float], rules: GrowthRules
) -> PurkinjeTree | InvalidTree:
    """Grow one side's tree from named parameters, with as many fascicles as they name.

    Parameters
    ----------
    side, chart, seed, rules
        See `grow_tree`.
    parameters : mapping of name to float
        Lengths (mm) and angles (rad) of both sides, named as in `fascicle.core.parameters`.
    """
    numbers = range(1, fascicles(side, parameters) + 1)
    return grow_tree(
        side,
        chart,
        seed,
        parameters[f"{side}_initial_length"],
        [parameters[f"{side}_fascicle_length_{k}"] for k in numbers],
        [parameters[f"{side}_fascicle_angle_{k}"] for k in numbers],
        rules,
    )
