"""Whether heart, lungs and skin lie within one another as those of a body do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fascicle.errors import InputError
from fascicle.geometry.surface import LabelledMesh
from fascicle.torso.surfaces import Surface, signed_distance

# A torso's largest extent; that of a child's is above the first, nobody's above the other.
TORSO_EXTENT = (200.0, 1500.0)  # mm
LEAST_GAP = 0.5  # mm, between one surface and another


def check_within(mesh: LabelledMesh, skin: Surface, lungs: Sequence[Surface] = ()) -> None:
    """Refuse surfaces between which no tetrahedra fit.

    Parameters
    ----------
    mesh : LabelledMesh
        The heart (mm).
    skin, lungs : Surface and sequence of Surface
        The torso's (mm).

    Raises
    ------
    InputError
        If the torso is not in mm, a surface is open, crosses itself or has triangles turned the
        wrong way, heart or lungs reach out of the torso, or heart and lungs or two lungs overlap.
    """
    names = ["torso", *(f"lung {number}" for number in range(1, len(lungs) + 1))]
    _check_extent(skin)
    for name, surface in zip(names, (skin, *lungs), strict=True):
        check_closed(name, surface)
        _check_not_crossing_itself(name, surface)
    heart = mesh.vertices[np.unique(mesh.triangles)]
    _check_inside(mesh.name, heart, skin)
    for k, lung in enumerate(lungs):
        _check_inside(names[k + 1], lung.vertices, skin)
        heart_surface = Surface(mesh.vertices, mesh.triangles)
        _check_apart(names[k + 1], lung, mesh.name, heart_surface)
        for other in range(k):
            _check_apart(names[k + 1], lung, names[other + 1], lungs[other])


def _check_extent(skin: Surface) -> None:
    extent = float(np.ptp(skin.vertices, axis=0).max())
    low, high = TORSO_EXTENT
    if low <= extent <= high:
        return
    for unit, factor in (("metres", 1e3), ("centimetres", 10.0)):
        if low <= extent * factor <= high:
            raise InputError(
                f"torso: its largest extent is {extent:.3g}, so it seems to be in {unit}; "
                f"multiply the coordinates by {factor:g} to get mm"
            )
    raise InputError(
        f"torso: its largest extent is {extent:.3g}; torsos in mm have {low:g} to {high:g}; "
        "check the units"
    )


def check_closed(name: str, surface: Surface) -> None:
    """Refuse a surface with holes, with several sheets on one edge, or turned inside out."""
    corners = surface.triangles
    half = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges, count = np.unique(np.sort(half, axis=1), axis=0, return_counts=True)
    for bad, what, remedy in (
        (count == 1, "an open edge", "close the hole"),
        (count > 2, "an edge of more than two triangles", "make it one closed surface"),
    ):
        if bad.any():
            where = _place(surface.vertices[edges[bad][0]].mean(axis=0))
            raise InputError(f"{name}: the surface has {what} at {where}; {remedy}")
    directed, count = np.unique(half, axis=0, return_counts=True)
    if (count > 1).any():
        where = _place(surface.vertices[directed[count > 1][0]].mean(axis=0))
        raise InputError(
            f"{name}: neighbouring triangles at {where} are wound against each other; turn one"
        )
    if surface.litres < 0:
        raise InputError(f"{name}: the surface is inside out; reverse its triangles")


def _check_not_crossing_itself(name: str, surface: Surface) -> None:
    where = crossing(surface, surface)
    if where is not None:
        raise InputError(
            f"{name}: the surface crosses itself at {_place(where)}; repair it or smooth it there"
        )


def _check_inside(name: str, points: NDArray[np.float64], skin: Surface) -> None:
    beyond = signed_distance(points, skin)
    worst = int(np.argmax(beyond))
    if beyond.min() > 0:
        raise InputError(
            f"{name}: lies outside the torso, {beyond.min():.0f} mm from its skin; give both in "
            "the same frame and in mm"
        )
    if beyond[worst] > 0:
        raise InputError(
            f"{name}: pokes {beyond[worst]:.1f} mm through the torso's skin at "
            f"{_place(points[worst])}; give both in the same frame, or a torso that holds it"
        )
    if beyond[worst] > -LEAST_GAP:
        raise InputError(
            f"{name}: touches the torso's skin at {_place(points[worst])}; leave "
            f"{LEAST_GAP:g} mm between them"
        )


def _check_apart(name: str, one: Surface, other_name: str, other: Surface) -> None:
    """Refuse surfaces that overlap, one lying in the other included, or touch."""
    distance = signed_distance(one.vertices, other)
    back = signed_distance(other.vertices, one)
    where = crossing(one, other)
    if min(distance.min(), back.min()) < 0 or where is not None:
        depth = -min(distance.min(), back.min())
        if where is None:
            deepest = (one.vertices[np.argmin(distance)], other.vertices[np.argmin(back)])
            where = deepest[int(back.min() < distance.min())]
        raise InputError(
            f"{name}: overlaps {other_name} by {max(depth, 0):.1f} mm at {_place(where)}; "
            "cut it back there"
        )
    if min(distance.min(), back.min()) < LEAST_GAP:
        where = one.vertices[np.argmin(distance)]
        raise InputError(
            f"{name}: touches {other_name} at {_place(where)}; leave {LEAST_GAP:g} mm between them"
        )


def _place(point: NDArray[np.float64]) -> str:
    return "({:.1f}, {:.1f}, {:.1f})".format(*point)


def crossing(one: Surface, other: Surface) -> NDArray[np.float64] | None:
    """A point (3,) where an edge of one surface passes through a triangle of the other.

    Two surfaces cross only if such a point exists for one or the other of them. Edges that share a
    vertex with the triangle do not count. Edge and triangle meet where the five volumes that they
    span agree in sign (Segura and Feito 2001, WSCG).
    """
    for a, b in ((one, other), (other, one)):
        edges = np.unique(
            np.sort(a.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0
        )
        ends, corners = a.vertices[edges], b.corners
        pairs = _near_pairs(ends, corners)
        if a is b or one is other:
            shared = (edges[pairs[:, 0]][:, :, None] == b.triangles[pairs[:, 1]][:, None]).any((1, 2))
            pairs = pairs[~shared]
        start, end = ends[pairs[:, 0]].transpose(1, 0, 2)
        hit = _passes_through(start, end, corners[pairs[:, 1]])
        if hit.any():
            return np.asarray(corners[pairs[hit][0, 1]].mean(axis=0))
        if one is other:
            break
    return None


def _near_pairs(
    ends: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Pairs (k, 2) of an edge and a triangle whose boxes meet."""
    middle, centre = ends.mean(axis=1), corners.mean(axis=1)
    reach = np.linalg.norm(ends - middle[:, None], axis=2).max(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    found = cKDTree(centre).query_ball_point(middle, reach + radius.max(), return_sorted=False)
    count = np.array([len(near) for near in found])
    pairs = np.stack(
        [np.repeat(np.arange(len(ends)), count), np.concatenate([*found, []]).astype(np.int64)],
        axis=1,
    )
    a, b = ends[pairs[:, 0]], corners[pairs[:, 1]]
    meet = (a.min(axis=1) <= b.max(axis=1)) & (b.min(axis=1) <= a.max(axis=1))
    return np.asarray(pairs[meet.all(axis=1)])


def _passes_through(
    start: NDArray[np.float64], end: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether segments (k, 3) to (k, 3) pass through triangles (k, 3, 3)."""
    a, b, c = corners.transpose(1, 0, 2)

    def volume(p, q, r, s):  # type: ignore[no-untyped-def]
        return np.einsum("ij,ij->i", p - s, np.cross(q - s, r - s))

    opposite = volume(a, b, c, start) * volume(a, b, c, end) < 0
    sides = np.stack([volume(a, b, end, start), volume(b, c, end, start), volume(c, a, end, start)])
    return np.asarray(opposite & ((sides > 0).all(axis=0) | (sides < 0).all(axis=0)))
