"""Figures of the activation of the heart and of its Purkinje networks, and of its origin."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.spatial import cKDTree

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.emulation.origin import Origin
from fascicle.forward.activation_sequence import since_first
from fascicle.forward.beat import Beat
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import triangle_normals
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.reporting import style
from fascicle.reporting.names import on_template
from fascicle.reporting.style import Colour
from fascicle.reporting.surfaces import (
    DrawnSurface,
    View,
    draw_surfaces,
    heart_views,
    largest,
    scale_bar,
)

TIME_COLOURS = "viridis_r"  # perceptually uniform; early is light, late is dark


@dataclass(frozen=True)
class ActivationRow:
    """Activation of the heart, a labelled row of the figure."""

    label: str
    activation: Floats  # (n,) ms, of each vertex of the heart; inf or NaN if it is not activated
    trees: tuple[tuple[PurkinjeTree, Floats], ...] = ()  # with times (n_nodes,) of their nodes (ms)
    heart: Heart | None = None  # None: that of the figure

    @classmethod
    def of(cls, label: str, beat: Beat, heart: Heart | None = None) -> ActivationRow:
        """Tissue and Purkinje networks of a beat."""
        times = [node_times.astype(float) for node_times in beat.coupled.trees]
        trees = tuple(zip(beat.trees, times, strict=True))
        return cls(label, beat.activation.astype(float), trees, heart)

    def since_first(self) -> ActivationRow:
        """Row with times from the first activation of the heart on."""
        first = self.activation.min()
        trees = tuple((tree, times - first) for tree, times in self.trees)
        return replace(self, activation=since_first(self.activation), trees=trees)


def total_time(value: float) -> str:
    """A total activation time (ms) for the label of a row, on short lines."""
    return f"total activation\ntime {value:.0f} ms"


@style.styled
def activation_figure(
    heart: Heart, rows: Sequence[ActivationRow], label: str = "time since the first activation (ms)"
) -> Figure:
    """Draw activations, or other times, as isochrone bands, one row each.

    In each row are the views of `heart_views` of the heart, or of the row's own, then each side's
    Purkinje network on its endocardium, seen from that side through the near wall. All rows share
    the colours; all hearts share one spatial scale, all Purkinje networks another. The colour bar,
    labelled `label`, spans the times of the hearts; other times of the Purkinje networks have the
    colours of its ends.
    """
    hearts = [row.heart if row.heart is not None else heart for row in rows]
    seen = [(h, heart_views(h)) for h in hearts]
    size = largest([view.box(h.vertices) for h, views in seen for view in views.values()])
    sides = {tree.side for row in rows for tree, _ in row.trees}
    cavities = [
        [(e, views[f"{e.side.upper()} side"]) for e in h.endocardia if e.side in sides]
        for h, views in seen
    ]
    first = len(seen[0][1])  # column of the Purkinje networks
    columns, shape = first + len(cavities[0]), float(size[1] / size[0])
    figure = style.new_figure(1.95 * columns + 1.8, 1.95 * shape * len(rows) + 0.8)
    panels = figure.subplots(len(rows), columns, squeeze=False)
    norm = _bands(rows)
    for k, (line, row, (of_row, views)) in enumerate(zip(panels, rows, seen, strict=True)):
        surfaces = _coloured(of_row, row.activation, norm)
        for axes, view in zip(line, views.values(), strict=False):
            draw_surfaces(axes, view, *surfaces, box=view.box(of_row.vertices), size=size)
        if sides:
            width, height = largest([view.box(e.vertices) for h in cavities for e, view in h])
            cavity_size = np.array([1, shape]) * max(width, height / shape)
            for axes, (cavity, view) in zip(line[first:], cavities[k], strict=True):
                walls, colour = (cavity.vertices, cavity.triangles), {"color": "#F1E9E4"}
                far = DrawnSurface(*walls, colour)
                near = DrawnSurface(walls[0], walls[1][:, ::-1], colour | {"opacity": 0.3})
                draw_surfaces(axes, view, far, near, box=view.box(walls[0]), size=cavity_size)
                axes.set_title(f"{cavity.side.upper()} Purkinje network")
                for tree, times in row.trees:
                    if tree.side == cavity.side:
                        _draw_tree(axes, view, cavity, tree, times, norm)
        line[0].annotate(
            "\n".join(style.short(part, 26) for part in row.label.split("\n")), (0, 0.5), (-6, 0),
            xycoords="axes fraction", textcoords="offset points", rotation=90,
            ha="right", va="center", fontsize=matplotlib.rcParams["axes.titlesize"],
        )  # fmt: skip
    for axes in panels[1:].flat:
        axes.set_title("")
    for axes in (panels[-1][0], *panels[-1][first : first + 1]):
        scale_bar(axes, 20)
    levels = norm.boundaries
    bar = figure.colorbar(
        ScalarMappable(norm, TIME_COLOURS), ax=panels, fraction=0.02, pad=0.01, aspect=28,
        ticks=levels[:: 1 + len(levels) // 10],
    )  # fmt: skip
    bar.set_label(label, wrap=True)
    return figure


def spread_figure(heart: Heart, spreads: Mapping[str, Floats]) -> Figure:
    """Draw standard deviations (n,) of activation (ms), a row each, in the same colours."""
    rows = [ActivationRow(textwrap.fill(name, 22), spread) for name, spread in spreads.items()]
    return activation_figure(heart, rows, f"standard deviation (ms){on_template(heart)}")


def draw_tree(axes: Any, tree: PurkinjeTree) -> None:
    """Draw bundle, fascicles and branches of a tree into axes of three dimensions (mm)."""
    if axes.name != "3d":
        raise InputError("ax has two dimensions; make it with plt.subplot(projection='3d')")
    gap = np.full_like(tree.nodes, np.nan)  # between segments
    segments = np.stack([tree.nodes[tree.parents], tree.nodes, gap], axis=1)
    branches = ~np.any([*tree.parts.values(), tree.parents < 0], axis=0)
    for name, part in ({"branches": branches} | tree.parts).items():
        looks = {"color": Colour.LIGHT_GREY, "lw": 0.8} if part is branches else {"lw": 2.0}
        axes.plot(*segments[part & (tree.parents >= 0)].reshape(-1, 3).T, label=name, **looks)
    axes.plot(*tree.nodes[[tree.root]].T, "ko", label="root")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)", aspect="equal")
    axes.set_title(f"{tree.side.upper()} Purkinje network, {len(tree.junctions)} junctions")
    axes.legend()


def _bands(rows: Sequence[ActivationRow]) -> BoundaryNorm:
    """Isochrones at round times, at most 17, that cover the hearts of all rows."""
    times = np.concatenate([row.activation for row in rows])
    times = times[np.isfinite(times)]
    if not times.size:
        raise InputError("no vertex of any row is ever activated; nothing to draw")
    first, last = float(times.min()), float(times.max())
    steps = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # ms
    step = next((step for step in steps if step >= (last - first) / 16), (last - first) / 16)
    bottom = np.floor(first / step)
    count = max(1, int(np.ceil(last / step - bottom)))
    levels = step * (bottom + np.arange(count + 1))
    nodes = np.concatenate([np.empty(0), *(t for row in rows for _, t in row.trees)])
    nodes = nodes[np.isfinite(nodes)]
    early, late = (nodes < levels[0]).any(), (nodes > levels[-1]).any()
    ends: Any = ("both" if late else "min") if early else ("max" if late else "neither")
    return BoundaryNorm(levels, matplotlib.colormaps[TIME_COLOURS].N, extend=ends)


def _coloured(heart: Heart, activation: Floats, norm: BoundaryNorm) -> list[DrawnSurface]:
    """The surface of the heart in bands; tissue that is not activated is grey."""
    triangles, levels = heart.boundary[0], np.asarray(norm.boundaries, dtype=float)
    activated = np.isfinite(activation)
    reached = activated[triangles].all(axis=1)
    bands = ListedColormap(matplotlib.colormaps[TIME_COLOURS](norm((levels[:-1] + levels[1:]) / 2)))
    look = {
        "scalars": np.where(activated, activation, levels[0]), "clim": (levels[0], levels[-1]),
        "cmap": bands, "n_colors": len(levels) - 1, "interpolate_before_map": True,
    }  # fmt: skip
    parts = (reached, look), (~reached, {"color": Colour.LIGHT_GREY})
    return [
        DrawnSurface(heart.vertices, triangles[part], looks) for part, looks in parts if part.any()
    ]


def _draw_tree(
    axes: Axes, view: View, wall: Endocardium, tree: PurkinjeTree, times: Floats, norm: BoundaryNorm
) -> None:
    """Segments on the far wall drawn opaque, those on the near wall faint."""
    centres = cKDTree(wall.vertices[wall.triangles].mean(axis=1))
    normals = triangle_normals(wall.vertices, wall.triangles)
    child = np.flatnonzero(tree.parents >= 0)
    far = view.facing(normals[centres.query(tree.nodes[child])[1]])
    ends = view.project(tree.nodes[np.stack([tree.parents[child], child], axis=1)])[..., :2]
    colours = matplotlib.colormaps[TIME_COLOURS].with_extremes(bad=Colour.LIGHT_GREY)
    seam = LineCollection(list(ends[far]), colors=Colour.GREY, linewidths=1.5)
    axes.add_collection(seam, autolim=False)  # light, early colours stand out from the wall
    for segments, width, opacity in ((far, 0.9, 1.0), (~far, 0.6, 0.35)):
        lines = LineCollection(
            list(ends[segments]), cmap=colours, norm=norm, linewidths=width, alpha=opacity
        )
        lines.set_array(np.ma.masked_invalid(times[child][segments]))
        axes.add_collection(lines, autolim=False)
    root = view.project(tree.nodes[tree.root])[:2]
    axes.plot(*root, "o", color="black", markeredgecolor="white", markeredgewidth=0.6)


@style.styled
def origin_figure(origin: Origin) -> Figure:
    """Draw the regions that hold the origin with 50, 90 and 99 %, on the heart and its cavities.

    Above the heart from outside, below its far walls from within.
    """
    heart, levels = origin.heart, (0.5, 0.9, 0.99)
    colours = ("#B2182B", "#EF8A62", "#FDDBC7", Colour.LIGHT_GREY)
    of_vertices = np.ones(len(heart.vertices))  # level of the most probable tetrahedron around it
    np.minimum.at(of_vertices, heart.tetrahedra.ravel(), np.repeat(origin.levels, 4))
    place = np.digitize(of_vertices, levels)
    views = heart_views(heart)
    boxes = {name: view.box(heart.vertices) for name, view in views.items()}
    size = largest([*boxes.values()])
    figure = style.new_figure(2.0 * len(views), 4.0 * float(size[1] / size[0]) + 0.9)
    panels = figure.subplots(2, len(views), squeeze=False)
    triangles = heart.boundary[0]
    look = {
        "scalars": place, "clim": (-0.5, len(levels) + 0.5), "cmap": ListedColormap(colours),
        "n_colors": len(colours),
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
    names = [f"{level:.0%} region" for level in levels] + ["elsewhere"]
    handles = [(Patch(color=colour), name) for colour, name in zip(colours, names, strict=True)]
    style.legend(figure, handles, loc="outside lower center", ncols=len(handles))
    return style.mark(figure, None if origin.caution is None else "no origin is named")
