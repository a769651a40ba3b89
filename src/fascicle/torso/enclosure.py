"""Whether heart, lungs and skin lie within one another as those of a body do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import LabelledMesh
from fascicle.mesh.topology import directed_edges, unique_edges
from fascicle.torso.surfaces import Surface, signed_distance

# Largest extents; those of a child are above the first, nobody's above the second.
TORSO_EXTENT = (200.0, 2500.0)  # mm
LUNG_EXTENT = (70.0, 450.0)  # mm
LEAST_GAP = 0.5  # mm, between one surface and another


def check_within(
    mesh: LabelledMesh,
    skin: Surface,
    lungs: Sequence[Surface] = (),
    names: Sequence[str] = (),
) -> None:
    """Refuse surfaces between which no tetrahedra fit.

    Parameters
    ----------
    mesh : LabelledMesh
        The heart (mm).
    skin, lungs : Surface and sequence of Surface
        The torso's (mm).
    names : sequence of str
        What to call skin and lungs in an error, where they come from files.

    Raises
    ------
    InputError
        If the torso is not in mm, a surface is open, crosses itself or has triangles turned the
        wrong way, heart or lungs reach out of the torso, or heart and lungs or two lungs overlap.
    """
    names = names or ["torso", *(f"lung {number}" for number in range(1, len(lungs) + 1))]
    for name, surface in zip(names, (skin, *lungs), strict=True):
        check_extent(name, surface, TORSO_EXTENT if surface is skin else LUNG_EXTENT)
        check_closed(name, surface)
        _check_not_crossing_itself(name, surface)
    heart = Surface(mesh.vertices, mesh.triangles)
    check_closed(mesh.name, heart)
    _check_inside(mesh.name, mesh.vertices[np.unique(mesh.triangles)], skin)
    for k, lung in enumerate(lungs):
        _check_inside(names[k + 1], lung.vertices, skin)
        _check_apart(names[k + 1], lung, mesh.name, heart)
        for other in range(k):
            _check_apart(names[k + 1], lung, names[other + 1], lungs[other])


def check_extent(name: str, surface: Surface, limits: tuple[float, float]) -> None:
    """Refuse a surface whose size says that it is not in mm."""
    extent = float(np.ptp(surface.vertices, axis=0).max())
    low, high = limits
    if low <= extent <= high:
        return
    for unit, factor in (("metres", 1e3), ("centimetres", 10.0)):
        if low <= extent * factor <= high:
            raise InputError(
                f"{name}: its largest extent is {extent:.3g}, so it seems to be in {unit}; "
                f"multiply the coordinates by {factor:g} to get mm"
            )
    raise InputError(
        f"{name}: its largest extent is {extent:.3g}; in mm it would have {low:g} to {high:g}; "
        "check the units"
    )


def check_closed(name: str, surface: Surface) -> None:
    """Refuse a surface with holes, with several sheets on one edge, or turned inside out."""
    edges, count = unique_edges(surface.triangles)
    for bad, what, remedy in (
        (count == 1, "an open edge", "close the hole"),
        (count > 2, "an edge of more than two triangles", "make it one closed surface"),
    ):
        if bad.any():
            where = _place(surface.vertices[edges[bad][0]].mean(axis=0))
            raise InputError(f"{name}: the surface has {what} at {where}; {remedy}")
    directed, count = np.unique(directed_edges(surface.triangles), axis=0, return_counts=True)
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
    """Refuse surfaces that overlap, one within the other included, or touch."""
    points = np.concatenate([one.vertices, other.vertices])
    gap = np.concatenate(
        [signed_distance(one.vertices, other), signed_distance(other.vertices, one)]
    )
    deepest = points[np.argmin(gap)]
    crossed = crossing(one, other)
    if gap.min() < 0 or crossed is not None:
        where = deepest if crossed is None or gap.min() < 0 else crossed
        raise InputError(
            f"{name}: overlaps {other_name} by {max(-gap.min(), 0):.1f} mm at {_place(where)}; "
            "cut it back there"
        )
    if gap.min() < LEAST_GAP:
        raise InputError(
            f"{name}: touches {other_name} at {_place(deepest)}; leave {LEAST_GAP:g} mm between"
        )


def _place(point: NDArray[np.float64]) -> str:
    return "({:.1f}, {:.1f}, {:.1f})".format(*point)


def crossing(one: Surface, other: Surface) -> NDArray[np.float64] | None:
    """A place (3,) where two surfaces, or one given twice, pass through each other, if any.

    They do where an edge of one passes through a triangle of the other, corners they share not
    counting.
    """
    for a, b in ((one, other), (other, one)):
        edges, _ = unique_edges(a.triangles)
        pairs = _near_pairs(a.vertices[edges], b.corners)
        if one is other:
            edge, triangle = edges[pairs[:, 0]], b.triangles[pairs[:, 1]]
            pairs = pairs[~(edge[:, :, None] == triangle[:, None, :]).any(axis=(1, 2))]
        ends, corners = a.vertices[edges[pairs[:, 0]]], b.corners[pairs[:, 1]]
        through = _passes_through(ends, corners)
        if through.any():
            return np.asarray(corners[through][0].mean(axis=0))
    return None


def _near_pairs(ends: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pairs (k, 2) of an edge (n, 2, 3) and a triangle (m, 3, 3) whose boxes meet."""
    middle, centre = ends.mean(axis=1), corners.mean(axis=1)
    reach = np.linalg.norm(ends - middle[:, None], axis=2).max(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max()
    found = cKDTree(centre).query_ball_point(middle, reach + radius, return_sorted=False)
    edge = np.repeat(np.arange(len(ends)), [len(near) for near in found])
    triangle = np.concatenate([np.empty(0), *found]).astype(np.int64)
    a, b = ends[edge], corners[triangle]
    meet = (a.min(axis=1) <= b.max(axis=1)) & (b.min(axis=1) <= a.max(axis=1))
    return np.asarray(np.stack([edge, triangle], axis=1)[meet.all(axis=1)])


def _passes_through(ends: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether segments (k, 2, 3) pass through triangles (k, 3, 3).

    The ends lie on different sides of the plane, and the segment passes all sides of the triangle
    on the same side, by the signs of volumes (Segura and Feito 2001, WSCG).
    """
    start, end = ends[:, 0], ends[:, 1]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    opposite = _volume(a, b, c, start) * _volume(a, b, c, end) < 0
    sides = np.stack([_volume(p, q, end, start) for p, q in ((a, b), (b, c), (c, a))])
    return np.asarray(opposite & ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)))


def _volume(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    d: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Six times the signed volume between points (k, 3)."""
    return np.asarray(np.einsum("ij,ij->i", a - d, np.cross(b - d, c - d)))
