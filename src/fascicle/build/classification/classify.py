"""A closed surface of the ventricles without labels: endocardia, epicardium and base are found."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray

from fascicle.build.classification.ambient_occlusion import Patchwork, Told, sky_seen
from fascicle.build.classification.base_boundary import local_up
from fascicle.build.classification.sides import cavity_volume, leftness
from fascicle.build.classification.smoothing import tidy
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.heart.validate import check_units

# Shares of the sky. At the upper edge of a cavity a wall sees half of it, deeper walls less; the
# epicardium sees more than 0.8 even in the grooves between the ventricles.
IN_CAVITY, UNDER_SKY = 0.6, 0.85
# Cosine of the angle between normal and the way up out of the wall: base within 26°, none from 46°.
BASE, NO_BASE = 0.9, 0.7
SMALLEST_CAVITY = 0.02  # of the whole area; smaller dents are none
ML = 1e3  # mm³

# labels while the surface is divided; the cavities come first, the larger area first of all
FIRST, SECOND, OUTER, RIM = range(4)


def classify_surface(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    name: str,
    told: Told | None = None,
) -> LabelledSurface:
    """Label the closed surface of the ventricles from its shape alone.

    Endocardium is where rays that leave the surface mostly meet it again; there must be two such
    pieces, of which the left one is rounder, closer to convex and behind the thicker wall. The
    base is where the surface faces the way up out of the wall, seen along the openings, be it flat
    or a rounded rim. Random walks on the surface draw the borders along its creases.

    Parameters
    ----------
    vertices : (n, 3) array
        Positions (mm), in any frame.
    triangles : (m, 3) array
        Vertex indices, in any orientation.
    name : str
        What to call the surface in messages.
    told : callable, optional
        Told triangles done and in all, while rays are traced.

    Returns
    -------
    LabelledSurface
        The same triangles, turned to face out of the tissue, with `Label.BASE`,
        `Label.EPICARDIUM`, `Label.LV_ENDOCARDIUM` and `Label.RV_ENDOCARDIUM`; each of these is one
        piece and each endocardium has one opening. Vertices that no triangle uses are dropped.

    Raises
    ------
    InputError
        If the surface is not closed or not one piece, is not in mm, or does not have two cavities
        with one opening each.
    """
    vertices, triangles = _closed(vertices, triangles, name)
    patchwork = Patchwork(vertices, triangles)
    seen = sky_seen(patchwork, told)
    cavity = _cavities(patchwork, seen, name)
    regions = _divided(patchwork, seen, cavity)
    regions = tidy(patchwork, regions, name)
    _check_openings(patchwork, regions, name)
    outer, first, second = (
        (vertices, np.ascontiguousarray(triangles[regions == region]))
        for region in (OUTER, FIRST, SECOND)
    )
    sides = [Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM]
    if leftness(first, second, outer) < 0:
        sides.reverse()
    labels = np.array([*sides, Label.EPICARDIUM, Label.BASE], dtype=np.int64)[regions]
    return LabelledSurface(vertices, triangles, labels, name)


def _closed(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Check that a surface is closed and one piece; drop what is not used; turn it outwards."""
    used, local = np.unique(triangles, return_inverse=True)
    vertices = np.ascontiguousarray(vertices[used], dtype=float)
    triangles = np.ascontiguousarray(local.reshape(-1, 3), dtype=np.int64)
    check_units(name, vertices)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    for bad, fault, remedy in (
        (edges[count == 1], "are open", "close it, or give its parts one by one"),
        (edges[count > 2], "have more than two triangles", "repair or remesh it"),
    ):
        if len(bad):
            raise InputError(
                f"{name}: not closed cleanly: {len(bad)} of {len(edges)} edges {fault}, about "
                f"{_point(vertices[bad].mean(axis=(0, 1)))} mm; {remedy}"
            )
    oriented, piece = igl.bfs_orient(triangles)
    oriented = np.ascontiguousarray(oriented, dtype=np.int64)
    if piece.max() > 0:
        _refuse_pieces(vertices, oriented, piece, name)
    if _volume(vertices, oriented) < 0:
        oriented = np.ascontiguousarray(oriented[:, ::-1])
    return vertices, oriented


def _refuse_pieces(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int64],
    piece: NDArray[np.int64],
    name: str,
) -> None:
    """Say what the pieces are: cavities closed at the base lie within the largest one."""
    parts = [triangles[piece == k] for k in range(piece.max() + 1)]
    parts.sort(key=lambda part: -abs(_volume(vertices, part)))
    volumes = [abs(_volume(vertices, part)) / ML for part in parts]
    sample = np.array([vertices[part[0, 0]] for part in parts[1:]])
    around = np.abs(igl.winding_number(vertices, np.ascontiguousarray(parts[0]), sample))
    sizes = ", ".join(f"{volume:.3g}" for volume in volumes[1:])
    if (around > 0.5).all():
        raise InputError(
            f"{name}: closed surfaces lie within the outer one ({len(parts) - 1}, of {sizes} ml); "
            "if they are cavities, cut the base off so that they are open there"
        )
    raise InputError(
        f"{name}: the surface falls into {len(parts)} pieces ({volumes[0]:.3g}, {sizes} ml); "
        "give one closed surface"
    )


def _cavities(patchwork: Patchwork, seen: NDArray[np.float64], name: str) -> NDArray[np.int64]:
    """Number of the cavity that each triangle lies deep in, -1 elsewhere; there must be two."""
    piece = patchwork.components(seen < IN_CAVITY)
    area = np.bincount(piece[piece >= 0], patchwork.areas[piece >= 0], minlength=1)
    found = int((area > SMALLEST_CAVITY * patchwork.areas.sum()).sum())
    if found != 2:
        volumes = [
            cavity_volume(patchwork.vertices, patchwork.triangles[piece == k]) / ML
            for k in range(found)
        ]
        sizes = ", ".join(f"{volume:.3g}" for volume in volumes)
        what = {0: "no cavity", 1: f"one cavity ({sizes} ml)"}.get(
            found, f"{found} cavities ({sizes} ml)"
        )
        raise InputError(
            f"{name}: {what} found; it must have two, of the left and the right ventricle, each "
            "open at the base"
        )
    return np.where(piece < 2, piece, -1)


def _divided(
    patchwork: Patchwork, seen: NDArray[np.float64], cavity: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Divide the surface into the two cavities, the outer surface and the rim between them."""
    seeds = np.where(cavity >= 0, cavity, np.where(seen > UNDER_SKY, OUTER, -1))
    upwards = local_up(patchwork, patchwork.walk(seeds, 3))
    outside = seen > IN_CAVITY
    # the inner edge of a rounded rim faces neither up nor out: it is left to the walk
    outer = patchwork.components((seen > UNDER_SKY) & (upwards < NO_BASE)) == 0
    seeds = np.where(cavity >= 0, cavity, -1)
    seeds[outer] = OUTER
    seeds[outside & (upwards > BASE)] = RIM
    return patchwork.walk(seeds, 4)


def _check_openings(patchwork: Patchwork, regions: NDArray[np.int64], name: str) -> None:
    """Refuse a surface that is all base or has none, and a cavity with several openings."""
    for region, what in ((OUTER, "epicardium"), (RIM, "base")):
        if not (regions == region).any():
            raise InputError(
                f"{name}: no {what} found around the cavities; give the surface's parts one by one"
            )
    for region in (FIRST, SECOND):
        loops = igl.boundary_loop_all(patchwork.triangles[regions == region])
        if len(loops) != 1:
            volume = cavity_volume(patchwork.vertices, patchwork.triangles[regions == region]) / ML
            where = " and ".join(_point(patchwork.vertices[loop].mean(axis=0)) for loop in loops)
            raise InputError(
                f"{name}: the cavity of {volume:.3g} ml has {len(loops)} openings, about {where} "
                "mm; cut the base off below the bridge between them"
            )


def _volume(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """Signed volume within a closed surface (mm³)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _point(position: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{x:.0f}" for x in position) + ")"
