"""Activation of heart and Purkinje trees, seen from several sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, to_rgb
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.fitted_text import INCH, shortened, wrapped
from fascicle.reporting.rendering import (
    View,
    add_polygons,
    back_to_front,
    cut_at_levels,
    frame_panel,
    frame_size,
    heart_views,
    paint,
    smooth_normals,
)
from fascicle.study.activation_maps import since_first

COLOURS = "viridis_r"  # perceptually uniform; early is light, late is dark
ISOCHRONE_STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # ms
MOST_BANDS = 16
SILENT = "#B8B8B8"  # where no activation arrives
CAVITY = "#F1E9E4"  # endocardium behind the trees
GLASS = "#F8F5F2"  # near wall of a cavity, where it stands out above the far one
SINCE_FIRST = "time since the first activation (ms)"
SPREAD = "standard deviation (ms)"
VIEWS = ("RV side", "anterior", "LV side", "base")
SCALE_BAR = 20.0  # mm
PANEL = 1.95  # width, inch
BAR_ROOM, TITLE_ROOM = 1.1, 0.5  # inch, at the right and above
NAME_ROOM, LINE_ROOM = 0.15, 0.175  # inch at the left, and more for each line of a name
SCALE_ROOM = 0.25  # inch, below
BAR_SHARE = 0.9  # of the height
ROW_NAME = (-0.02, 0.5)  # of the first panel
MOST_TIMES = 10  # of the colour bar
SEAM = 1.5  # points; a dark edge lets the light, early colours stand out from the wall
FAR: dict[str, float] = {"linewidths": 0.9, "alpha": 1.0}  # of a tree's segments
NEAR: dict[str, float] = {"linewidths": 0.6, "alpha": 0.35}


@dataclass(frozen=True)
class ActivationRow:
    """One activation of the heart: a row of the figure.

    Attributes
    ----------
    label : str
        Name of the row.
    activation : (n,) array
        Time at each vertex of the heart (ms); inf or NaN where none arrives.
    trees : tuple of (PurkinjeTree, (n_nodes,) array)
        Trees and the times at their nodes (ms); may be empty.
    """

    label: str
    activation: Floats
    trees: tuple[tuple[PurkinjeTree, Floats], ...] = ()

    def since_first(self) -> ActivationRow:
        """The same with times from the first activation of the heart on."""
        first = self.activation.min()
        trees = tuple((tree, times - first) for tree, times in self.trees)
        return ActivationRow(self.label, since_first(self.activation), trees)


def total_time(value: float) -> str:
    """A total activation time (ms) as rows are named, on lines that are short enough."""
    return f"total activation\ntime {value:.0f} ms"


def activation_figure(heart: Heart, rows: Sequence[ActivationRow], what: str) -> Figure:
    """Draw activations of one heart, or other times, as isochrone bands, one row each.

    Parameters
    ----------
    heart : Heart
        The heart, in any frame.
    rows : sequence of ActivationRow
        Activations; all share the colours. Hearts share one scale in space, trees another.
    what : str
        The times, with their unit, and what happens at time 0.

    Returns
    -------
    Figure
        Row by row the views of `VIEWS`, then each side's tree on its endocardium, seen from that
        side through the near wall; last the colour bar, named `what`, which spans the times of
        the hearts, so that earlier or later ones in the trees share its pointed ends.
    """
    views = heart_views(heart)
    sides = {tree.side for row in rows for tree, _ in row.trees}
    cavities = [e for e in heart.endocardia if e.side in sides]
    boxes = [views[name].box(heart.vertices) for name in VIEWS]
    size = frame_size(boxes)
    shape = float(size[1] / size[0])
    columns = len(VIEWS) + len(cavities)
    room = NAME_ROOM + LINE_ROOM * max(len(row.label.split("\n")) for row in rows)
    wide = PANEL * columns + BAR_ROOM + room
    high = PANEL * shape * len(rows) + TITLE_ROOM + SCALE_ROOM
    figure = new_figure(wide, high)
    # the layout knows nothing of names beside panels that keep the shape of the heart
    left = room / wide
    figure.set_layout_engine("constrained", rect=(left, 0, 1 - left, 1))
    panels = figure.subplots(len(rows), columns, squeeze=False)
    norm = _bands(rows)
    for axes_row, row in zip(panels, rows, strict=True):
        for axes, name in zip(axes_row, VIEWS, strict=False):
            _draw_surface(axes, views[name], heart, row.activation, norm)
        for axes, cavity in zip(axes_row[len(VIEWS) :], cavities, strict=True):
            _draw_cavity(axes, views[f"{cavity.side.upper()} side"], cavity, row, norm)
        beside = INCH * PANEL * shape
        lines = [shortened(line, style.TITLE_SIZE, beside) for line in row.label.split("\n")]
        name = "\n".join(lines)
        style.write_in(axes_row[0], *ROW_NAME, name, rotation=90, ha="right", va="center")
    _frame_panels(panels[:, : len(VIEWS)], boxes, VIEWS, size)
    if cavities:
        boxes = [views[f"{e.side.upper()} side"].box(e.vertices) for e in cavities]
        width, height = frame_size(boxes)
        width = max(width, height / shape)  # all panels are alike, so that their names align
        names = [f"{e.side.upper()} tree" for e in cavities]
        _frame_panels(panels[:, len(VIEWS) :], boxes, names, np.array([width, shape * width]))
    bar = figure.colorbar(
        ScalarMappable(norm, COLOURS), ax=panels, fraction=0.02, pad=0.01, aspect=28,
        shrink=BAR_SHARE, ticks=norm.boundaries[:: 1 + len(norm.boundaries) // MOST_TIMES],
    )  # fmt: skip
    along = INCH * BAR_SHARE * high
    lines = [part for line in what.split("\n") for part in wrapped(line, style.LABEL_SIZE, along)]
    bar.set_label("\n".join(lines), fontsize=style.LABEL_SIZE)
    bar.ax.tick_params(labelsize=style.TICK_SIZE)
    return figure


def _frame_panels(
    panels: Any, boxes: Sequence[tuple[Floats, Floats]], names: Sequence[str], size: Floats
) -> None:
    """Give an array of panels one scale in mm, names above, a scale bar below the first."""
    for row, axes_row in enumerate(panels):
        for axes, box, name in zip(axes_row, boxes, names, strict=True):
            frame_panel(axes, box, size, "" if row else name)
    style.scale_bar(panels[-1][0], SCALE_BAR, below=True)


def _bands(rows: Sequence[ActivationRow]) -> BoundaryNorm:
    """Isochrones at round times that cover the hearts of all rows."""
    times = np.concatenate([row.activation for row in rows])
    times = times[np.isfinite(times)]
    if not times.size:
        raise InputError("no vertex of any row is ever activated; nothing to draw")
    first, last = float(times.min()), float(times.max())
    rough = (last - first) / MOST_BANDS
    step = next((step for step in ISOCHRONE_STEPS if step >= rough), rough)
    bottom = np.floor(first / step)
    count = max(1, int(np.ceil(last / step - bottom)))
    boundaries = step * (bottom + np.arange(count + 1))
    in_trees = np.concatenate([np.empty(0), *(t for row in rows for _, t in row.trees)])
    in_trees = in_trees[np.isfinite(in_trees)]
    early, late = bool((in_trees < boundaries[0]).any()), bool((in_trees > boundaries[-1]).any())
    colours = matplotlib.colormaps[COLOURS].N
    extend: Any = {(True, True): "both", (True, False): "min", (False, True): "max"}
    return BoundaryNorm(boundaries, colours, extend=extend.get((early, late), "neither"))


def _draw_surface(
    axes: Axes, view: View, heart: Heart, activation: Floats, norm: BoundaryNorm
) -> None:
    """Painter's algorithm on the triangles that face the eye, each cut along the isochrones."""
    triangles = heart.boundary[0]
    order = back_to_front(view, heart.vertices, triangles)
    corners = triangles[order]
    levels = np.asarray(norm.boundaries, dtype=float)
    screen = view.project(heart.vertices[corners])[..., :2]
    owner, band, polygons = cut_at_levels(screen, activation[corners], levels)
    middle = (levels[:-1] + levels[1:]) / 2
    palette = np.vstack([matplotlib.colormaps[COLOURS](norm(middle))[:, :3], to_rgb(SILENT)])
    shade = view.shade(smooth_normals(heart.vertices, triangles)[order])
    colours = palette[band] * shade[owner, np.newaxis]
    add_polygons(axes, polygons, colours)


def _draw_cavity(
    axes: Axes, view: View, endocardium: Endocardium, row: ActivationRow, norm: BoundaryNorm
) -> None:
    """Draw the far wall of a cavity, as if the near one were glass, and the trees in it.

    Where the base is not seen from its edge, the near wall rises above the far one, or the other
    way round: it is painted first, so that no tree leaves its endocardium.
    """
    vertices, triangles = endocardium.vertices, endocardium.triangles
    paint(axes, view, vertices, triangles[:, ::-1], GLASS)
    paint(axes, view, vertices, triangles, CAVITY)
    normals = smooth_normals(vertices, triangles)
    centres = cKDTree(vertices[triangles].mean(axis=1))
    for tree, times in row.trees:
        if tree.side == endocardium.side:
            _, nearest = centres.query(tree.nodes)
            far = view.facing(normals[nearest])
            _draw_tree(axes, view, tree, times, far, norm)


def _draw_tree(
    axes: Axes, view: View, tree: PurkinjeTree, times: Floats, far: Booleans, norm: BoundaryNorm
) -> None:
    """Segments on the far wall drawn fully, those on the near, glass wall as a faint veil."""
    child = np.flatnonzero(tree.parents >= 0)
    ends = view.project(tree.nodes[np.stack([tree.parents[child], child], axis=1)])[..., :2]
    colours = matplotlib.colormaps[COLOURS].with_extremes(bad=SILENT)
    seam = LineCollection(list(ends[far[child]]), colors=style.GREY, linewidths=SEAM)
    axes.add_collection(seam, autolim=False)
    for here, looks in ((far[child], FAR), (~far[child], NEAR)):
        lines = LineCollection(list(ends[here]), cmap=colours, norm=norm, **looks)
        lines.set_array(np.ma.masked_invalid(times[child][here]))
        axes.add_collection(lines, autolim=False)
    axes.plot(
        *view.project(tree.nodes[tree.root])[:2], "o", color=style.BLACK, markersize=4,
        markeredgecolor="white", markeredgewidth=0.6,
    )  # fmt: skip
