"""Separate surfaces of endocardia, epicardium and base, joined to one closed labelled surface."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fascicle.build.classification.ambient_occlusion import Told
from fascicle.build.classification.sides import leftness
from fascicle.build.joining.base import with_made_base
from fascicle.build.joining.boundary_loops import common_knots, rim_distance, split_at
from fascicle.build.joining.parts import Part, clean_part, point
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledSurface

Surface = tuple[NDArray[np.float64], NDArray[np.int64]]

NAMES = ("epicardium", "LV endocardium", "RV endocardium")
LABELS = (Label.EPICARDIUM, Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.BASE)
RIM_ZONE = 10.0  # mm from its rim within which an endocardium may stand out of the epicardium's
SWAPPED = -0.5  # `leftness` of the left endocardium below which the two are taken for swapped
STAGES = 4


def join_surfaces(
    lv: Surface,
    rv: Surface,
    epicardium: Surface,
    base: Surface | None,
    name: str,
    told: Told | None = None,
) -> LabelledSurface:
    """Join separate surfaces of the ventricles to one that is closed.

    Rims that are the same within 2.5 mm are brought to one polygon halfway between them, and the
    surfaces near them follow smoothly; where vertices already coincide, nothing moves. Without a
    base, one is spanned between the three rims.

    Parameters
    ----------
    lv, rv, epicardium : pair of (n, 3) and (m, 3) arrays
        Vertices (mm) and triangles; each open at the base, with one rim. Points may be repeated
        and triangles turned either way.
    base : pair of (n, 3) and (m, 3) arrays, optional
        The surface between the rims.
    name : str
        What to call the whole in messages.
    told : callable, optional
        Told steps done and in all.

    Returns
    -------
    LabelledSurface
        Closed, manifold, facing out of the tissue.

    Raises
    ------
    InputError
        If a part has several pieces or another number of rims than it must, the parts do not lie
        within one another as those of a heart do, left and right are swapped, rims are too far
        apart, or the coordinates are not in mm.
    """
    parts = [
        clean_part(*surface, f"{name}: {what}", 1)
        for surface, what in zip((epicardium, lv, rv), NAMES, strict=True)
    ]
    whole = None if base is None else clean_part(*base, f"{name}: base", 3)
    _tell(told, 1)
    _check_places(parts, name)
    _check_sides(parts, name)
    _tell(told, 2)
    parts = [replace(part, what=what) for what, part in zip(NAMES, parts, strict=True)]
    if whole is None:
        parts, corners, whole, on_base = with_made_base(parts, name)
    else:
        parts, corners, whole, on_base = _brought_together(parts, whole, name)
    _tell(told, 3)
    result = _sewn(parts, corners, whole, on_base, name)
    _tell(told, STAGES)
    return result


def _tell(told: Told | None, done: int) -> None:
    if told is not None:
        told(done, STAGES)


def _check_places(parts: list[Part], name: str) -> None:
    """Refuse endocardia that leave the epicardium, or reach into one another, below their rims."""
    epicardium, lv, rv = parts
    for part, what in ((lv, NAMES[1]), (rv, NAMES[2])):
        outside = _deep(part) & (_winding(epicardium, part.vertices) < 0.6)
        _refuse_if(outside, part, f"{name}: {what}", "outside the epicardium")
    within = _deep(lv) & (_winding(rv, lv.vertices) > 0.4)
    _refuse_if(within, lv, f"{name}: {NAMES[1]}", "within the RV endocardium")
    within = _deep(rv) & (_winding(lv, rv.vertices) > 0.4)
    _refuse_if(within, rv, f"{name}: {NAMES[2]}", "within the LV endocardium")


def _refuse_if(bad: NDArray[np.bool_], part: Part, what: str, where: str) -> None:
    if bad.any():
        first = part.vertices[np.argmax(bad)]
        raise InputError(
            f"{what}: {int(bad.sum())} of {len(bad)} vertices lie {where} (first at "
            f"{point(first)} mm); give parts of one heart, in one frame, that do not cross"
        )


def _deep(part: Part) -> NDArray[np.bool_]:
    """Which vertices are farther from the rim than the zone where a cap's shape matters."""
    distance, _ = cKDTree(part.vertices[part.rims[0]]).query(part.vertices)
    return np.asarray(distance > RIM_ZONE)


def _winding(part: Part, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """How often a part, closed by a fan over its rim, goes around points; about 0 outside it."""
    rim = part.rims[0]
    centre = len(part.vertices)
    fan = np.column_stack([np.roll(rim, -1), rim, np.full(len(rim), centre)])
    vertices = np.vstack([part.vertices, part.vertices[rim].mean(axis=0)])
    triangles = np.vstack([part.triangles, fan])
    around = igl.fast_winding_number(vertices, triangles, np.ascontiguousarray(points))
    return np.asarray(np.abs(around))


def _check_sides(parts: list[Part], name: str) -> None:
    epicardium, lv, rv = [(part.vertices, part.triangles) for part in parts]
    if leftness(lv, rv, epicardium) < SWAPPED:
        raise InputError(
            f"{name}: the LV endocardium is a crescent behind a thin wall and the RV endocardium "
            "is round behind a thick one; LV and RV seem to be swapped"
        )


def _brought_together(
    parts: list[Part], base: Part, name: str
) -> tuple[list[Part], list[NDArray[np.int64]], Part, list[NDArray[np.int64]]]:
    """Split and move the rims of three parts and of the base so that they coincide."""
    own = [part.vertices[part.rims[0]] for part in parts]
    rims = _matched(own, base)
    knots = [
        common_knots(points, base.vertices[rim], (part.what, "base"), name)
        for points, rim, part in zip(own, rims, parts, strict=True)
    ]
    corners, on_base = [], []
    for k, (part, rim, shared) in enumerate(zip(parts, rims, knots, strict=True)):
        split, vertices = split_at(part, part.rims[0], shared.one, shared.on_one)
        parts[k] = split.with_moved_rims(vertices, shared.places)
        corners.append(vertices)
        base, vertices = split_at(base, rim, shared.other, shared.on_other)
        on_base.append(vertices)
    places = np.vstack([shared.places for shared in knots])
    return parts, corners, base.with_moved_rims(np.concatenate(on_base), places), on_base


def _matched(own: list[NDArray[np.float64]], base: Part) -> list[NDArray[np.int64]]:
    """The base's rims in the order of the parts' rims that they are nearest to."""
    rims = base.rims
    distance = [[rim_distance(points, base.vertices[rim]) for rim in rims] for points in own]
    best = min(permutations(range(3)), key=lambda p: sum(distance[k][p[k]] for k in range(3)))
    return [rims[k] for k in best]


def _sewn(
    parts: list[Part],
    corners: list[NDArray[np.int64]],
    base: Part,
    on_base: list[NDArray[np.int64]],
    name: str,
) -> LabelledSurface:
    """Make corners of the parts and of the base the same vertices; turn everything outwards."""
    pieces = [*parts, base]
    offsets = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    same = np.arange(offsets[-1])
    for k, (there, here) in enumerate(zip(corners, on_base, strict=True)):
        same[offsets[3] + here] = offsets[k] + there
    triangles = np.vstack(
        [piece.triangles + offset for piece, offset in zip(pieces, offsets, strict=False)]
    )
    used, local = np.unique(same[triangles], return_inverse=True)
    vertices = np.vstack([piece.vertices for piece in pieces])[used]
    labels = np.repeat(LABELS, [len(piece.triangles) for piece in pieces]).astype(np.int64)
    oriented, piece = igl.bfs_orient(np.ascontiguousarray(local.reshape(-1, 3), dtype=np.int64))
    oriented = np.ascontiguousarray(oriented, dtype=np.int64)
    edges = np.sort(oriented[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if (count != 2).any() or np.max(piece) > 0:
        raise InputError(
            f"{name}: joined, {int((count != 2).sum())} of {len(count)} edges do not have two "
            "triangles; look for triangles that parts share at their rims, and remove them"
        )
    a, b, c = (vertices[oriented[:, k]] for k in range(3))
    if float(np.einsum("ij,ij->", a, np.cross(b, c))) < 0:
        oriented = np.ascontiguousarray(oriented[:, ::-1])
    return LabelledSurface(vertices, oriented, labels, name)
