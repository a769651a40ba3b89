"""Repair of closed labelled surfaces; other defects are refused with their position."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import igl
import numpy as np
from scipy.ndimage import distance_transform_edt

from fascicle.build.endocardia import cleaned_labels
from fascicle.build.level_sets import closed_by
from fascicle.build.surface_checks import check_sides
from fascicle.core.arrays import Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import ENDOCARDIA, LabelledSurface, missing_parts
from fascicle.mesh.checks import (
    check_edges,
    check_units,
    first_places,
    oriented_piece,
    place,
    refuse,
)
from fascicle.mesh.measures import closed_volume, loop_length, self_intersections, turned_outwards
from fascicle.mesh.meshing import marching_cubes
from fascicle.mesh.topology import (
    boundary_loops,
    directed_edges,
    fan,
    merged_vertices,
    unique_edges,
    whole_triangles,
    without_unused_vertices,
)

LARGEST_CRUMB = 10.0  # mm, largest extent of a piece or a void that is left out or filled


def prepared_surface(surface: LabelledSurface) -> LabelledSurface:
    """Make a labelled surface closed, in one piece, without self-intersections, facing outwards.

    Repeated vertices and triangles, triangles of zero area, vertices and edges in which the
    surface touches itself, pieces of at most 10 mm, holes with a boundary of at most 20 mm,
    triangles facing the wrong way and small components of labels are repaired. A surface
    that intersects itself is replaced by that of its interior. Other defects are refused.
    """
    if missing := missing_parts(surface.labels):
        numbers = ", ".join(str(number) for number in np.unique(surface.labels))
        raise InputError(
            f"{surface.name}: no triangle is labelled {' or '.join(missing)} (labels there: "
            f"{numbers}); label base 1, epicardium 2, LV 3, RV 4 (all are needed), or say which "
            "number is what (--labels)"
        )
    closed = closed_surface(surface)
    if len(cuts := self_intersections(closed.vertices, closed.triangles)):
        closed = _without_cuts(closed, cuts)
    labels = cleaned_labels(closed.vertices, closed.triangles, closed.labels)
    cleaned = replace(closed, labels=labels)
    for label in ENDOCARDIA:
        name = f"{surface.name}: {label.words}"
        if not boundary_loops(oriented_piece(name, cleaned.vertices, cleaned.having(label))):
            raise InputError(f"{name}: the surface is closed; it must be open at the base")
    check_sides(cleaned)
    return cleaned


def closed_surface(surface: LabelledSurface) -> LabelledSurface:
    """Merge repeated vertices, drop broken triangles, close small holes and face outwards."""
    check_units(surface.name, surface.vertices)
    merged = merged_vertices(surface.vertices)[surface.triangles]
    valid = whole_triangles(merged)
    merged_surface = replace(surface, triangles=merged[valid], labels=surface.labels[valid])
    one_piece = _without_crumbs(_separated(_without_sheets(compacted(merged_surface))))
    return oriented_outwards(_with_holes_filled(one_piece))


def _without_sheets(surface: LabelledSurface) -> LabelledSurface:
    """Leave out sheets that end on the surface: small patches with open edges where it forks."""
    patches, patch = igl.extract_manifold_patches(surface.triangles)
    sizes = np.bincount(np.asarray(patch))
    edges = np.sort(directed_edges(surface.triangles), axis=1)
    _, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    times = count[which.ravel()].reshape(-1, 3)
    forked, is_open = (
        np.bincount(patch, edge.any(axis=1), patches) > 0 for edge in (times > 2, times < 2)
    )
    sheets = np.flatnonzero(forked & is_open & (sizes < sizes.max()))
    if not len(sheets):
        return surface
    return _without_pieces(surface, np.asarray(patch), sheets, "sheets that ended on it")


def _without_pieces(
    surface: LabelledSurface, piece: Integers, numbers: Integers, name: str
) -> LabelledSurface:
    """Leave out the pieces of these numbers, by the piece (m,) of each triangle; with a note."""
    left_out = np.isin(piece, numbers)
    corners = surface.vertices[surface.triangles]
    middles = np.array([corners[piece == k].mean(axis=(0, 1)) for k in numbers[:3]])
    note = (
        f"surface: {name} were left out: {len(numbers)} (first: {first_places(numbers, middles)}), "
        f"with {left_out.sum()} of {len(piece)} triangles"
    )
    remaining = replace(
        surface, triangles=surface.triangles[~left_out], labels=surface.labels[~left_out]
    )
    return compacted(replace(remaining, notes=(*surface.notes, note)))


def _separated(surface: LabelledSurface) -> LabelledSurface:
    """Double vertices and edges in which the surface touches itself, and move the copies apart.

    Each copy moves a tenth of the way to the mean of its neighbours. Nothing changes if that would
    open the surface, as along a sheet that ends on it.
    """
    oriented, _ = igl.bfs_orient(surface.triangles)
    triangles, origin = (np.asarray(array) for array in igl.split_nonmanifold(oriented))
    before, after = (unique_edges(cells)[1] for cells in (surface.triangles, triangles))
    copied = np.bincount(origin, minlength=len(surface.vertices)) > 1
    if not copied.any() or (after == 1).sum() > (before == 1).sum():
        return surface
    vertices, moving = surface.vertices[origin], copied[origin]
    around = np.asarray(igl.adjacency_matrix(triangles) @ vertices)
    degree = np.bincount(unique_edges(triangles)[0].ravel(), minlength=len(vertices))
    vertices[moving] += 0.1 * (around / degree[:, None] - vertices)[moving]
    at = np.flatnonzero(copied)
    note = (
        f"surface: vertices in which it touched itself were doubled and moved apart: {len(at)} of "
        f"{len(copied)} (first: {first_places(at, surface.vertices[at])})"
    )
    return replace(surface, vertices=vertices, triangles=triangles, notes=(*surface.notes, note))


def small_pieces(piece: Integers, corners: Floats) -> Integers:
    """Numbers of the pieces of at most `LARGEST_CRUMB`, except the piece with the most cells.

    `piece` (m,) is the piece of each cell, `corners` (m, k, 3) are its positions (mm).
    """
    sizes = np.bincount(piece)
    high = np.full((len(sizes), 3), -np.inf)
    low = -high
    np.maximum.at(high, piece, corners.max(axis=1))
    np.minimum.at(low, piece, corners.min(axis=1))
    small = (high - low).max(axis=1) <= LARGEST_CRUMB
    small[sizes.argmax()] = False
    return np.flatnonzero(small)


def _without_crumbs(surface: LabelledSurface) -> LabelledSurface:
    """Leave out small pieces: crumbs, and the surfaces of voids in the tissue."""
    piece = np.asarray(igl.facet_components(surface.triangles)[1])
    corners = surface.vertices[surface.triangles]
    if not (small := small_pieces(piece, corners)).size:
        return surface
    return _without_pieces(surface, piece, small, f"pieces of at most {LARGEST_CRUMB:g} mm")


def compacted(surface: LabelledSurface) -> LabelledSurface:
    """Leave out vertices that no triangle uses."""
    vertices, triangles = without_unused_vertices(surface.vertices, surface.triangles)
    return replace(surface, vertices=vertices, triangles=triangles)


def _with_holes_filled(surface: LabelledSurface) -> LabelledSurface:
    """Close small holes by a fan of triangles, with the label of most triangles around."""
    check_edges(surface.name, surface.vertices, surface.triangles)
    vertices, labels = surface.vertices, surface.labels
    which = "one (cavities must be open at the base)"
    triangles = oriented_piece(surface.name, vertices, surface.triangles, which)
    loops = boundary_loops(triangles)
    holes = [(loop_length(vertices, loop), vertices[loop].mean(axis=0)) for loop in loops]
    longest = 20.0  # mm around, 6 mm across, so no valve or vessel is closed over
    if large := [hole for hole in holes if hole[0] > longest]:
        where = ", ".join(f"{length:.0f} mm around at {place(at)}" for length, at in large[:3])
        raise InputError(
            f"{surface.name}: the surface is not closed: {len(large)} of {len(loops)} holes are "
            f"too large to be closed here ({where}; up to {longest:g} mm are); close them"
        )
    for loop, (_, middle) in zip(loops, holes, strict=True):
        filling = loop[::-1][None]
        if len(loop) > 3:
            filling, vertices = fan(loop, len(vertices)), np.vstack([vertices, middle])
        around = surface.labels[np.isin(surface.triangles, loop).sum(axis=1) >= 2]
        triangles = np.concatenate([triangles, filling])
        labels = np.append(labels, np.full(len(filling), np.bincount(around).argmax()))
    return replace(surface, vertices=vertices, triangles=triangles, labels=labels)


def oriented_outwards(surface: LabelledSurface) -> LabelledSurface:
    """Turn the triangles of a closed surface in one piece so that they face outwards."""
    check_edges(surface.name, surface.vertices, surface.triangles)
    triangles = oriented_piece(surface.name, surface.vertices, surface.triangles)
    bad = ~np.asarray(igl.is_vertex_manifold(triangles)).ravel()
    fault, remedy = "vertices are where the surface touches itself", "separate the parts there"
    refuse(surface.name, bad, fault, remedy, surface.vertices)
    return replace(surface, triangles=turned_outwards(surface.vertices, triangles))


class SampledDistance(NamedTuple):
    """Signed distance (mm) to the surface of tissue, negative inside, at the nodes of a grid.

    The first node is at `origin`, and neighbours are `edge` (mm) apart.
    """

    values: Floats
    origin: Floats
    edge: float

    @classmethod
    def of(
        cls, vertices: Floats, triangles: Integers, box: tuple[Floats, Floats], margin: float = 0.0
    ) -> SampledDistance:
        """Sample triangles that face outwards, with nodes 1/150 of the diagonal of a box apart.

        Triangles may intersect: inside is where their winding number is above a half (Barill et al.
        2018). The box is two opposite corners (mm); two nodes and a margin (mm) lie around it.
        """
        low, high = box
        edge = float(np.linalg.norm(high - low)) / 150
        around = 2 + int(np.ceil(margin / edge))
        shape = np.ceil((high - low) / edge).astype(np.int64) + 2 * around + 1
        origin = low - edge * around
        places = origin + edge * np.indices(tuple(shape.tolist())).reshape(3, -1).T
        near = (places > vertices.min(axis=0)) & (places < vertices.max(axis=0))
        inside = np.zeros(len(places), dtype=bool)
        inside[near.all(axis=1)] = (
            igl.fast_winding_number(vertices, triangles, places[near.all(axis=1)]) > 0.5
        )
        grid = inside.reshape(shape)
        values = edge * (distance_transform_edt(~grid) - distance_transform_edt(grid)).ravel()
        close = np.abs(values) < max(2.5 * edge, 2.0)  # mm; beyond, an edge does not matter
        exact = np.sqrt(igl.point_mesh_squared_distance(places[close], vertices, triangles)[0])
        values[close] = np.where(inside[close], -exact, exact)
        return cls(values.reshape(shape), origin, edge)

    def closed(self, radius: float) -> SampledDistance:
        """Morphological closing with a ball (mm)."""
        return self._replace(values=closed_by(self.values, radius, self.edge))

    def surface(self) -> tuple[Floats, Integers]:
        """Vertices (n, 3) (mm) and triangles (m, 3) of the largest surface around the tissue."""
        # a node is at least a twentieth of an edge from the surface, which avoids slivers
        away = np.maximum(np.abs(self.values), self.edge / 20)
        index, triangles = marching_cubes(np.where(self.values < 0, -away, away))
        _, pieces = igl.facet_components(triangles)
        largest = triangles[pieces == np.bincount(pieces).argmax()]
        index, triangles = without_unused_vertices(index, largest)
        return self.origin + self.edge * index, triangles


def _without_cuts(surface: LabelledSurface, cuts: Integers) -> LabelledSurface:
    """Replace a surface that intersects itself by that of its interior, with the nearest labels.

    It is extracted by marching cubes from the signed distance, whose sign is that of the winding
    number (Barill et al. 2018, ACM Trans Graph 37:43), at nodes 1/150 of the diagonal apart.
    """
    box = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    vertices, triangles = SampledDistance.of(surface.vertices, surface.triangles, box).surface()
    middle = vertices[triangles].mean(axis=1)
    _, nearest, _ = igl.point_mesh_squared_distance(middle, surface.vertices, surface.triangles)
    try:
        drawn = oriented_outwards(
            replace(surface, vertices=vertices, triangles=triangles, labels=surface.labels[nearest])
        )
        before, after = (closed_volume(s.vertices, s.triangles) for s in (surface, drawn))
        if abs(after / before - 1) > 0.02:
            raise InputError(f"the volume changed by {after / before - 1:+.0%}")
        if igl.euler_characteristic(triangles) != igl.euler_characteristic(surface.triangles):
            raise InputError("there would be a hole through a wall")
    except InputError as error:
        bad = np.unique(cuts)
        at = first_places(bad, surface.vertices[surface.triangles[bad]])
        raise InputError(
            f"{surface.name}: {len(bad)} triangles cut through one another (first: {at}), and the "
            f"repair failed: {str(error).removeprefix(f'{surface.name}: ')}; remesh the surface "
            "there"
        ) from None
    return drawn
