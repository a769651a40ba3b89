"""Activation of heart and Purkinje trees, seen from several sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, to_rgb
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.core.errors import InputError
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.report.figures import (
    BLACK,
    GREY,
    LABEL_SIZE,
    TICK_SIZE,
    TITLE_SIZE,
    new_figure,
    scale_bar,
    set_title,
    write_in,
)
from fascicle.report.painting import add_polygons, paint
from fascicle.report.rendering import (
    View,
    back_to_front,
    cut_at_levels,
    heart_views,
    smooth_normals,
)

COLOURS = "viridis_r"  # perceptually uniform; early is light, late is dark
ISOCHRONE_STEPS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # ms
MOST_BANDS = 16
SILENT = "#B8B8B8"  # where no activation arrives
CAVITY = "#F1E9E4"  # endocardium behind the trees
VIEWS = ("RV side", "anterior", "LV side", "base")
SCALE_BAR = 20.0  # mm
PANEL = 1.95  # width, inch
BAR_ROOM, TITLE_ROOM = 1.1, 0.5  # inch, at the right and above
ROW_NAME = (-0.02, 0.5)  # of the first panel
MOST_TIMES = 10  # of the colour bar
MARGIN = 1.04  # frame over heart

Box = tuple[Floats, Floats]


@dataclass(frozen=True)
class _Line:
    """How segments of a tree are drawn: widths (points) of line and dark edge, opacity."""

    width: float
    seam: float
    opacity: float


FAR = _Line(0.9, 1.5, 1.0)
NEAR = _Line(0.6, 0.0, 0.35)


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


def activation_figure(
    heart: Heart, rows: Sequence[ActivationRow], *, title: str | None = None
) -> Figure:
    """Draw activations of one heart as isochrone bands, one row each.

    Parameters
    ----------
    heart : Heart
        The heart, in any frame.
    rows : sequence of ActivationRow
        Activations; all share the colours. Hearts share one scale in space, trees another.
    title : str, optional
        Heading.

    Returns
    -------
    Figure
        Row by row the views of `VIEWS`, then each side's tree on its endocardium, seen from that
        side through the near wall; last the colour bar, activation (ms), which spans the times of
        the hearts, so that earlier or later ones in the trees share its pointed ends.

    Raises
    ------
    InputError
        If there is no row, or times and vertices or nodes differ in number.
    """
    _check(heart, rows)
    views = heart_views(heart)
    cavities = [e for e in heart.endocardia if _has_tree(rows, e.side)]
    names = [*VIEWS, *(f"{e.side.upper()} tree" for e in cavities)]
    boxes = [_box(views[name], heart.vertices) for name in VIEWS]
    tree_boxes = [_box(views[f"{e.side.upper()} side"], e.vertices) for e in cavities]
    width, height = np.max([high - low for low, high in boxes], axis=0)
    shape = float(height / width)
    figure = new_figure(PANEL * len(names) + BAR_ROOM, PANEL * shape * len(rows) + TITLE_ROOM)
    panels = figure.subplots(len(rows), len(names), squeeze=False)
    norm = _bands(rows)
    surface = _Surface.of(heart)
    for axes_row, row in zip(panels, rows, strict=True):
        for axes, name in zip(axes_row, VIEWS, strict=False):
            _draw_surface(axes, views[name], surface, row.activation, norm)
        for axes, cavity in zip(axes_row[len(VIEWS) :], cavities, strict=True):
            _draw_cavity(axes, views[f"{cavity.side.upper()} side"], cavity, row, norm)
        write_in(axes_row[0], *ROW_NAME, row.label, rotation=90, ha="right", va="center")
    _frame_panels(panels[:, : len(VIEWS)].tolist(), boxes, names[: len(VIEWS)], shape)
    if cavities:
        _frame_panels(panels[:, len(VIEWS) :].tolist(), tree_boxes, names[len(VIEWS) :], shape)
    bar = figure.colorbar(
        ScalarMappable(norm, COLOURS), ax=panels, fraction=0.02, pad=0.01, aspect=28, shrink=0.9,
        ticks=norm.boundaries[:: 1 + len(norm.boundaries) // MOST_TIMES],
    )  # fmt: skip
    bar.set_label("activation (ms)", fontsize=LABEL_SIZE)
    bar.ax.tick_params(labelsize=TICK_SIZE)
    set_title(figure, title)
    return figure


@dataclass(frozen=True)
class _Surface:
    """The heart's boundary, oriented, with smooth normals for the shading."""

    vertices: Floats
    triangles: Integers
    normals: Floats

    @classmethod
    def of(cls, heart: Heart) -> _Surface:
        triangles = heart.boundary[0]
        return cls(heart.vertices, triangles, smooth_normals(heart.vertices, triangles))


def _check(heart: Heart, rows: Sequence[ActivationRow]) -> None:
    if not rows:
        raise InputError("no activation to draw; give at least one row")
    for row in rows:
        found, needed = np.shape(row.activation), (len(heart.vertices),)
        if found != needed:
            raise InputError(f"row '{row.label}': times of shape {found}; the heart needs {needed}")
        for tree, times in row.trees:
            if np.shape(times) != (len(tree.nodes),):
                raise InputError(
                    f"row '{row.label}': times of shape {np.shape(times)} for the "
                    f"{len(tree.nodes)} nodes of the {tree.side} tree"
                )


def _has_tree(rows: Sequence[ActivationRow], side: str) -> bool:
    return any(tree.side == side for row in rows for tree, _ in row.trees)


def _box(view: View, positions: Floats) -> Box:
    """Lower left and upper right corner on the screen (mm)."""
    screen = view.project(positions)[:, :2]
    return screen.min(axis=0), screen.max(axis=0)


def _bands(rows: Sequence[ActivationRow]) -> BoundaryNorm:
    """Isochrones at round times that cover the hearts of all rows."""
    times = np.concatenate([np.asarray(row.activation, dtype=float) for row in rows])
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
    early, late = (in_trees < boundaries[0]).any(), (in_trees > boundaries[-1]).any()
    colours = matplotlib.colormaps[COLOURS].N
    if early and late:
        return BoundaryNorm(boundaries, colours, extend="both")
    if early or late:
        return BoundaryNorm(boundaries, colours, extend="min" if early else "max")
    return BoundaryNorm(boundaries, colours)


def _draw_surface(
    axes: Axes, view: View, surface: _Surface, activation: Floats, norm: BoundaryNorm
) -> None:
    """Painter's algorithm on the triangles that face the eye, each cut along the isochrones."""
    order = back_to_front(view, surface.vertices, surface.triangles)
    corners = surface.triangles[order]
    levels = np.asarray(norm.boundaries, dtype=float)
    screen = view.project(surface.vertices[corners])[..., :2]
    pieces = list(cut_at_levels(screen, np.asarray(activation)[corners], levels))
    owner = np.array([triangle for triangle, _, _ in pieces], dtype=int)
    band = np.array([piece for _, piece, _ in pieces], dtype=int)
    middle = (levels[:-1] + levels[1:]) / 2
    palette = np.vstack([matplotlib.colormaps[COLOURS](norm(middle))[:, :3], to_rgb(SILENT)])
    colours = palette[band] * view.shade(surface.normals[order])[owner, np.newaxis]
    add_polygons(axes, [polygon for _, _, polygon in pieces], colours)


def _draw_cavity(
    axes: Axes, view: View, endocardium: Endocardium, row: ActivationRow, norm: BoundaryNorm
) -> None:
    """Draw the far wall of a cavity, as if the near one were glass, and the trees in it."""
    vertices, triangles = endocardium.vertices, endocardium.triangles
    paint(axes, view, vertices, triangles, CAVITY)
    normals = smooth_normals(vertices, triangles)
    centres = cKDTree(vertices[triangles].mean(axis=1))
    for tree, times in row.trees:
        if tree.side == endocardium.side:
            _, nearest = centres.query(tree.nodes)
            far = view.facing(normals[nearest])
            _draw_tree(axes, view, tree, np.asarray(times, dtype=float), far, norm)


def _draw_tree(
    axes: Axes, view: View, tree: PurkinjeTree, times: Floats, far: Booleans, norm: BoundaryNorm
) -> None:
    """Segments on the far wall drawn fully, those on the near, glass wall as a faint veil."""
    child = np.flatnonzero(tree.parents >= 0)
    ends = view.project(tree.nodes[np.stack([tree.parents[child], child], axis=1)])[..., :2]
    colours = matplotlib.colormaps[COLOURS].with_extremes(bad=SILENT)
    for here, style in ((far[child], FAR), (~far[child], NEAR)):
        segments = list(ends[here])
        if style.seam > 0:  # a dark edge lets the light, early colours stand out from the wall
            seam = LineCollection(segments, colors=GREY, linewidths=style.seam)
            axes.add_collection(seam, autolim=False)
        lines = LineCollection(
            segments, cmap=colours, norm=norm, linewidths=style.width, alpha=style.opacity
        )
        lines.set_array(np.ma.masked_invalid(times[child][here]))
        axes.add_collection(lines, autolim=False)
    axes.plot(
        *view.project(tree.nodes[tree.root])[:2], "o", color=BLACK, markersize=4,
        markeredgecolor="white", markeredgewidth=0.6,
    )  # fmt: skip


def _frame_panels(
    panels: Sequence[Sequence[Axes]], boxes: Sequence[Box], names: Sequence[str], shape: float
) -> None:
    """Give the panels of one group one scale in mm, names above, a scale bar below the first.

    All groups' panels have the same `shape`, height over width, so that their names align.
    """
    width, height = MARGIN * np.max([(high - low) / 2 for low, high in boxes], axis=0)
    width = max(width, height / shape)
    height = shape * width
    for column, (name, (low, high)) in enumerate(zip(names, boxes, strict=True)):
        x, y = (low + high) / 2
        for row in panels:
            axes = row[column]
            axes.set(xlim=(x - width, x + width), ylim=(y - height, y + height), aspect="equal")
            axes.set_axis_off()
        panels[0][column].set_title(name, fontsize=TITLE_SIZE, color=BLACK)
    scale_bar(panels[-1][0], SCALE_BAR)
