"""Figures for checking a heart by eye: the labels of its surface, and an overview page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fascicle.build.check import WALLS, HeartCheck
from fascicle.core.arrays import Booleans, Floats
from fascicle.core.errors import InputError
from fascicle.core.leads import ELECTRODES
from fascicle.core.ranges import shown
from fascicle.heart.heart import Heart, TorsoTissue
from fascicle.heart.labelled_surface import ENDOCARDIA, Label, LabelledMesh, LabelledSurface
from fascicle.mesh.measures import triangle_areas, triangle_normals
from fascicle.mesh.topology import boundary_loops, boundary_triangles
from fascicle.reporting import style
from fascicle.reporting.style import Colour
from fascicle.reporting.surfaces import (
    DrawnSurface,
    View,
    draw_surfaces,
    heart_views,
    largest,
    scale_bar,
    upright_frame,
)
from fascicle.torso.conductor import torso_axes

# Name and colour of each label
LABELS = {
    Label.BASE: ("base", Colour.YELLOW),
    Label.EPICARDIUM: ("epicardium", Colour.LIGHT_GREY),
    Label.LV_ENDOCARDIUM: ("LV endocardium", Colour.VERMILION),
    Label.RV_ENDOCARDIUM: ("RV endocardium", Colour.BLUE),
    Label.MITRAL: ("mitral valve", Colour.ORANGE),
    Label.AORTIC: ("aortic valve", Colour.PURPLE),
    Label.TRICUSPID: ("tricuspid valve", Colour.GREEN),
    Label.PULMONARY: ("pulmonary valve", Colour.SKY),
}


@style.styled
def labels_figure(surface: LabelledSurface | LabelledMesh) -> Figure:
    """Draw labels from the front, the back and the base, and without epicardium, on one scale.

    The surface is closed or the boundary of a mesh, in any frame, with base, epicardium and both
    endocardia. The legend gives the area of each label. Front and back are found from the labels,
    so they are exchanged if those of LV and RV are.
    """
    views = _label_views(surface)
    boxes = [view.box(surface.vertices[np.unique(surface.triangles)]) for view in views]
    size = largest(boxes)
    figure = style.new_figure(12.3, 2.6 * float(size[1] / size[0]) + 0.6, surface.name)
    panels = figure.subplots(1, len(views))
    for axes, view, box in zip(panels, views, boxes, strict=True):
        parts = []
        for label, (_, colour) in LABELS.items():
            triangles = surface.having(label)
            if view is views[-1]:  # without epicardium, cavities appear as solid casts
                if label is Label.EPICARDIUM:
                    continue
                triangles = triangles[:, ::-1] if label in ENDOCARDIA else triangles
            if len(triangles):
                parts.append(DrawnSurface(surface.vertices, triangles, {"color": colour}))
        draw_surfaces(axes, view, *parts, box=box, size=size)
    scale_bar(panels[0], 20)
    patches = [
        (Patch(facecolor=LABELS[label][1]), f"{LABELS[label][0]}\n{area:.1f} cm²")
        for label, area in label_areas(surface).items()
    ]
    style.legend(figure, patches, loc="outside right center", ncols=1)
    return figure


def label_areas(surface: LabelledSurface | LabelledMesh) -> dict[Label, float]:
    """Area (cm²) of each label on the surface."""
    areas = triangle_areas(surface.vertices, surface.triangles)
    return {
        label: float(areas[surface.labels == label].sum()) / 100
        for label in Label
        if (surface.labels == label).any()
    }


def _label_views(surface: LabelledSurface | LabelledMesh) -> list[View]:
    """Cameras in a frame defined by the LV cavity's opening and apex, and by the RV cavity."""
    left_cavity, right_cavity = (surface.having(label) for label in ENDOCARDIA)
    opening = surface.vertices[max(boundary_loops(left_cavity), key=len)].mean(axis=0)
    wall = surface.vertices[np.unique(left_cavity)]
    apex = wall[np.argmax(np.linalg.norm(wall - opening, axis=1))]
    towards_left = wall.mean(axis=0) - surface.vertices[np.unique(right_cavity)].mean(axis=0)
    (left, back, up), centre = upright_frame(
        opening - apex, towards_left, surface.vertices[np.unique(surface.triangles)]
    )
    axes = {
        "front": (left, up, back),
        "back": (-left, up, -back),
        "base": (left, back, -up),
        "front, without epicardium": (left, up, back),
    }
    return [View(name, np.array(rows), centre) for name, rows in axes.items()]


@style.styled
def check_figure(heart: Heart, check: HeartCheck) -> Figure:
    """Draw an overview page, for checking a heart by eye before it is used.

    Above: endocardia with the roots and directions of the bundles; fibres on the epicardium and on
    the endocardia. Below: the torso with its electrodes, from the front and from the left; helix
    angles through the walls; wall thickness.
    """
    view = heart_views(heart)["anterior"]
    box = view.box(heart.vertices)
    size = largest([box])
    above = 4 * float(size[1] / size[0]) + 0.75  # inch
    figure = style.new_figure(12.0, above + 3.8, heart.name)
    upper, lower = np.asarray(figure.subfigures(2, 1, height_ratios=(above, 3.8)))
    hearts = upper.subplots(1, 3)
    _draw_seeds(hearts[0], view, heart, box, size)
    cavities = np.isin(check.mesh.labels, ENDOCARDIA)
    epicardium = check.mesh.labels == Label.EPICARDIUM
    _draw_fibres(hearts[1], view, heart, epicardium, 1, box, size)
    hearts[1].set_title("fibres, epicardium")
    _draw_fibres(hearts[2], view, heart, cavities, -1, box, size)
    hearts[2].set_title("fibres, endocardia, front half")
    scale_bar(hearts[0], 20)
    front, left, helix, thickness = lower.subplots(1, 4, width_ratios=(1, 1, 1.1, 1.1))
    to_left, back, up = torso_axes(heart.electrodes)
    centre = (heart.electrodes.min(axis=0) + heart.electrodes.max(axis=0)) / 2
    directions = np.array([to_left, up, back]), np.array([back, up, -to_left])
    for axes, rows, side in zip((front, left), directions, ("front", "left"), strict=True):
        _draw_torso(axes, View(f"torso, from the {side}", rows, centre), heart)
    colours = dict(zip(WALLS, (Colour.VERMILION, Colour.GREEN, Colour.BLUE), strict=True))
    _plot_helix(helix, check, colours)
    _plot_thickness(thickness, check, colours)
    return figure


def draw_heart(axes: Axes, heart: Heart, view: str) -> None:
    """Draw a heart's endocardia within its surface, with the root and direction of each bundle."""
    views = heart_views(heart)
    if not isinstance(view, str) or view not in views:
        raise InputError(f"view is {shown(view)}; give one of {', '.join(views)}")
    box = views[view].box(heart.vertices)
    outside = DrawnSurface(heart.vertices, heart.boundary[0], {"color": "#D9C2B8", "opacity": 0.3})
    _draw_seeds(axes, views[view], heart, box, largest([box]), outside)
    axes.set_title(f"{style.short(heart.name)}, {view}")
    scale_bar(axes, 20)


def _draw_seeds(
    axes: Axes, view: View, heart: Heart, box: Floats, size: Floats, *around: DrawnSurface
) -> None:
    """Draw the far walls of the endocardia, with the root and direction of each bundle."""
    colours = (LABELS[label][1] for label in ENDOCARDIA)
    pairs = list(zip(heart.endocardia, colours, strict=True))
    walls = [DrawnSurface(e.vertices, e.triangles, {"color": c, "opacity": 0.55}) for e, c in pairs]
    draw_surfaces(axes, view, *walls, *around, box=box, size=size)
    axes.set_title("endocardia and bundles (front)")
    for endocardium, colour in pairs:
        ends = endocardium.vertices[[endocardium.root, endocardium.direction]]
        root, towards = view.project(ends)[:, :2]
        axes.annotate("", towards, root, arrowprops={"arrowstyle": "-|>", "lw": 1.4})
        axes.plot(*root, "o", color=colour, markeredgecolor="black", markersize=6)
        away, side = ((5, 5), "left") if endocardium.side == "lv" else ((-5, 5), "right")
        name = f"{endocardium.side.upper()} root"
        axes.annotate(name, root, away, textcoords="offset points", ha=side)


def _draw_fibres(
    axes: Axes, view: View, heart: Heart, part: Booleans, step: int, box: Floats, size: Floats
) -> None:
    """Draw fibres next to a part of the boundary as short lines; `step` -1: seen from inside."""
    vertices = heart.vertices
    triangles, owner = (of_boundary[part] for of_boundary in heart.boundary)
    faces = triangles[:, ::step]
    surface = DrawnSurface(vertices, faces, {"color": Colour.LIGHT_GREY})
    draw_surfaces(axes, view, surface, box=box, size=size)
    visible = np.flatnonzero(view.facing(triangle_normals(vertices, faces)))
    visible = visible[:: 1 + len(visible) // 1500]
    middle = view.project(vertices[faces[visible]].mean(axis=1))[:, :2]
    length = 0.02 * float(np.ptp(vertices, axis=0).max())  # half, mm
    along = length * (heart.fibres[owner[visible]] @ view.axes[:2].T)
    lines = np.stack([middle - along, middle + along], axis=1)
    axes.add_collection(LineCollection(list(lines), colors="black", linewidths=0.6))


def _draw_torso(axes: Axes, view: View, heart: Heart) -> None:
    """Draw the heart, transparent skin and lungs, and the electrodes with their names."""
    parts = [DrawnSurface(heart.vertices, heart.boundary[0], {"color": Colour.VERMILION})]
    torso = heart.torso
    if torso is not None:
        lungs = torso.tetrahedra[torso.tissues == TorsoTissue.LUNG]
        tissue = np.concatenate([heart.tetrahedra, torso.tetrahedra])
        for cells, colour in ((lungs, "#9FC3D9"), (tissue, "#E4D2C3")):
            if len(cells):
                look = {"color": colour, "opacity": 0.4}
                parts.append(DrawnSurface(torso.vertices, boundary_triangles(cells)[0], look))
    vertices = heart.vertices if torso is None else torso.vertices
    electrodes, names = heart.electrode_positions, heart.electrode_names
    box = view.box(np.concatenate([vertices, electrodes]))
    draw_surfaces(axes, view, *parts, box=box, size=1.1 * np.ptp(box, axis=0))
    screen = view.project(electrodes)[:, :2]
    colours = [Colour.VERMILION] * 3 + [Colour.BLUE] * 6
    colours += [Colour.GREEN] * (len(names) - len(ELECTRODES))
    x, y = screen.T
    size = 22 if len(names) < 40 else 8
    axes.scatter(x, y, s=size, c=colours, edgecolors="white", linewidths=0.6, zorder=3)
    # offsets of names (points) that keep apart electrodes close together in either view
    away = {"RA": (-9, 4), "LA": (9, 4), "V1": (0, 5), "V2": (-11, 0), "V3": (-9, -9)}
    away |= {"V4": (2, -12), "V5": (0, 5), "V6": (6, -11)}
    shown: list[Floats] = []
    looks: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": "small"}
    for name, place in zip(names, screen, strict=True):
        covered = [other for other in shown if np.linalg.norm(place - other) < 25.0]  # mm
        if name in ELECTRODES or not covered:
            shown.append(place)
            axes.annotate(name, place, away.get(name, (0, 5)), **looks)
    scale_bar(axes, 100)


def _plot_helix(axes: Axes, check: HeartCheck, colours: Mapping[str, Colour]) -> None:
    """Plot median and interquartile range of the helix angle in ten layers of each wall."""
    axes.axhline(0, color=Colour.GREY, linewidth=0.5)
    edges = np.linspace(0, 1, 11)
    for name, helix in check.helix.items():
        layer = np.digitize(helix.depth, edges[1:-1])
        filled_layers = [k for k in range(10) if (layer == k).sum() > 5]
        if filled_layers:
            spread = np.array([_quartiles(helix.angle[layer == k]) for k in filled_layers]).T
            middle, colour = (edges[:-1] + edges[1:])[filled_layers] / 2, colours[name]
            axes.fill_between(middle, spread[0], spread[2], color=colour, alpha=0.15, lw=0)
            axes.plot(middle, spread[1], color=colour, label=name)
    axes.set(xlim=(0, 1), ylim=(-95, 95), yticks=range(-90, 91, 30))
    axes.set(title="fibre angles: median and IQR", xlabel="depth (0 endo, 1 epi)")
    axes.set_ylabel("helix angle (degrees)")
    if axes.lines[1:]:
        axes.legend()


def _quartiles(angle: Floats) -> Floats:
    """Quartiles of axes (degrees) about their mean axis; -90 and 90 are the same axis."""
    mean = np.degrees(np.angle(np.exp(2j * np.radians(angle)).sum())) / 2
    return np.asarray(mean + np.percentile((angle - mean + 90) % 180 - 90, [25, 50, 75]))


def _plot_thickness(axes: Axes, check: HeartCheck, colours: Mapping[str, Colour]) -> None:
    """Plot a histogram of the thickness of each wall, in percent of its points."""
    walls = {name: wall for name, wall in zip(WALLS, check.walls, strict=True) if wall.size}
    most = max((np.percentile(wall, 99) for wall in walls.values()), default=1.0)
    bins = np.linspace(0, float(most) * 1.1, 30).tolist()
    for name, wall in walls.items():
        share = np.full(wall.size, 100 / wall.size)
        axes.hist(
            wall, bins, weights=share, histtype="step", color=colours[name],
            label=f"{name}: {np.median(wall):.1f} mm",
        )  # fmt: skip
    axes.set(title="wall thickness", xlabel="wall thickness (mm)", ylabel="endocardial points (%)")
    if walls:
        axes.set_ylim(top=1.4 * axes.get_ylim()[1])  # room for the legend
        axes.legend(title="median", loc="upper right")
