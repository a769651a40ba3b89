"""A base where none was given: the surface between the three rims."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay, cKDTree

from fascicle.build.joining.boundary_loops import split_at
from fascicle.build.joining.parts import Part, point
from fascicle.core.errors import InputError

ROUNDS = 20  # of splitting sides that the triangulation does not have
CLEAR = 0.7  # of the spacing that inner points keep from the rims


@dataclass(frozen=True)
class _Outline:
    """A closed polygon in a plane, and which vertex of a rim each corner is (-1: new)."""

    places: NDArray[np.float64]
    own: NDArray[np.int64]
    points: NDArray[np.float64]

    def split(self, sides: NDArray[np.int64]) -> _Outline:
        """Insert the middle of sides, counted by their first corner."""
        after = sides + 1
        middle = [(x + np.roll(x, -1, axis=0))[sides] / 2 for x in (self.places, self.points)]
        return _Outline(
            np.insert(self.places, after, middle[0], axis=0),
            np.insert(self.own, after, -1),
            np.insert(self.points, after, middle[1], axis=0),
        )


def with_made_base(
    parts: list[Part], name: str
) -> tuple[list[Part], list[NDArray[np.int64]], Part, list[NDArray[np.int64]]]:
    """Span a base between the rims of the epicardium and the endocardia.

    The rims are laid out in the plane that fits them best and triangulated there; sides that a
    Delaunay triangulation does not have are halved until it has them. Heights follow the rims
    smoothly.

    Parameters
    ----------
    parts : list of Part
        Epicardium, LV and RV endocardium, each with one rim.
    name : str
        What to call the whole in messages.

    Returns
    -------
    parts : list of Part
        The same, with vertices added to edges of the rims where needed.
    corners : list of (k,) arrays
        The rims' vertices in them.
    base : Part
        The surface between.
    on_base : list of (k,) arrays
        The same rims' vertices in the base.

    Raises
    ------
    InputError
        If the rims, seen from the base, cross.
    """
    rims = [part.rims[0] for part in parts]
    points = [part.vertices[rim] for part, rim in zip(parts, rims, strict=True)]
    centre, frame = _plane(points)
    outlines = [_Outline(((p - centre) @ frame.T)[:, :2], np.arange(len(p)), p) for p in points]
    _check_disjoint(outlines, [part.what for part in parts], name)
    outlines, triangles, inner = _triangulated(outlines, name)
    rim_points = np.vstack([outline.points for outline in outlines])
    heights = _heights(triangles, (rim_points - centre) @ frame[2], len(inner))
    lifted = np.column_stack([inner, heights]) @ frame + centre
    base = Part("base", np.vstack([rim_points, lifted]), triangles)
    counts = np.cumsum([0, *(len(outline.own) for outline in outlines)])
    on_base = [np.arange(a, b) for a, b in pairwise(counts)]
    split = [
        split_at(part, rim, outline.own, outline.points)
        for part, rim, outline in zip(parts, rims, outlines, strict=True)
    ]
    return [part for part, _ in split], [corners for _, corners in split], base, on_base


def _plane(points: list[NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre and axes, the normal last, of the plane that fits all rims, by length."""
    weights = np.concatenate([np.linalg.norm(p - np.roll(p, 1, axis=0), axis=1) for p in points])
    whole = np.vstack(points)
    centre = weights @ whole / weights.sum()
    centred = np.sqrt(weights)[:, np.newaxis] * (whole - centre)
    return centre, np.linalg.svd(centred, full_matrices=False)[2]


def _check_disjoint(outlines: list[_Outline], names: list[str], name: str) -> None:
    """Refuse rims that cross themselves or one another, or endocardia outside the epicardium."""
    start = np.vstack([o.places for o in outlines])
    end = np.vstack([np.roll(o.places, -1, axis=0) for o in outlines])
    owner = np.repeat(np.arange(len(outlines)), [len(o.places) for o in outlines])
    points = np.vstack([o.points for o in outlines])
    for i in range(len(start)):
        crossed = _crossings(start[i], end[i], start[i + 1 :], end[i + 1 :])
        if crossed.size:
            one, other = names[owner[i]], names[owner[i + 1 + crossed[0]]]
            what = f" of {one} crosses itself" if one == other else f"s of {one} and {other} cross"
            raise InputError(
                f"{name}: seen from the base, the rim{what} about {point(points[i])} mm, so no "
                "base can be made; trim the rims or give a base"
            )
    for outline, what in zip(outlines[1:], names[1:], strict=True):
        if not _inside(outline.places[:1], outlines[0].places)[0]:
            raise InputError(
                f"{name}: the rim of {what} (about {point(outline.points.mean(axis=0))} mm) lies "
                "outside that of the epicardium; give parts of one heart, in one frame"
            )


def _crossings(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], d: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Which segments from c to d (k, 2) the one from a to b properly crosses."""

    def side(
        p: NDArray[np.float64], q: NDArray[np.float64], r: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        u, v = q - p, r - p
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    apart = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return np.flatnonzero(apart)


def _inside(points: NDArray[np.float64], polygon: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (k, 2) lie in a polygon, by counting the sides to their right."""
    x, y = points[:, 0, np.newaxis], points[:, 1, np.newaxis]
    xa, ya = polygon.T
    xb, yb = np.roll(polygon, -1, axis=0).T
    spans = (ya > y) != (yb > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = x < xa + (y - ya) * (xb - xa) / (yb - ya)
    return np.asarray((spans & right).sum(axis=1) % 2 == 1)


def _triangulated(
    outlines: list[_Outline], name: str
) -> tuple[list[_Outline], NDArray[np.int64], NDArray[np.float64]]:
    """Delaunay triangles between the outlines, which have all their sides, and inner points."""
    inner = _inner_points(outlines)
    for _ in range(ROUNDS):
        places = np.vstack([*(o.places for o in outlines), inner])
        triangles = np.asarray(Delaunay(places).simplices, dtype=np.int64)
        middle = places[triangles].mean(axis=1)
        kept = _inside(middle, outlines[0].places)
        for outline in outlines[1:]:
            kept &= ~_inside(middle, outline.places)
        missing = _missing_sides(outlines, triangles[kept])
        if not any(sides.size for sides in missing):
            return outlines, triangles[kept], inner
        outlines = [o.split(sides) for o, sides in zip(outlines, missing, strict=True)]
    raise InputError(
        f"{name}: no base could be made between the rims, which almost touch; trim the rims or "
        "give a base"
    )


def _inner_points(outlines: list[_Outline]) -> NDArray[np.float64]:
    """Corners of a triangular grid between the outlines, as far apart as the rims' vertices."""
    rim = np.vstack([o.places for o in outlines])
    spacing = float(
        np.mean(
            [
                np.linalg.norm(o.places - np.roll(o.places, 1, axis=0), axis=1).mean()
                for o in outlines
            ]
        )
    )
    low, high = rim.min(axis=0), rim.max(axis=0)
    rows = np.arange(low[1], high[1], spacing * np.sqrt(3) / 2)
    columns = np.arange(low[0], high[0], spacing)
    x = columns + spacing / 2 * (np.arange(len(rows)) % 2)[:, np.newaxis]
    grid = np.column_stack([x.ravel(), np.repeat(rows, len(columns))])
    grid = grid[cKDTree(rim).query(grid)[0] > CLEAR * spacing]
    kept = _inside(grid, outlines[0].places)
    for outline in outlines[1:]:
        kept &= ~_inside(grid, outline.places)
    return np.asarray(grid[kept])


def _missing_sides(
    outlines: list[_Outline], triangles: NDArray[np.int64]
) -> list[NDArray[np.int64]]:
    """Sides of each outline that are not an edge of just one triangle, by their first corner."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    there = {(int(a), int(b)) for a, b in edges[count == 1]}
    missing, offset = [], 0
    for outline in outlines:
        corners = offset + np.arange(len(outline.own))
        sides = np.sort(np.column_stack([corners, np.roll(corners, -1)]), axis=1)
        absent = [k for k, (a, b) in enumerate(sides.tolist()) if (a, b) not in there]
        missing.append(np.array(absent, dtype=np.int64))
        offset += len(corners)
    return missing


def _heights(
    triangles: NDArray[np.int64], rim: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Heights of `count` inner points over the plane (mm), each the mean of its neighbours'."""
    edges = np.unique(
        np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0
    )
    size = len(rim) + count
    half = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(size, size))
    whole = csr_array(half + half.T)
    laplacian = csr_array(diags_array(np.asarray(whole.sum(axis=1)).ravel()) - whole)
    free = np.arange(len(rim), size)
    pull = np.asarray(-(laplacian[free][:, : len(rim)] @ rim))
    return np.asarray(splu(csc_array(laplacian[free][:, free])).solve(pull))
