"""Orthographic views of a heart: frame, projection, shaded surfaces, isochrones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.heart.endocardium import long_axis
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.reporting import style

AMBIENT = 0.68  # brightness of a triangle turned away from the light; 1 faces it
CREASE = 0.82  # cosine of the angle (35°) between face and vertex normal from which it is one
LIGHT = (-0.4, 0.5, -0.77)  # towards the light: from the left, from above, from the eye
HAIRLINE = 0.35  # points; in the face's own colour it closes the gaps that antialiasing leaves
MARGIN = 1.04  # frame over what is in it


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

    def box(self, positions: Floats) -> tuple[Floats, Floats]:
        """Lower left and upper right corner (mm) of positions (n, 3) on the screen."""
        screen = self.project(positions)[:, :2]
        return screen.min(axis=0), screen.max(axis=0)

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
    """Sort the triangles that face the eye, the farthest first; indices.

    Parameters
    ----------
    view, vertices, triangles
        As for `paint`.
    """
    visible = np.flatnonzero(view.facing(triangle_normals(vertices, triangles)))
    depth = view.project(vertices[triangles[visible]])[..., 2].mean(axis=1)
    return np.asarray(visible[np.argsort(-depth, kind="stable")], dtype=np.int64)


def paint(
    axes: Axes,
    view: View,
    vertices: Floats,
    triangles: Integers,
    colours: str | Floats,
    *,
    alpha: float = 1.0,
) -> None:
    """Draw the triangles that face the eye, shaded.

    Parameters
    ----------
    axes : Axes
        Where to.
    view : View
        From where.
    vertices : (n, 3) array
        Positions (mm).
    triangles : (m, 3) array
        Vertex indices.
    colours : str or (m, 3) array
        One colour, or red, green and blue of each triangle.
    alpha : float
        Opacity.
    """
    order = back_to_front(view, vertices, triangles)
    rgb = np.array(to_rgb(colours)) if isinstance(colours, str) else colours[order]
    faces = rgb * view.shade(smooth_normals(vertices, triangles)[order])[:, np.newaxis]
    if alpha < 1:
        faces = np.column_stack([faces, np.full(len(faces), alpha)])
    add_polygons(axes, view.project(vertices[triangles[order]])[..., :2], faces)


def add_polygons(axes: Axes, polygons: Floats, colours: Floats) -> None:
    """Draw polygons in the order given; opaque ones are joined by a hairline.

    Parameters
    ----------
    axes : Axes
        Where to.
    polygons : (k, p, 2) array
        Corners (mm).
    colours : (k, 3) or (k, 4) array
        Red, green, blue and, of transparent ones, opacity of each.
    """
    edges = colours if colours.shape[1] == 3 else "none"
    collection = PolyCollection(
        polygons,  # type: ignore[arg-type]  # arrays are quicker, and the stubs know lists only
        facecolors=colours,
        edgecolors=edges,
        linewidths=HAIRLINE,
        rasterized=True,
    )
    axes.add_collection(collection)


def frame_size(boxes: Sequence[tuple[Floats, Floats]]) -> Floats:
    """Width and height (mm) of panels in which each of the boxes fits."""
    return np.asarray(MARGIN * np.max([high - low for low, high in boxes], axis=0))


def frame_panel(axes: Axes, box: tuple[Floats, Floats], size: Floats, title: str = "") -> None:
    """Show a picture without axes.

    Parameters
    ----------
    axes : Axes
        Where it is, in mm.
    box : tuple of two (2,) arrays
        Its lower left and upper right corner (mm), the middle of which becomes that of the panel.
    size : (2,) array
        Width and height (mm) that the panel shows.
    title : str
        What to write above it.
    """
    (left, bottom), (right, top) = ((box[0] + box[1]) + sign * size for sign in (-1, 1))
    axes.set(xlim=(left / 2, right / 2), ylim=(bottom / 2, top / 2), aspect="equal")
    axes.set_axis_off()
    axes.set_title(title, fontsize=style.TITLE_SIZE, color=style.BLACK)


def cut_at_levels(
    corners: Floats, times: Floats, levels: Floats
) -> tuple[Integers, Integers, Floats]:
    """Cut triangles along isochrones, the time being linear in each.

    Parameters
    ----------
    corners : (k, 3, 2) array
        Screen coordinates (mm).
    times : (k, 3) array
        Times (ms); a triangle with one that is not finite is not cut.
    levels : (l,) array
        Ascending isochrones (ms), the first and last beyond all times.

    Returns
    -------
    triangle, band : (p,) arrays
        The triangle of each piece, in the order given; and the interval between levels that it lies
        in, -1 where time is not finite.
    polygons : (p, 5, 2) array
        Its corners (mm); where it has fewer than five, some are repeated.
    """
    known: Booleans = np.all(np.isfinite(times), axis=1)
    band = np.clip(np.searchsorted(levels, times, side="right") - 1, 0, len(levels) - 2)
    lowest, highest = (np.where(known, f(band, axis=1), -1) for f in (np.min, np.max))
    pieces = highest - lowest + 1
    triangle = np.repeat(np.arange(len(corners)), pieces)
    number = np.arange(len(triangle)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    piece = lowest[triangle] + number
    whole = np.dstack([corners, times])[triangle]
    polygons = whole[:, [0, 1, 2, 2, 2]]
    cut = np.flatnonzero(pieces[triangle] > 1)
    above = _clip(whole[cut], levels[piece[cut]], 1.0)
    polygons[cut] = _clip(above, levels[piece[cut] + 1], -1.0)
    another = (polygons[:, 1:] != polygons[:, :-1]).any(axis=2).sum(axis=1)
    kept = (another >= 2) | (pieces[triangle] == 1)
    return triangle[kept], piece[kept], polygons[kept, :, :2]


def _clip(polygons: Floats, levels: Floats, sign: float) -> Floats:
    """Keep of convex polygons the parts where sign · (time − level) ≥ 0 (Sutherland, Hodgman).

    Takes (n, p, 3) corners x, y and time, and (n,) levels; gives (n, p + 1, 3) corners, the last
    repeated where fewer are left. Where none is left, one point stands for all of them.
    """
    count, size, _ = polygons.shape
    following = np.roll(polygons, -1, axis=1)
    here, there = (sign * (part[..., 2] - levels[:, None]) for part in (polygons, following))
    crosses = ((here > 0) & (there < 0)) | ((here < 0) & (there > 0))
    share = here / np.where(crosses, here - there, 1.0)
    at_level = polygons + share[..., None] * (following - polygons)
    corners = np.stack([polygons, at_level], axis=2).reshape(count, 2 * size, 3)
    kept = np.stack([here >= 0, crosses], axis=2).reshape(count, 2 * size)
    order = np.argsort(~kept, axis=1, kind="stable")
    last = np.maximum(kept.sum(axis=1) - 1, 0)
    chosen = np.minimum(np.arange(size + 1), last[:, None])
    order = np.take_along_axis(order, chosen, axis=1)
    return np.take_along_axis(corners, order[..., None], axis=1)
