"""Separate surfaces of endocardia, epicardium and base, joined to one closed labelled surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import igl
import numpy as np
from scipy.spatial import cKDTree

from fascicle.build.segmentation import Segmentation
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.checks import check_edges, check_units, open_loops, oriented_piece, place, refuse
from fascicle.mesh.measures import best_plane, edge_lengths, turned_outwards, winding_number
from fascicle.mesh.meshing import constrained_delaunay
from fascicle.mesh.topology import (
    merged_vertices,
    unique_edges,
    whole_triangles,
    without_unused_vertices,
)


class JoinedPart(NamedTuple):
    """Surface that a heart is joined from: its name in messages, vertices and triangles.

    Vertices (n, 3) are in mm; points may be repeated and triangles (m, 3) turned either way. Once
    cleaned, it is one oriented manifold piece with its boundary loops.
    """

    name: str
    vertices: Floats
    triangles: Integers
    loops: Sequence[Integers] = ()


@dataclass(frozen=True)
class Outline:
    """Boundary loops, concatenated, between which a base is spanned.

    Vertices (k, 3) in mm, edges (k, 2), the names of the parts, and the index of the part that each
    vertex belongs to (k,).
    """

    points: Floats
    sides: Integers
    names: tuple[str, ...]
    owner: Integers

    @classmethod
    def of(cls, parts: Sequence[JoinedPart]) -> Outline:
        """Outline of parts with one boundary loop each."""
        loops = [part.loops[0] for part in parts]
        points = [part.vertices[loop] for part, loop in zip(parts, loops, strict=True)]
        starts = np.cumsum([0, *map(len, loops)])
        numbers = [start + np.arange(len(loop)) for start, loop in zip(starts, loops, strict=False)]
        sides = [np.column_stack([of_loop, np.roll(of_loop, -1)]) for of_loop in numbers]
        owner = np.repeat(np.arange(len(parts)), list(map(len, loops)))
        names = tuple(part.name for part in parts)
        return cls(np.vstack(points), np.vstack(sides), names, owner)


# A base bounded by an outline: its inner vertices (n, 3) in mm, and its triangles (m, 3) as indices
# into the outline's points followed by the inner vertices
Base = tuple[Floats, Integers]


def join_surfaces(parts: Mapping[str, JoinedPart]) -> LabelledSurface:
    """Join separate surfaces of the ventricles to one closed surface.

    Endocardia and epicardium do not move. Without a base, or if its boundary loops, which may be up
    to 2.5 mm from theirs, have other vertices, one is spanned between them.

    Parts are ``lv``, ``rv`` and ``epicardium``, each open at the base, with one boundary loop; and
    perhaps the ``base`` between the loops.
    """
    name = ", ".join(part.name for part in parts.values())
    clean = _clean_shells(parts)
    base = _clean_part(parts["base"], "base", 3) if "base" in parts else None
    _check_places(*clean)
    outline = Outline.of(clean)
    welded = None if base is None else _welded_base(outline, base)
    inner, between = _made_base(outline) if welded is None else welded
    starts = np.cumsum([0, *(len(part.vertices) for part in clean)])
    number = [part.loops[0] + start for part, start in zip(clean, starts, strict=False)]
    number.append(starts[-1] + np.arange(len(inner)))
    triangles = [part.triangles + start for part, start in zip(clean, starts, strict=False)]
    triangles.append(np.concatenate(number)[between])
    vertices = np.vstack([*(part.vertices for part in clean), inner])
    joined = np.vstack(triangles)
    check_edges(name, vertices, joined, "give no base to have one made")
    joined = turned_outwards(vertices, oriented_piece(name, vertices, joined))
    labels = (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.BASE)
    of_triangles = np.repeat(labels, list(map(len, triangles))).astype(np.int64)
    return LabelledSurface(vertices, joined, of_triangles, name)


def label_map_beside_lv(parts: Mapping[str, JoinedPart]) -> Segmentation | None:
    """Label map of parts whose epicardium is the LV's alone; None if it encloses the RV, too.

    Atlases of short-axis images have the RV's blood beside a shell of the LV's muscle. Voxels of
    1.5 mm have the numbers of `SegmentationLabels`. The parts are those of `join_surfaces`.
    """
    epicardium, lv, rv = (part[1:3] for part in _clean_shells(parts))
    inside = [(winding_number(*epicardium, vertices) > 0.5).mean() for vertices, _ in (lv, rv)]
    apart, _ = cKDTree(epicardium[0]).query(rv[0])
    if inside[0] < 0.9 or inside[1] > 0.5 or apart.min() > 10.0:  # mm
        return None
    points, affine = np.concatenate([epicardium[0], rv[0]]), np.diag([1.5, 1.5, 1.5, 1.0])
    affine[:3, 3] = points.min(axis=0)
    shape = tuple(np.ceil(np.ptp(points, axis=0) / 1.5).astype(int).tolist())
    voxels = 1.5 * np.indices(shape).reshape(3, -1).T + affine[:3, 3]
    within = [winding_number(*part, voxels) > 0.5 for part in (lv, epicardium, rv)]
    labels = np.select(within, [1, 3, 2]).reshape(shape)
    name = f"{parts['rv'].name}, outside {parts['epicardium'].name}"
    return Segmentation(labels, affine, name, segments={1: "LV", 2: "RV", 3: "LV muscle"})


def _clean_shells(parts: Mapping[str, JoinedPart]) -> list[JoinedPart]:
    """Epicardium, LV and RV, as `_clean_part` gives them."""
    kinds = {"epicardium": "epicardium", "lv": "LV endocardium", "rv": "RV endocardium"}
    return [_clean_part(parts[part], kind, 1) for part, kind in kinds.items()]


def _clean_part(part: JoinedPart, kind: str, needed: int) -> JoinedPart:
    """Merge repeated points of a part (mm); an error if not one piece with the loops it needs."""
    name, vertices = f"{part.name} ({kind})", part.vertices
    check_units(name, vertices[np.unique(part.triangles)])
    merged = merged_vertices(vertices, 1e-3)[part.triangles]  # mm; STL repeats points
    points, triangles = without_unused_vertices(vertices, merged[whole_triangles(merged)])
    check_edges(name, points, triangles)
    triangles = oriented_piece(name, points, triangles)
    return JoinedPart(name, points, triangles, open_loops(name, points, triangles, needed))


def _check_places(epicardium: JoinedPart, lv: JoinedPart, rv: JoinedPart) -> None:
    """Refuse endocardia that leave the epicardium, or reach into one another, below the base.

    Openings are closed by fans, which leave the winding number close to 0 or 1 below the base.
    """
    remedy = "give parts of one heart, in one frame, that do not cross, each to its own option"
    for part, other in ((lv, rv), (rv, lv)):
        distance, _ = cKDTree(part.vertices[part.loops[0]]).query(part.vertices)
        deep = distance > 10.0  # mm; nearer to the base the fan's shape matters
        outside = deep & (winding_number(*epicardium[1:3], part.vertices) < 0.6)
        within = deep & (winding_number(*other[1:3], part.vertices) > 0.4)
        fault = f"vertices lie outside {epicardium.name}"
        refuse(part.name, outside, fault, remedy, part.vertices)
        refuse(part.name, within, f"vertices lie within {other.name}", remedy, part.vertices)


def _made_base(outline: Outline) -> Base:
    """Span a smooth base between boundary loops.

    The loops are projected onto the plane that fits them best and triangulated there, with a
    regular grid of points between them, whose heights over the plane are harmonic.
    """
    flat, centre, frame = _flattened(outline)
    spacing = float(edge_lengths(flat, outline.sides).mean())
    low, high = flat.min(axis=0), flat.max(axis=0)
    rows = np.arange(low[1], high[1], spacing * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0], spacing)
    x = columns + spacing / 2 * (np.arange(len(rows)) % 2)[:, np.newaxis]
    grid = np.column_stack([x.ravel(), np.repeat(rows, len(columns))])
    grid = grid[cKDTree(flat[:, :2]).query(grid)[0] > 0.7 * spacing]  # clear of the loops
    inner, triangles = _triangulated(flat[:, :2], grid, outline)
    fixed = np.arange(len(flat))
    plane = np.vstack([flat, np.column_stack([inner, np.zeros(len(inner))])])
    heights = igl.harmonic(plane * [1, 1, 0], triangles, fixed, flat[:, 2:], 1)
    plane[len(flat) :, 2] = np.ravel(heights)[len(flat) :]
    return plane[len(flat) :] @ frame + centre, triangles


def _welded_base(outline: Outline, base: JoinedPart) -> Base | None:
    """Base whose boundary vertices are those of the parts around it; None if they are not.

    InputError if the parts' loops are more than 2.5 mm from those of the base.
    """
    boundary = np.concatenate(base.loops)
    gap, nearest = cKDTree(outline.points).query(base.vertices[boundary])
    if gap.max() > 1e-3 or not np.array_equal(np.sort(nearest), np.arange(len(outline.points))):
        edges, shared = unique_edges(base.triangles)
        rim = base.vertices, edges[shared == 1]
        apart = np.sqrt(igl.point_mesh_squared_distance(outline.points, *rim)[0])
        if apart[worst := int(np.argmax(apart))] > 2.5:
            raise InputError(
                f"{base.name}: its boundary loops and that of "
                f"{outline.names[outline.owner[worst]]} are up to {apart[worst]:.1f} mm apart (at "
                f"{place(outline.points[worst])}), more than 2.5 mm; bring them together, or give "
                "no base to have one made"
            )
        return None
    within = np.setdiff1d(np.arange(len(base.vertices)), boundary)
    number = np.empty(len(base.vertices), dtype=np.int64)
    number[boundary] = nearest
    number[within] = len(boundary) + np.arange(len(within))
    return base.vertices[within], number[base.triangles]


def _flattened(outline: Outline) -> tuple[Floats, Floats, Floats]:
    """Points in the frame of their best plane, weighted by length; its centre and axes."""
    centre, frame = best_plane(outline.points, edge_lengths(outline.points, outline.sides))
    return (outline.points - centre) @ frame.T, centre, frame


def _triangulated(places: Floats, inner: Floats, outline: Outline) -> tuple[Floats, Integers]:
    """Inner points that are used, and triangles between the loops, in a plane."""
    count = len(places)
    loops = [np.flatnonzero(outline.owner == k) for k in range(len(outline.names))]
    triangles, missing = constrained_delaunay(np.vstack([places, inner]), loops)
    if missing.size:
        where = ", ".join(map(place, outline.points[missing[:3]]))
        raise InputError(
            f"{outline.names[outline.owner[missing[0]]]}: seen from the base, its boundary loop "
            f"crosses or almost touches another or itself about {where}, so no base fits between; "
            "trim the parts there"
        )
    inside = triangles >= count
    used, number = np.unique(triangles[inside], return_inverse=True)
    triangles[inside] = count + number
    return inner[used - count], triangles
