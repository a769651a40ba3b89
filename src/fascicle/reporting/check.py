"""One page on a heart: endocardia and seeds, fibres, body and electrodes, angles, thickness."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from fascicle.build.check import WALLS, HeartCheck
from fascicle.core.arrays import Booleans, Floats
from fascicle.core.leads import ELECTRODES
from fascicle.heart.heart import Heart, TorsoTissue
from fascicle.heart.labelled_surface import Label
from fascicle.mesh.measures import triangle_normals
from fascicle.mesh.topology import boundary_triangles
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.labels import COLOURS, ENDOCARDIA
from fascicle.reporting.rendering import View, frame_panel, frame_size, heart_views, paint
from fascicle.torso.variation.conductor import body_axes

WIDTH, BELOW = 12.0, 3.8  # inch; of the lower half
HEARTS, HEART_ROOM = 3, 0.75  # pictures in the upper half; inch for their titles and scale bar
MOST_FIBRES = 1500  # lines in one picture
FIBRE = 0.02  # half the length of such a line, of the heart's extent
HEART_BAR, BODY_BAR = 20.0, 100.0  # mm
CAST_OPACITY, GLASS_OPACITY = 0.55, 0.5
LAYERS, FEWEST_ANGLES = 10, 5  # through the wall; points in a layer that is drawn
THICKNESS_BINS, THICKEST = 30, 99.0  # edges; percentile up to which they reach
ROOM_FOR_LEGEND = 1.4  # times the highest bar
SKIN, LUNG = "#E4D2C3", "#9FC3D9"
WALL_COLOURS = dict(zip(WALLS, (style.VERMILION, style.GREEN, style.BLUE), strict=True))
FIRST = ELECTRODES.index("V1")  # of the chest electrodes
BODY_POINTS = 190  # height of a body in the figure, typographic points
NAME_SIZE = np.array([14.0, 9.0])  # of an electrode's name with its margins, of such points


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
    view = heart_views(heart)["anterior"]
    box = view.box(heart.vertices)
    size = frame_size([box])
    above = WIDTH / HEARTS * float(size[1] / size[0]) + HEART_ROOM
    figure = new_figure(WIDTH, above + BELOW)
    halves = np.asarray(figure.subfigures(2, 1, height_ratios=(above, BELOW)))
    upper = halves[0].subplots(1, HEARTS)
    lower = halves[1].subplots(1, 4, width_ratios=(1, 1, 1.1, 1.1))
    _draw_seeds(upper[0], view, heart)
    epicardium = check.mesh.labels == Label.EPICARDIUM
    _draw_fibres(upper[1], view, heart, epicardium, "epicardium")
    cavities = np.isin(check.mesh.labels, ENDOCARDIA)
    _draw_fibres(upper[2], view, heart, cavities, "endocardia, front half", cast=True)
    for axes in upper:
        frame_panel(axes, box, size, axes.get_title())
    style.scale_bar(upper[0], HEART_BAR, below=True)
    for axes, view in zip(lower, body_views(heart.electrodes), strict=False):
        _draw_body(axes, view, heart)
    _plot_helix(lower[2], check)
    _plot_thickness(lower[3], check)
    style.set_title(figure, heart.name)
    return figure


def body_views(electrodes: Floats) -> tuple[View, View]:
    """Cameras in front of a person and on the left, from the electrodes (9, 3) alone (mm)."""
    left, back, up = body_axes(electrodes)
    centre = (electrodes.min(axis=0) + electrodes.max(axis=0)) / 2
    return (
        View("from the front", np.array([left, up, back]), centre),
        View("from the left", np.array([back, up, -left]), centre),
    )


def _draw_seeds(axes: Axes, view: View, heart: Heart) -> None:
    """Endocardia as casts, with where each bundle starts and where it heads."""
    for label, endocardium in zip(ENDOCARDIA, heart.endocardia, strict=True):
        vertices, colour = endocardium.vertices, COLOURS[label]
        paint(axes, view, vertices, endocardium.triangles, colour, alpha=CAST_OPACITY)
        seed = [endocardium.root, endocardium.direction]
        root, towards = view.project(vertices[seed])[:, :2]
        axes.annotate(
            "", towards, root, arrowprops={"arrowstyle": "-|>", "color": style.BLACK, "lw": 1.4}
        )
        axes.plot(*root, "o", color=colour, markeredgecolor=style.BLACK, markersize=6)
        away, side = ((5, 5), "left") if endocardium.side == "lv" else ((-5, 5), "right")
        axes.annotate(  # each on its ventricle's side, away from the other bundle
            f"{endocardium.side.upper()} root", root, away, textcoords="offset points",
            fontsize=style.TICK_SIZE, color=style.BLACK, ha=side,
        )  # fmt: skip
    axes.set_title("endocardia and bundles (front)")


def _draw_fibres(
    axes: Axes, view: View, heart: Heart, part: Booleans, title: str, *, cast: bool = False
) -> None:
    """Short lines along the fibres next to a part of the boundary, or its cast, from the tissue."""
    vertices = heart.vertices
    triangles, owner = (of_boundary[part] for of_boundary in heart.boundary)
    faces = triangles[:, ::-1] if cast else triangles
    paint(axes, view, vertices, faces, COLOURS[Label.EPICARDIUM])
    visible = np.flatnonzero(view.facing(triangle_normals(vertices, faces)))
    visible = visible[:: 1 + len(visible) // MOST_FIBRES]
    middle = view.project(vertices[faces[visible]].mean(axis=1))[:, :2]
    length = FIBRE * float(np.ptp(vertices, axis=0).max())
    along = length * (heart.fibres[owner[visible]] @ view.axes[:2].T)
    lines = np.stack([middle - along, middle + along], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=style.BLACK, linewidths=0.6))
    axes.set_title(f"fibres, {title}")


def _draw_body(axes: Axes, view: View, heart: Heart) -> None:
    """Skin and lungs as if of glass, the heart, and the electrodes by name."""
    torso = heart.torso
    if torso is not None:
        body = np.concatenate([heart.tetrahedra, torso.tetrahedra])
        lungs = torso.tetrahedra[torso.tissues == TorsoTissue.LUNG]
        for cells, colour in ((body, SKIN), (lungs, LUNG)):
            if len(cells):
                faces, _ = boundary_triangles(cells)
                paint(axes, view, torso.vertices, faces, colour, alpha=GLASS_OPACITY)
    paint(axes, view, heart.vertices, heart.boundary[0], COLOURS[Label.LV_ENDOCARDIUM])
    screen = view.project(heart.electrodes)[:, :2]
    colours = [style.VERMILION if k < FIRST else style.BLUE for k in range(len(ELECTRODES))]
    axes.scatter(
        screen[:, 0], screen[:, 1], s=22, c=colours, edgecolors="white", linewidths=0.6, zorder=3
    )
    points = screen * BODY_POINTS / np.ptp(axes.dataLim.intervaly)
    for name, position, away in zip(ELECTRODES, screen, label_places(points), strict=True):
        axes.annotate(
            name, position, tuple(away), textcoords="offset points", fontsize=style.TICK_SIZE - 1,
            color=style.BLACK, ha="center", va="center",
            arrowprops={"arrowstyle": "-", "color": style.GREY, "lw": 0.4, "shrinkB": 2},
        )  # fmt: skip
    axes.autoscale_view()
    style.scale_bar(axes, BODY_BAR, below=True)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"body, {view.name}", fontsize=style.TITLE_SIZE, color=style.BLACK)


def label_places(points: Floats) -> Floats:
    """Where to write short names near points (n, 2) so that they hide neither points nor names.

    Parameters
    ----------
    points : (n, 2) array
        In typographic points.

    Returns
    -------
    (n, 2) array
        From each point to the middle of its name.
    """
    angles = np.radians(np.arange(45, 405, 30))
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1) * NAME_SIZE
    candidates = np.concatenate([share * around for share in (0.8, 1.4, 2.0, 2.6)])
    taken, places = list(points), []
    for point in points:
        apart = np.abs((point + candidates)[:, np.newaxis] - np.array(taken)) / NAME_SIZE
        # of a name whose middle is so far away, in either direction
        free = (apart >= 1).any(axis=2)
        of_points = (apart[:, : len(points)] >= 0.7).any(axis=2)
        good = free[:, len(points) :].all(axis=1) & of_points.all(axis=1)
        best = int(np.argmax(good)) if good.any() else int(np.argmax(free.sum(axis=1)))
        taken.append(point + candidates[best])
        places.append(candidates[best])
    return np.array(places)


def _plot_helix(axes: Axes, check: HeartCheck) -> None:
    """Median and middle half of the angles over depth, wall by wall."""
    axes.axhline(0, color=style.GREY, linewidth=0.5)
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
        axes.legend(frameon=False, fontsize=style.TICK_SIZE)
    axes.set_title("fibre angles: median, middle half", fontsize=style.TITLE_SIZE)
    style.finish_axes(axes, "depth (0 inside, 1 outside)", "helix angle (degrees)")


def _quartiles(angle: Floats) -> Floats:
    """Quartiles of axes (degrees), which -90 and 90 are the same for: about their mean axis."""
    mean = np.degrees(np.angle(np.exp(2j * np.radians(angle)).sum())) / 2
    return np.asarray(mean + np.percentile((angle - mean + 90) % 180 - 90, [25, 50, 75]))


def _plot_thickness(axes: Axes, check: HeartCheck) -> None:
    """Share of each wall over its thickness."""
    walls = dict(zip(WALLS, (check.walls.lv, check.walls.septum, check.walls.rv), strict=True))
    walls = {name: wall for name, wall in walls.items() if wall.thickness.size}
    largest = max((np.percentile(w.thickness, THICKEST) for w in walls.values()), default=1.0)
    bins = np.linspace(0, float(largest) * 1.1, THICKNESS_BINS).tolist()
    for name, wall in walls.items():
        share = np.full(wall.thickness.size, 100 / wall.thickness.size)
        axes.hist(
            wall.thickness, bins, weights=share, histtype="step", color=WALL_COLOURS[name],
            label=f"{name}: {wall.median:.1f} mm",
        )  # fmt: skip
    if walls:
        axes.set_ylim(top=ROOM_FOR_LEGEND * axes.get_ylim()[1])
        axes.legend(
            frameon=False, fontsize=style.TICK_SIZE, title="median", title_fontsize=style.TICK_SIZE,
            loc="upper right",
        )  # fmt: skip
    axes.set_title("wall thickness", fontsize=style.TITLE_SIZE)
    style.finish_axes(axes, "wall thickness (mm)", "endocardial points (%)")
