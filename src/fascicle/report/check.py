"""One page on a heart: endocardia and seeds, fibres, body and electrodes, angles, thickness."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from fascicle.build.check import WALLS, HeartCheck
from fascicle.core.arrays import Floats, Integers
from fascicle.core.leads import ELECTRODES
from fascicle.heart.heart import Heart
from fascicle.heart.labelled_surface import Label
from fascicle.heart.torso import Torso, TorsoTissue
from fascicle.mesh.measures import triangle_normals, unit
from fascicle.mesh.topology import boundary_triangles
from fascicle.report.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    TICK_SIZE,
    TITLE_SIZE,
    VERMILION,
    finish_axes,
    new_figure,
    scale_bar,
    set_title,
)
from fascicle.report.labels import COLOURS as LABEL_COLOURS
from fascicle.report.painting import paint
from fascicle.report.rendering import View, heart_views

WIDTH, HEIGHT = 12.0, 7.6  # inch
MOST_FIBRES = 1500  # lines in one picture
FIBRE = 0.02  # half the length of such a line, of the heart's extent
HEART_BAR, BODY_BAR = 20.0, 100.0  # mm
CAST_OPACITY, GLASS_OPACITY = 0.55, 0.5
LAYERS, FEWEST_ANGLES = 10, 5  # through the wall; points in a layer that is drawn
THICKNESS_BINS, THICKEST = 30, 99.0  # edges; percentile up to which they reach
ROOM_FOR_LEGEND = 1.4  # times the highest bar
SKIN, LUNG = "#E4D2C3", "#9FC3D9"
WALL_COLOURS = dict(zip(WALLS, (VERMILION, GREEN, BLUE), strict=True))
FIRST = ELECTRODES.index("V1")  # of the chest electrodes


def check_figure(heart: Heart, check: HeartCheck) -> Figure:
    """Draw what a person should look at before trusting a heart.

    Parameters
    ----------
    heart : Heart
        The heart.
    check : HeartCheck
        What `fascicle.build.check.check_heart` found.

    Returns
    -------
    Figure
        Above: endocardia with the bundles' roots and directions, fibres on the epicardium and on
        the endocardia. Below: the body with its electrodes from the front and from the left;
        helix angles through the walls, and their thickness.
    """
    figure = new_figure(WIDTH, HEIGHT)
    halves = np.asarray(figure.subfigures(2, 1))
    upper = halves[0].subplots(1, 3)
    lower = halves[1].subplots(1, 4, width_ratios=(1, 1, 1.1, 1.1))
    views = heart_views(heart)
    _draw_seeds(upper[0], views["anterior"], heart, check)
    _draw_fibres(upper[1], views["anterior"], heart, check, (Label.EPICARDIUM,), "epicardium")
    endocardia = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
    _draw_fibres(upper[2], views["anterior"], heart, check, endocardia, "endocardia, front half")
    for axes, view in zip(lower, body_views(heart.electrodes), strict=False):
        _draw_body(axes, view, heart, check)
    _plot_helix(lower[2], check)
    _plot_thickness(lower[3], check)
    set_title(figure, heart.name)
    return figure


def body_views(electrodes: Floats) -> tuple[View, View]:
    """Cameras in front of a person and on the left, from the electrodes (9, 3) alone (mm)."""
    ra, la, ll = electrodes[:3]
    left = unit(la - ra)
    up = (ra + la) / 2 - ll
    up = unit(up - (up @ left) * left)
    back = np.cross(up, left)
    centre = (electrodes.min(axis=0) + electrodes.max(axis=0)) / 2
    return (
        View("from the front", np.array([left, up, back]), centre),
        View("from the left", np.array([back, up, -left]), centre),
    )


def _draw_seeds(axes: Axes, view: View, heart: Heart, check: HeartCheck) -> None:
    """Endocardia as casts, with where each bundle starts and where it heads."""
    for label, endocardium in zip(
        (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM), heart.endocardia, strict=True
    ):
        colour = LABEL_COLOURS[label]
        paint(
            axes, view, endocardium.vertices, endocardium.triangles, colour, alpha=CAST_OPACITY,
            autolim=True,
        )  # fmt: skip
        root, towards = view.project(
            endocardium.vertices[[endocardium.root, endocardium.direction]]
        )[:, :2]
        axes.annotate(
            "", towards, root, arrowprops={"arrowstyle": "-|>", "color": BLACK, "lw": 1.4}
        )
        axes.plot(*root, "o", color=colour, markeredgecolor=BLACK, markersize=6)
        axes.annotate(
            f"{endocardium.side.upper()} root", root, (4, 5), textcoords="offset points",
            fontsize=TICK_SIZE, color=BLACK,
        )  # fmt: skip
    _scale_bar(axes, HEART_BAR)
    _finish(axes, "endocardia and bundles (front)")


def _draw_fibres(
    axes: Axes, view: View, heart: Heart, check: HeartCheck, labels: tuple[Label, ...], title: str
) -> None:
    """Short lines along the fibres next to a part of the boundary."""
    vertices = heart.vertices
    triangles, owner = heart.boundary
    inward = Label.EPICARDIUM not in labels  # endocardia are seen as casts, from the tissue's side
    shown = np.flatnonzero(np.isin(check.mesh.labels, labels))
    faces = triangles[shown][:, ::-1] if inward else triangles[shown]
    paint(axes, view, vertices, faces, LABEL_COLOURS[Label.EPICARDIUM], autolim=True)
    visible = np.flatnonzero(view.facing(triangle_normals(vertices, faces)))
    visible = visible[:: 1 + len(visible) // MOST_FIBRES]
    middle = view.project(vertices[faces[visible]].mean(axis=1))[:, :2]
    length = FIBRE * float(np.ptp(vertices, axis=0).max())
    along = length * (heart.fibres[owner[shown[visible]]] @ view.axes[:2].T)
    lines = np.stack([middle - along, middle + along], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=BLACK, linewidths=0.6))
    _finish(axes, f"fibres, {title}")


def _draw_body(axes: Axes, view: View, heart: Heart, check: HeartCheck) -> None:
    """Skin and lungs as if of glass, the heart, and the electrodes by name."""
    if heart.torso is not None:
        for tissue, colour in ((None, SKIN), (TorsoTissue.LUNG, LUNG)):
            faces = outline(heart, heart.torso, tissue)
            if len(faces):
                paint(
                    axes, view, heart.torso.vertices, faces, colour, alpha=GLASS_OPACITY,
                    autolim=True,
                )  # fmt: skip
    paint(
        axes, view, heart.vertices, check.mesh.triangles, LABEL_COLOURS[Label.LV_ENDOCARDIUM],
        autolim=True,
    )  # fmt: skip
    screen = view.project(heart.electrodes)[:, :2]
    colours = [VERMILION if k < FIRST else BLUE for k in range(len(ELECTRODES))]
    axes.scatter(
        screen[:, 0], screen[:, 1], s=22, c=colours, edgecolors="white", linewidths=0.6, zorder=3
    )
    for name, position in zip(ELECTRODES, screen, strict=True):
        axes.annotate(
            name, position, (3, 3), textcoords="offset points", fontsize=TICK_SIZE - 1, color=BLACK
        )
    _scale_bar(axes, BODY_BAR)
    _finish(axes, f"body, {view.name}")


def outline(heart: Heart, torso: Torso, tissue: TorsoTissue | None) -> Integers:
    """Triangles (k, 3) around one tissue, or, if None, around all: the skin."""
    cells = (
        torso.tetrahedra[torso.tissues == tissue]
        if tissue is not None
        else np.concatenate([heart.tetrahedra, torso.tetrahedra])
    )
    return boundary_triangles(cells)[0]


def _plot_helix(axes: Axes, check: HeartCheck) -> None:
    """Median and middle half of the angles over depth, wall by wall."""
    axes.axhline(0, color=GREY, linewidth=0.5)
    edges = np.linspace(0, 1, LAYERS + 1)
    for name, helix in check.helix.items():
        layer = np.digitize(helix.depth, edges[1:-1])
        there = [k for k in range(LAYERS) if (layer == k).sum() > FEWEST_ANGLES]
        if not there:
            continue
        spread = np.array([_quartiles(helix.angle[layer == k]) for k in there]).T
        middle = (edges[:-1] + edges[1:])[there] / 2
        axes.fill_between(middle, spread[0], spread[2], color=WALL_COLOURS[name], alpha=0.15, lw=0)
        axes.plot(middle, spread[1], color=WALL_COLOURS[name], label=name)
    axes.set(xlim=(0, 1), ylim=(-95, 95), yticks=range(-90, 91, 30))
    if axes.lines[1:]:
        axes.legend(frameon=False, fontsize=TICK_SIZE)
    axes.set_title("fibre angles: median, middle half", fontsize=TITLE_SIZE)
    finish_axes(axes, "depth (0 inside, 1 outside)", "helix angle (degrees)")


def _quartiles(angle: Floats) -> Floats:
    """Quartiles of axes (degrees), which -90 and 90 are the same for: about their mean axis."""
    mean = np.degrees(np.angle(np.exp(2j * np.radians(angle)).sum())) / 2
    return np.asarray(mean + np.percentile((angle - mean + 90) % 180 - 90, [25, 50, 75]))


def _plot_thickness(axes: Axes, check: HeartCheck) -> None:
    """Share of each wall over its thickness."""
    walls = (check.walls.lv, check.walls.septum, check.walls.rv)
    largest = max(
        (np.percentile(w.thickness, THICKEST) for w in walls if w.thickness.size), default=1.0
    )
    bins = np.linspace(0, float(largest) * 1.1, THICKNESS_BINS)
    for name, wall in zip(WALLS, walls, strict=True):
        if wall.thickness.size:
            share = np.full(wall.thickness.size, 100 / wall.thickness.size)
            axes.hist(
                wall.thickness, bins.tolist(), weights=share, histtype="step",
                color=WALL_COLOURS[name], label=f"{name}: {wall.median:.1f} mm",
            )  # fmt: skip
    if any(wall.thickness.size for wall in walls):
        axes.set_ylim(top=ROOM_FOR_LEGEND * axes.get_ylim()[1])
        axes.legend(
            frameon=False, fontsize=TICK_SIZE, title="median", title_fontsize=TICK_SIZE,
            loc="upper right",
        )  # fmt: skip
    axes.set_title("wall thickness", fontsize=TITLE_SIZE)
    finish_axes(axes, "wall thickness (mm)", "endocardial points (%)")


def _finish(axes: Axes, title: str) -> None:
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(title, fontsize=TITLE_SIZE, color=BLACK)


def _scale_bar(axes: Axes, length: float) -> None:
    """Draw a bar below the picture, of so many mm."""
    axes.autoscale_view()
    scale_bar(axes, length, below=True)
