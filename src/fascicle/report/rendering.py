"""Orthographic views of a heart: frame, projection, hidden surfaces, isochrones. NumPy only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.endocardium import long_axis
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import triangle_normals, unit

Point = tuple[float, float, float]  # x, y (mm on the screen) and time (ms)

AMBIENT = 0.68  # brightness of a triangle turned away from the light; 1 faces it
CREASE = 0.82  # cosine of the angle (35°) between face and vertex normal from which it is one
LIGHT = (-0.4, 0.5, -0.77)  # towards the light: from the left, from above, from the eye


@dataclass(frozen=True)
class View:
    """An orthographic camera.

    Attributes
    ----------
    name : str
        What to write above the picture.
    axes : (3, 3) array
        Rows are the unit vectors to the right, upwards and away from the eye; right-handed as
        right × up = towards the eye.
    centre : (3,) array
        Position (mm) that lands on the origin.
    """

    name: str
    axes: Floats
    centre: Floats

    def project(self, positions: Floats) -> Floats:
        """Screen coordinates and depth (mm; larger is farther), the shape of `positions`."""
        return np.asarray((positions - self.centre) @ self.axes.T)

    def facing(self, normals: Floats) -> Booleans:
        """Which normals (k, 3) point towards the eye, shape (k,)."""
        return np.asarray(normals @ self.axes[2] < 0)

    def shade(self, normals: Floats) -> Floats:
        """Lambert brightness, from `AMBIENT` to 1, of unit normals (k, 3), shape (k,)."""
        light = unit(np.array(LIGHT))
        cosine = np.clip(normals @ self.axes.T @ light, 0, 1)
        return np.asarray(AMBIENT + (1 - AMBIENT) * cosine)


def heart_views(heart: Heart) -> dict[str, View]:
    """Place cameras in the heart's own frame, whatever frame its coordinates are in.

    The long axis runs from the centre of the left endocardium's opening to its farthest point; the
    patient's left is where the left cavity lies from the right one, across that axis; the front
    follows, as in every heart that is not mirrored.

    Returns
    -------
    dict of name to View
        ``"anterior"``, ``"RV side"`` and ``"LV side"`` with the base up, and ``"base"`` as tipping
        the first of them towards the eye brings it: the front down, the left on the right.
    """
    base, apex = long_axis(heart.lv.vertices, heart.lv.triangles)
    towards_left = heart.lv.vertices.mean(axis=0) - heart.rv.vertices.mean(axis=0)
    (left, back, up), centre = upright_frame(base - apex, towards_left, heart.vertices)
    axes = {
        "anterior": (left, up, back),
        "RV side": (-back, up, left),
        "LV side": (back, up, -left),
        "base": (left, back, -up),
    }
    return {name: View(name, np.array(rows), centre) for name, rows in axes.items()}


def upright_frame(up: Floats, left: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Unit vectors to the left, the back and upwards, and the centre of what is shown.

    Parameters
    ----------
    up, left : (3,) array
        Upwards, and roughly to the patient's left (mm).
    positions : (n, 3) array
        What is shown (mm).

    Returns
    -------
    frame : (3, 3) array
        Rows are the unit vectors.
    centre : (3,) array
        Middle of the box along them that holds the positions (mm).
    """
    up = unit(up)
    left = unit(left - (left @ up) * up)
    frame = np.array([left, np.cross(up, left), up])
    along = positions @ frame.T
    return frame, (along.min(axis=0) + along.max(axis=0)) / 2 @ frame


def smooth_normals(vertices: Floats, triangles: Integers) -> Floats:
    """Average normals over neighbours, by area, but not across creases as at the edge of the base.

    Returns
    -------
    (k, 3) array
        Unit normals at the centres of the triangles.
    """
    normals = triangle_normals(vertices, triangles)
    at_vertices = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(at_vertices, triangles[:, corner], normals)
    flat = unit(normals)[:, np.newaxis]
    corners = unit(at_vertices)[triangles]
    crease = np.einsum("kcj,kcj->kc", corners, np.broadcast_to(flat, corners.shape)) < CREASE
    return unit(np.where(crease[..., np.newaxis], flat, corners).sum(axis=1))


def back_to_front(view: View, vertices: Floats, triangles: Integers) -> Integers:
    """Sort the triangles that face the eye, the farthest first; indices."""
    visible = np.flatnonzero(view.facing(triangle_normals(vertices, triangles)))
    depth = view.project(vertices[triangles[visible]])[..., 2].mean(axis=1)
    return np.asarray(visible[np.argsort(-depth, kind="stable")], dtype=np.int64)


def cut_at_levels(
    corners: Floats, times: Floats, levels: Floats
) -> Iterator[tuple[int, int, Floats]]:
    """Cut triangles along isochrones, the time being linear in each.

    Parameters
    ----------
    corners : (k, 3, 2) array
        Screen coordinates (mm).
    times : (k, 3) array
        Times (ms); a triangle with one that is not finite is not cut.
    levels : (l,) array
        Ascending isochrones (ms), the first and last beyond all times.

    Yields
    ------
    triangle, band, polygon
        Index of the triangle; of the interval between levels, -1 where time is not finite; and the
        (p, 2) corners of the piece. Triangles come in the order given.
    """
    known: Booleans = np.all(np.isfinite(times), axis=1)
    band = np.clip(np.searchsorted(levels, times, side="right") - 1, 0, len(levels) - 2)
    lowest, highest = band.min(axis=1), band.max(axis=1)
    for k, corner in enumerate(corners):
        if not known[k]:
            yield k, -1, corner
        elif lowest[k] == highest[k]:
            yield k, int(lowest[k]), corner
        else:
            points = [(float(x), float(y), float(t)) for x, y, t in np.c_[corner, times[k]]]
            for piece in range(lowest[k], highest[k] + 1):
                polygon = _clip(_clip(points, levels[piece], 1.0), levels[piece + 1], -1.0)
                if len(polygon) > 2:
                    yield k, piece, np.array(polygon)[:, :2]


def _clip(points: list[Point], level: float, sign: float) -> list[Point]:
    """Keep the part of a convex polygon where sign · (time − level) ≥ 0 (Sutherland, Hodgman)."""
    kept: list[Point] = []
    for (xa, ya, ta), (xb, yb, tb) in zip(points, points[1:] + points[:1], strict=True):
        a, b = sign * (ta - level), sign * (tb - level)
        if a >= 0:
            kept.append((xa, ya, ta))
        if (a > 0 > b) or (a < 0 < b):
            share = a / (a - b)
            kept.append((xa + share * (xb - xa), ya + share * (yb - ya), level))
    return kept
