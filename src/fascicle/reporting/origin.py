"""The figure of where a beat comes from."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fascicle.emulation.origin import Origin
from fascicle.reporting import style
from fascicle.reporting.style import Colour
from fascicle.reporting.surfaces import DrawnSurface, draw_surfaces, heart_views, largest, scale_bar

LEVELS = (0.5, 0.9, 0.99)  # of the regions that are drawn
REGION_COLOURS = ("#B2182B", "#EF8A62", "#FDDBC7", Colour.LIGHT_GREY)


@style.styled
def origin_figure(origin: Origin) -> Figure:
    """Draw the regions that hold the origin with 50, 90 and 99 %, on the heart and its cavities.

    Above the heart from outside, below its far walls from within.
    """
    heart = origin.heart
    of_vertices = np.ones(len(heart.vertices))  # level of the most probable tetrahedron around it
    np.minimum.at(of_vertices, heart.tetrahedra.ravel(), np.repeat(origin.levels, 4))
    place = np.digitize(of_vertices, LEVELS)
    views = heart_views(heart)
    boxes = {name: view.box(heart.vertices) for name, view in views.items()}
    size = largest([*boxes.values()])
    figure = style.new_figure(2.0 * len(views), 4.0 * float(size[1] / size[0]) + 0.9)
    panels = figure.subplots(2, len(views), squeeze=False)
    triangles = heart.boundary[0]
    look = {
        "scalars": place, "clim": (-0.5, len(LEVELS) + 0.5), "cmap": ListedColormap(REGION_COLOURS),
        "n_colors": len(REGION_COLOURS),
    }  # fmt: skip
    # seen from the front, only the far walls of a surface turned inside out are visible
    rows = {"outside": triangles, "far walls, from within": triangles[:, ::-1]}
    for line, (label, faces) in zip(panels, rows.items(), strict=True):
        for axes, (name, view) in zip(line, views.items(), strict=True):
            surface = DrawnSurface(heart.vertices, faces, look)
            draw_surfaces(axes, view, surface, box=boxes[name], size=size)
        line[0].annotate(
            label, (0, 0.5), (-6, 0), xycoords="axes fraction", textcoords="offset points",
            rotation=90, ha="right", va="center",
        )  # fmt: skip
    for axes in panels[1]:
        axes.set_title("")
    scale_bar(panels[-1][0], 20)
    names = [f"{level:.0%} region" for level in LEVELS] + ["elsewhere"]
    handles = [
        (Patch(color=colour), name) for colour, name in zip(REGION_COLOURS, names, strict=True)
    ]
    style.legend(figure, handles, loc="outside lower center", ncols=len(handles))
    return style.mark(figure, None if origin.caution is None else "no origin is named")
