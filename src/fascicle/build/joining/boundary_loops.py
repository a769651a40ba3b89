"""Two rims that run alike, brought to one common polygon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial import cKDTree

from fascicle.build.joining.parts import SAME_POINT, Part, point
from fascicle.core.errors import InputError

LARGEST_GAP = 2.5  # mm; farther apart, rims are not the same one
PAIR = 0.35  # of the local spacing within which two rims' vertices become one
SMOOTHINGS = 2  # averages over neighbours where rims did not meet: their errors zigzag
LEAST_STEP = 0.02  # of the mean spacing by which vertices advance along the other rim


@dataclass(frozen=True)
class Knots:
    """The corners of the polygon that two rims share.

    Attributes
    ----------
    one, other : (k,) arrays
        Which vertex each corner is on either rim, counted along the rim; -1 where it is new there.
    on_one, on_other : (k, 3) arrays
        Where the corners are on either rim (mm).
    """

    one: NDArray[np.int64]
    other: NDArray[np.int64]
    on_one: NDArray[np.float64]
    on_other: NDArray[np.float64]

    @property
    def places(self) -> NDArray[np.float64]:
        """Halfway between the rims (mm), smoothed, (k, 3); where they meet, nothing moves."""
        same = np.linalg.norm(self.on_one - self.on_other, axis=1) < SAME_POINT
        places = np.where(same[:, np.newaxis], self.on_other, (self.on_one + self.on_other) / 2)
        for _ in range(SMOOTHINGS):
            around = (np.roll(places, 1, axis=0) + np.roll(places, -1, axis=0)) / 2
            places = np.where(same[:, np.newaxis], places, (places + around) / 2)
        return places


def common_knots(
    one: NDArray[np.float64], other: NDArray[np.float64], names: tuple[str, str], name: str
) -> Knots:
    """Find a polygon halfway between two closed polygons, which has the corners of both.

    Parameters
    ----------
    one, other : (n, 3) and (m, 3) arrays
        Positions along the rims (mm), in either direction.
    names : pair of str
        What the rims belong to.
    name : str
        What the whole is called.

    Raises
    ------
    InputError
        If the rims are farther apart than `LARGEST_GAP` somewhere, or do not run alike.
    """
    _check_gap(one, other, names, name)
    length, starts = _arc(other)
    along, _ = _nearest_on(one, other)
    steps = np.diff(along, append=along[0])
    steps = (steps + length / 2) % length - length / 2
    turns = steps.sum() / length
    if abs(abs(turns) - 1) > 0.5:
        raise InputError(
            f"{name}: the rims of {names[0]} and {names[1]} do not run alike (about "
            f"{point(one.mean(axis=0))} mm); smooth or remesh them"
        )
    order = np.arange(len(one))
    if turns < 0:
        order = order[::-1]
    along = _advancing(along[order], length)
    return _merged(one[order], order, along, other, starts, length)


def split_at(
    part: Part, rim: NDArray[np.int64], own: NDArray[np.int64], places: NDArray[np.float64]
) -> tuple[Part, NDArray[np.int64]]:
    """Insert the corners that a rim lacks.

    Parameters
    ----------
    part : Part
        The surface.
    rim : (n,) array
        One of its rims.
    own : (k,) array
        Which vertex of the rim each corner is, -1 for a new one; in either direction.
    places : (k, 3) array
        Where new corners go (mm).

    Returns
    -------
    Part
        With the new vertices last.
    (k,) array
        The corners' vertices.
    """
    splits: dict[tuple[int, int], NDArray[np.float64]] = {}
    vertices = np.where(own >= 0, rim[own], -1)
    known = np.flatnonzero(own >= 0)
    following = len(part.vertices)
    for here, there in zip(known, np.roll(known, -1), strict=True):
        between = (here + 1 + np.arange((there - here - 1) % len(own))) % len(own)
        if between.size:
            splits[int(vertices[here]), int(vertices[there])] = places[between]
            vertices[between] = following + np.arange(between.size)
            following += between.size
    return part.with_split_edges(splits), vertices


def rim_distance(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Mean distance of one polygon's corners from another polygon (mm)."""
    return float(np.linalg.norm(one - _nearest_on(one, other)[1], axis=1).mean())


def _check_gap(
    one: NDArray[np.float64], other: NDArray[np.float64], names: tuple[str, str], name: str
) -> None:
    points = np.vstack([one, other])
    nearest = np.vstack([_nearest_on(one, other)[1], _nearest_on(other, one)[1]])
    gap = np.linalg.norm(points - nearest, axis=1)
    worst = int(np.argmax(gap))
    if gap[worst] > LARGEST_GAP:
        raise InputError(
            f"{name}: the rims of {names[0]} and {names[1]} are up to {gap[worst]:.1f} mm apart "
            f"(at {point(points[worst])} mm), more than {LARGEST_GAP:g} mm; bring them together, "
            "or give no base to have one made"
        )


def _arc(polygon: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Length of a closed polygon and where along it each corner is (mm)."""
    sides = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return float(sides.sum()), np.r_[0.0, np.cumsum(sides)[:-1]]


def _nearest_on(
    points: NDArray[np.float64], polygon: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nearest places on a closed polygon: how far along (mm), and where."""
    _, starts = _arc(polygon)
    side = np.roll(polygon, -1, axis=0) - polygon
    squared = np.maximum(np.einsum("ij,ij->i", side, side), SAME_POINT**2)
    offset = points[:, np.newaxis] - polygon
    share = np.clip(np.einsum("pij,ij->pi", offset, side) / squared, 0, 1)
    places = polygon + share[..., np.newaxis] * side
    best = np.argmin(np.linalg.norm(points[:, np.newaxis] - places, axis=2), axis=1)
    rows = np.arange(len(points))
    along = starts[best] + share[rows, best] * np.linalg.norm(side, axis=1)[best]
    return along, places[rows, best]


def _advancing(along: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """Places along the other rim, made to advance strictly and by less than one round."""
    steps = (np.diff(along) + length / 2) % length - length / 2
    unrolled = along[0] + np.r_[0.0, np.cumsum(steps)]
    least = LEAST_STEP * length / len(along) * np.arange(len(along))
    unrolled = isotonic_regression(unrolled - least).x + least
    room = length * (1 - LEAST_STEP / len(along))
    if unrolled[-1] - unrolled[0] > room:
        unrolled = unrolled[0] + (unrolled - unrolled[0]) * room / (unrolled[-1] - unrolled[0])
    return np.asarray(unrolled)


def _merged(
    one: NDArray[np.float64],
    order: NDArray[np.int64],
    along: NDArray[np.float64],
    other: NDArray[np.float64],
    starts: NDArray[np.float64],
    length: float,
) -> Knots:
    """Corners of both rims in their common order; close ones are one corner."""
    partner = _partners(along, starts, length)
    lonely = np.setdiff1d(np.arange(len(other)), partner[partner >= 0])
    where = np.r_[np.where(partner >= 0, starts[partner], along), starts[lonely]] % length
    first = np.r_[np.arange(len(one)), np.full(len(lonely), -1)]
    second = np.r_[partner, lonely]
    sequence = np.argsort(where, kind="stable")
    where, first, second = where[sequence], first[sequence], second[sequence]
    return Knots(
        np.where(first >= 0, order[first], -1),
        second,
        _interpolated(where, first, one, length),
        _interpolated(where, second, other, length),
    )


def _partners(
    along: NDArray[np.float64], starts: NDArray[np.float64], length: float
) -> NDArray[np.int64]:
    """For each corner of one rim the other rim's corner that it is to be one with, or -1."""
    circle = [np.mod(x, length)[:, np.newaxis] for x in (along, starts)]
    trees = [cKDTree(x, boxsize=length * (1 + 1e-12)) for x in circle]
    distance, nearest = trees[1].query(circle[0])
    _, back = trees[0].query(circle[1])
    spacing = np.minimum(
        *(_spacing(x[:, 0], length)[k] for x, k in ((circle[0], slice(None)), (circle[1], nearest)))
    )
    mutual = back[nearest] == np.arange(len(along))
    return np.where(mutual & (distance < PAIR * spacing + SAME_POINT), nearest, -1)


def _spacing(where: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """Mean of the steps before and after each corner."""
    ahead = np.mod(np.roll(where, -1) - where, length)
    return np.asarray((ahead + np.roll(ahead, 1)) / 2)


def _interpolated(
    where: NDArray[np.float64],
    corner: NDArray[np.int64],
    polygon: NDArray[np.float64],
    length: float,
) -> NDArray[np.float64]:
    """Positions on one rim of all common corners: its own, and evenly between them."""
    known = np.flatnonzero(corner >= 0)
    places = np.empty((len(where), 3))
    places[known] = polygon[corner[known]]
    for here, there in zip(known, np.roll(known, -1), strict=True):
        between = (here + 1 + np.arange((there - here - 1) % len(where))) % len(where)
        share = np.mod(where[between] - where[here], length) / max(
            float(np.mod(where[there] - where[here], length)), SAME_POINT
        )
        places[between] = places[here] + share[:, np.newaxis] * (places[there] - places[here])
    return places
