"""Separate surfaces of endocardia, epicardium and base, joined to one closed labelled surface."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.surface_checks import Surface
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.core.progress import StageProgress, no_progress
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.heart.validate import check_units
from fascicle.mesh.checks import check_edges, oriented_piece, place, refuse
from fascicle.mesh.measures import best_plane, edge_lengths, mean_edge_length, turned_outwards
from fascicle.mesh.meshing import constrained_delaunay
from fascicle.mesh.topology import (
    boundary_loops,
    fan,
    merged_vertices,
    unique_edges,
    whole_triangles,
    without_unused_vertices,
)

SAME_POINT = 1e-3  # mm; points closer than this are one (STL repeats them)
CLEAR = 0.7  # of the spacing that inner points of the base keep from the loops


class OpenSurface(NamedTuple):
    """An open surface (mm), one oriented manifold piece, its name in messages, boundary loops."""

    what: str
    vertices: Floats
    triangles: Integers
    loops: list[Integers]


class Outline(NamedTuple):
    """The boundary loops that a base is spanned between, one after the other.

    Their vertices (k, 3) in mm, their edges (k, 2), the names of the parts, and the index of the
    part that each vertex belongs to (k,).
    """

    points: Floats
    sides: Integers
    names: tuple[str, ...]
    owner: Integers


# A base bounded by an outline: its inner vertices (n, 3) in mm, and its triangles (m, 3) as indices
# into the outline's points followed by the inner vertices
Base = tuple[Floats, Integers]


def join_surfaces(
    lv: Surface,
    rv: Surface,
    epicardium: Surface,
    base: Surface | None,
    name: str,
    progress: StageProgress = no_progress,
) -> LabelledSurface:
    """Join separate surfaces of the ventricles to one that is closed.

    Endocardia and epicardium do not move. A base whose boundary loops lie within 2.5 mm of theirs
    is fitted to them; without a base, one is spanned between them.

    Parameters
    ----------
    lv, rv, epicardium : pair of (n, 3) and (m, 3) arrays
        Vertices (mm) and triangles; each open at the base, with one boundary loop. Points may be
        repeated and triangles turned either way.
    base : pair of (n, 3) and (m, 3) arrays, optional
        The surface between the loops.
    name : str
        Name of the surface in messages.
    progress : StageProgress
        Called with the steps done and in all.
    """
    parts = [
        _clean_part(*surface, name, what, 1)
        for surface, what in (
            (epicardium, "epicardium"),
            (lv, "LV endocardium"),
            (rv, "RV endocardium"),
        )
    ]
    given = None if base is None else _clean_part(*base, name, "base", 3)
    progress(1, 3)
    _check_places(name, *parts)
    progress(2, 3)
    outline = _outline_of(parts)
    inner, between = (
        _made_base(outline, name) if given is None else _fitted_base(outline, given, name)
    )
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    number = [part.loops[0] + start for part, start in zip(parts, starts, strict=False)]
    number.append(starts[-1] + np.arange(len(inner)))
    triangles = [part.triangles + start for part, start in zip(parts, starts, strict=False)]
    triangles.append(np.concatenate(number)[between])
    vertices = np.vstack([*(part.vertices for part in parts), inner])
    whole = np.vstack(triangles)
    check_edges(name, vertices, whole, "give no base to have one made")
    whole = turned_outwards(vertices, oriented_piece(name, vertices, whole))
    labels = (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.BASE)
    of_triangles = np.repeat(labels, list(map(len, triangles))).astype(np.int64)
    progress(3, 3)
    return LabelledSurface(vertices, whole, of_triangles, name)


def _clean_part(
    vertices: Floats, triangles: Integers, whole: str, what: str, needed: int
) -> OpenSurface:
    """A part in mm with repeated points merged, one manifold piece with the loops that it needs."""
    name = f"{whole}: {what}"
    check_units(name, vertices[np.unique(triangles)])
    merged = merged_vertices(vertices, SAME_POINT)[triangles]
    points, triangles = without_unused_vertices(vertices, merged[whole_triangles(merged)])
    check_edges(name, points, triangles)
    triangles = oriented_piece(name, points, triangles)
    loops = boundary_loops(triangles)
    touching = sum(np.unique(loop).size != loop.size for loop in loops)
    if len(loops) == needed and not touching:
        return OpenSurface(what, points, triangles, loops)
    loops.sort(key=len, reverse=True)
    where = ", ".join(
        f"{len(loop)} vertices about {place(points[loop].mean(axis=0))}" for loop in loops[:4]
    )
    found = f"{len(loops)} boundary loops ({where}{', ...' if len(loops) > 4 else ''})"
    if not loops:
        found = "no boundary loop (it is closed)"
    elif touching:
        found += f", {touching} of which touch themselves"
    kind = "it must be open at the base, with one boundary loop"
    if needed == 3:
        kind = "it must have three: one towards the epicardium and one around each cavity"
    raise InputError(f"{name}: the surface has {found}; {kind}")


def _check_places(name: str, epicardium: OpenSurface, lv: OpenSurface, rv: OpenSurface) -> None:
    """Refuse endocardia that leave the epicardium, or reach into one another, below the base.

    Openings are closed by fans, which leave the winding number close to 0 or 1 below the base.
    """
    for part, outer, other in ((lv, epicardium, rv), (rv, epicardium, lv)):
        distance, _ = cKDTree(part.vertices[part.loops[0]]).query(part.vertices)
        deep = distance > 10.0  # mm; nearer to the base the fan's shape matters
        for bad, where in (
            (deep & (_winding(outer, part.vertices) < 0.6), "outside the epicardium"),
            (deep & (_winding(other, part.vertices) > 0.4), f"within the {other.what}"),
        ):
            remedy = "give parts of one heart, in one frame, that do not cross"
            refuse(f"{name}: {part.what}", bad, f"vertices lie {where}", remedy, part.vertices)


def _winding(part: OpenSurface, points: Floats) -> Floats:
    """Winding number of a part, closed by a fan over its opening, about points; 0 outside it."""
    loop = part.loops[0]
    vertices = np.vstack([part.vertices, part.vertices[loop].mean(axis=0)])
    triangles = np.vstack([part.triangles, fan(loop, len(part.vertices))])
    around = igl.fast_winding_number(vertices, triangles, np.ascontiguousarray(points))
    return np.asarray(np.abs(around))


def _outline_of(parts: list[OpenSurface]) -> Outline:
    """Outline of a base between parts with one boundary loop each."""
    loops = [part.loops[0] for part in parts]
    points = [part.vertices[loop] for part, loop in zip(parts, loops, strict=True)]
    starts = np.cumsum([0, *map(len, loops)])
    numbers = [start + np.arange(len(loop)) for start, loop in zip(starts, loops, strict=False)]
    sides = [np.column_stack([of_loop, np.roll(of_loop, -1)]) for of_loop in numbers]
    owner = np.repeat(np.arange(len(parts)), list(map(len, loops)))
    return Outline(np.vstack(points), np.vstack(sides), tuple(part.what for part in parts), owner)


def _made_base(outline: Outline, name: str) -> Base:
    """Span a smooth base between boundary loops.

    The loops are laid out in the plane that fits them best and triangulated there, with a regular
    grid of points between them. The heights of these over the plane are harmonic.
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


def _fitted_base(outline: Outline, base: OpenSurface, name: str) -> Base:
    """Fit a given base to the boundary loops of the parts around it, which stay where they are.

    Where all boundary vertices coincide, nothing changes. Otherwise the vertices within the base
    and those of the loops are triangulated again in the plane that fits the loops best, and within
    7.5 mm of the loops the base rises or sinks to their height.
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
    a, b, c = own[base.triangles, :2].transpose(1, 2, 0)
    area = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
    folded = min(area[area > 0].sum(), -area[area < 0].sum()) / np.abs(area).sum()
    if folded > 0.05:
        raise InputError(
            f"{name}: the boundary loops of the base do not meet those of the other parts, and it "
            f"cannot be fitted to them, as {folded:.0%} of it is folded over the rest; make them "
            "meet, or give no base to have one made"
        )
    distance, nearest = cKDTree(flat[:, :2]).query(own[within, :2])
    clear = distance > CLEAR * mean_edge_length(base.vertices, base.triangles)
    within, distance, nearest = within[clear], distance[clear], nearest[clear]
    opposite = boundary[cKDTree(own[boundary]).query(flat)[1]]
    rise = (flat[:, 2] - own[opposite, 2])[nearest] * np.maximum(1 - distance / 7.5, 0)
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
    """Refuse a base whose boundary loops are more than 2.5 mm from those of the parts."""
    edges, shared = unique_edges(base.triangles)
    rim = base.vertices[boundary]
    to_base = igl.point_mesh_squared_distance(outline.points, base.vertices, edges[shared == 1])
    from_base = igl.point_mesh_squared_distance(rim, outline.points, outline.sides)
    _, nearest = cKDTree(outline.points).query(rim)
    points = np.vstack([outline.points, rim])
    owner = np.concatenate([outline.owner, outline.owner[nearest]])
    gap = np.sqrt(np.concatenate([to_base[0], from_base[0]]))
    worst = int(np.argmax(gap))
    if gap[worst] > 2.5:
        raise InputError(
            f"{name}: the boundary loops of {outline.names[owner[worst]]} and base are up to "
            f"{gap[worst]:.1f} mm apart (at {place(points[worst])}), more than 2.5 mm; bring them "
            "together, or give no base to have one made"
        )
