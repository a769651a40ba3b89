"""Surfaces painted triangle by triangle, the farthest first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from fascicle.core.arrays import Floats, Integers
from fascicle.report.rendering import View, back_to_front, smooth_normals

HAIRLINE = 0.35  # points; in the face's own colour it closes the gaps that antialiasing leaves


def paint(
    axes: Axes,
    view: View,
    vertices: Floats,
    triangles: Integers,
    colours: str | Floats,
    *,
    alpha: float = 1.0,
    autolim: bool = False,
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
    autolim : bool
        Whether the axes' limits follow.
    """
    order = back_to_front(view, vertices, triangles)
    rgb = np.array(to_rgb(colours)) if isinstance(colours, str) else colours[order]
    faces = rgb * view.shade(smooth_normals(vertices, triangles)[order])[:, np.newaxis]
    if alpha < 1:
        faces = np.column_stack([faces, np.full(len(faces), alpha)])
    polygons = list(view.project(vertices[triangles[order]])[..., :2])
    add_polygons(axes, polygons, faces, hairline=alpha == 1, autolim=autolim)


def add_polygons(
    axes: Axes,
    polygons: Sequence[Floats],
    colours: Floats,
    *,
    hairline: bool = True,
    autolim: bool = False,
) -> None:
    """Draw polygons in the order given.

    Parameters
    ----------
    axes : Axes
        Where to.
    polygons : sequence of (p, 2) arrays
        Corners (mm).
    colours : (k, 3) or (k, 4) array
        Of each.
    hairline : bool
        Whether neighbours are joined by a hairline, which transparent ones cannot be.
    autolim : bool
        Whether the axes' limits follow.
    """
    collection = PolyCollection(
        list(polygons),
        facecolors=colours,
        edgecolors=colours if hairline else "none",
        linewidths=HAIRLINE,
        rasterized=True,
    )
    axes.add_collection(collection, autolim=autolim)
