"""The base between the boundary loops of epicardium and endocardia."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.joining.parts import SAME_POINT, OpenSurface
from fascicle.build.surface_checks import place
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.mesh.measures import best_plane, edge_lengths, mean_edge_length
from fascicle.mesh.meshing import constrained_delaunay
from fascicle.mesh.topology import unique_edges

LARGEST_GAP = 2.5  # mm; farther apart, boundary loops are not the same one
FADE = 7.5  # mm from the loops at which a base's heights are its own again
CLEAR = 0.7  # of the spacing that inner points keep from the loops
FOLDED = 0.05  # of a base's area may lie under the rest, seen along its normal


class Outline(NamedTuple):
    """The boundary loops that a base is spanned between, one after the other.

    Their vertices (k, 3) in mm, their edges (k, 2) as indices of these points, the names of the
    parts that they belong to, and which of these each point belongs to (k,).
    """

    points: Floats
    sides: Integers
    names: tuple[str, ...]
    owner: Integers


# A base that ends on an outline: its vertices within (n, 3) in mm, and its triangles (m, 3) as
# indices of the outline's points and, after them, of these
Base = tuple[Floats, Integers]


def outline_of(parts: list[OpenSurface]) -> Outline:
    """Outline of a base between parts with one boundary loop each."""
    loops = [part.loops[0] for part in parts]
    points = [part.vertices[loop] for part, loop in zip(parts, loops, strict=True)]
    starts = np.cumsum([0, *map(len, loops)])
    numbers = [start + np.arange(len(loop)) for start, loop in zip(starts, loops, strict=False)]
    sides = [np.column_stack([of_loop, np.roll(of_loop, -1)]) for of_loop in numbers]
    owner = np.repeat(np.arange(len(parts)), list(map(len, loops)))
    return Outline(np.vstack(points), np.vstack(sides), tuple(part.what for part in parts), owner)


def made_base(outline: Outline, name: str) -> Base:
    """Span a smooth base between boundary loops.

    The loops are laid out in the plane that fits them best and triangulated there, with a regular
    grid of points between them. The heights of these over the plane are harmonic.

    Parameters
    ----------
    outline : Outline
        The loops.
    name : str
        What to call the whole in messages.

    Raises
    ------
    InputError
        If the loops, seen from the base, cross or almost touch.
    """
    flat, centre, frame = _flattened(outline)
    spacing = float(edge_lengths(flat, outline.sides).mean())
    low, high = flat.min(axis=0), flat.max(axis=0)
    rows = np.arange(low[1], high[1], spacing * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0], spacing)
    x = columns + spacing / 2 * (np.arange(len(rows)) % 2)[:, np.newaxis]
    grid = np.column_stack([x.ravel(), np.repeat(rows, len(columns))])
    grid = grid[cKDTree(flat[:, :2]).query(grid)[0] > CLEAR * spacing]
    inner, triangles = _triangulated(flat[:, :2], grid, outline, name)
    fixed = np.arange(len(flat))
    plane = np.vstack([flat, np.column_stack([inner, np.zeros(len(inner))])])
    heights = igl.harmonic(plane * [1, 1, 0], triangles, fixed, flat[:, 2:], 1)
    plane[len(flat) :, 2] = np.ravel(heights)[len(flat) :]
    return plane[len(flat) :] @ frame + centre, triangles


def fitted_base(outline: Outline, base: OpenSurface, name: str) -> Base:
    """Fit a given base to the boundary loops of the parts around it, which stay where they are.

    Where all boundary vertices coincide, nothing changes. Otherwise the vertices within the base
    and those of the loops are triangulated again in the plane that fits the loops best, and near
    the loops the base rises or sinks to their height.

    Parameters
    ----------
    outline : Outline
        The loops.
    base : OpenSurface
        The surface between, with three boundary loops.
    name : str
        What to call the whole in messages.

    Raises
    ------
    InputError
        If loops are farther apart than `LARGEST_GAP`; or if they do not coincide and the base,
        seen along its normal, folds over itself, or the loops cross.
    """
    boundary = np.concatenate(base.loops)
    within = np.setdiff1d(np.arange(len(base.vertices)), boundary)
    gap, nearest = cKDTree(outline.points).query(base.vertices[boundary])
    if gap.max() < SAME_POINT and np.array_equal(np.sort(nearest), np.arange(len(outline.points))):
        number = np.empty(len(base.vertices), dtype=np.int64)
        number[boundary] = nearest
        number[within] = len(boundary) + np.arange(len(within))
        return base.vertices[within], number[base.triangles]
    _check_gap(outline, base, boundary, name)
    flat, centre, frame = _flattened(outline)
    own = (base.vertices - centre) @ frame.T
    _check_unfolded(own, base, name)
    distance, nearest = cKDTree(flat[:, :2]).query(own[within, :2])
    clear = distance > CLEAR * mean_edge_length(base.vertices, base.triangles)
    within, distance, nearest = within[clear], distance[clear], nearest[clear]
    beside = boundary[cKDTree(own[boundary]).query(flat)[1]]
    rise = (flat[:, 2] - own[beside, 2])[nearest] * np.maximum(1 - distance / FADE, 0)
    own[within, 2] += rise
    inner, triangles = _triangulated(flat[:, :2], own[within, :2], outline, name)
    _, row = cKDTree(own[within, :2]).query(inner)
    return own[within[row]] @ frame + centre, triangles


def _flattened(outline: Outline) -> tuple[Floats, Floats, Floats]:
    """Points in the frame of the plane that fits them best, by length; its centre and axes."""
    centre, frame = best_plane(outline.points, edge_lengths(outline.points, outline.sides))
    return (outline.points - centre) @ frame.T, centre, frame


def _triangulated(
    places: Floats, inner: Floats, outline: Outline, name: str
) -> tuple[Floats, Integers]:
    """Triangles between the loops in a plane, and the inner points that they use."""
    count = len(places)
    loops = [np.flatnonzero(outline.owner == k) for k in range(len(outline.names))]
    triangles, missing = constrained_delaunay(np.vstack([places, inner]), loops)
    if missing.size:
        raise InputError(
            f"{name}: seen from the base, the boundary loop of "
            f"{outline.names[outline.owner[missing[0]]]} crosses or almost touches another or "
            f"itself about {place(outline.points[missing[0]])}, so no base fits between; trim the "
            "parts there"
        )
    inside = triangles >= count
    used, number = np.unique(triangles[inside], return_inverse=True)
    triangles[inside] = count + number
    return inner[used - count], triangles


def _check_gap(outline: Outline, base: OpenSurface, boundary: Integers, name: str) -> None:
    """Refuse a base whose boundary loops are not those of the parts."""
    edges, shared = unique_edges(base.triangles)
    to_base, _, _ = igl.point_mesh_squared_distance(
        outline.points, base.vertices, edges[shared == 1]
    )
    from_base, _, _ = igl.point_mesh_squared_distance(
        base.vertices[boundary], outline.points, outline.sides
    )
    _, nearest = cKDTree(outline.points).query(base.vertices[boundary])
    points = np.vstack([outline.points, base.vertices[boundary]])
    owner = np.concatenate([outline.owner, outline.owner[nearest]])
    gap = np.sqrt(np.concatenate([to_base, from_base]))
    for k, part in enumerate(outline.names):
        worst = int(np.argmax(np.where(owner == k, gap, 0)))
        if gap[worst] > LARGEST_GAP:
            raise InputError(
                f"{name}: the boundary loops of {part} and base are up to {gap[worst]:.1f} mm "
                f"apart (at {place(points[worst])}), more than {LARGEST_GAP:g} mm; bring them "
                "together, or give no base to have one made"
            )


def _check_unfolded(own: Floats, base: OpenSurface, name: str) -> None:
    a, b, c = (own[base.triangles[:, k], :2] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    folded = min(area[area > 0].sum(), -area[area < 0].sum()) / np.abs(area).sum()
    if folded > FOLDED:
        raise InputError(
            f"{name}: the boundary loops of the base do not meet those of the other parts, and it "
            f"cannot be fitted to them, as {folded:.0%} of it is folded over the rest; make them "
            "meet, or give no base to have one made"
        )
