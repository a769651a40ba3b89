"""The labels of a closed surface of the ventricles, to be confirmed by eye."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fascicle.heart.labelled_surface import Label, LabelledMesh, LabelledSurface
from fascicle.mesh.measures import triangle_areas
from fascicle.mesh.topology import boundary_loops
from fascicle.reporting import style
from fascicle.reporting.figures import new_figure
from fascicle.reporting.rendering import View, frame_panel, frame_size, paint, upright_frame

# Okabe and Ito's palette, and a light grey for what the others stand out from.
COLOURS = {
    Label.BASE: style.YELLOW,
    Label.EPICARDIUM: "#C4C4C4",
    Label.LV_ENDOCARDIUM: style.VERMILION,
    Label.RV_ENDOCARDIUM: style.BLUE,
    Label.MITRAL: style.ORANGE,
    Label.AORTIC: style.PURPLE,
    Label.TRICUSPID: style.GREEN,
    Label.PULMONARY: style.SKY,
}
NAMES = {
    Label.BASE: "base",
    Label.EPICARDIUM: "epicardium",
    Label.LV_ENDOCARDIUM: "LV endocardium",
    Label.RV_ENDOCARDIUM: "RV endocardium",
    Label.MITRAL: "mitral valve",
    Label.AORTIC: "aortic valve",
    Label.TRICUSPID: "tricuspid valve",
    Label.PULMONARY: "pulmonary valve",
}
ENDOCARDIA = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
VIEWS = ("front", "back", "base", "front, without epicardium")
PANEL = 2.6  # width, inch
LEGEND = 1.9
TITLE_ROOM = 0.6  # inch, above the panels
SCALE_BAR = 20.0  # mm
MM2_PER_CM2 = 100.0


def labels_figure(surface: LabelledSurface | LabelledMesh) -> Figure:
    """Draw labels from the front, the back and the base, and without its epicardium.

    Parameters
    ----------
    surface : LabelledSurface or LabelledMesh
        Closed, or a mesh's boundary, with base, epicardium and both endocardia, in any frame.

    Returns
    -------
    Figure
        The views of `VIEWS`, all in one scale, in which every label has a colour; the legend gives
        the area of each. The front is where it is if LV and RV are labelled rightly.
    """
    views = _views(surface)
    shown = surface.vertices[np.unique(surface.triangles)]
    boxes = [view.box(shown) for view in views]
    size = frame_size(boxes)
    shape = float(size[1] / size[0])
    figure = new_figure(len(VIEWS) * PANEL + LEGEND, PANEL * shape + TITLE_ROOM)
    panels = figure.subplots(1, len(VIEWS))
    for axes, view, box in zip(panels, views, boxes, strict=True):
        _draw(axes, view, surface, cast=view.name == VIEWS[-1])
        frame_panel(axes, box, size, view.name)
    style.scale_bar(panels[0], SCALE_BAR)
    legend = [
        Patch(facecolor=COLOURS[label], label=f"{NAMES[label]}\n{area:.1f} cm²")
        for label, area in label_areas(surface).items()
    ]
    figure.legend(handles=legend, loc="outside right center", **style.LEGEND_STYLE)
    style.set_title(figure, surface.name)
    return figure


def label_areas(surface: LabelledSurface | LabelledMesh) -> dict[Label, float]:
    """Area (cm²) of each label that the surface has."""
    areas = triangle_areas(surface.vertices, surface.triangles)
    return {
        label: float(areas[surface.labels == label].sum()) / MM2_PER_CM2
        for label in Label
        if (surface.labels == label).any()
    }


def _views(surface: LabelledSurface | LabelledMesh) -> list[View]:
    """Cameras in the frame of the left cavity's opening and apex and of the right cavity."""
    left_cavity, right_cavity = (surface.having(label) for label in ENDOCARDIA)
    opening = surface.vertices[max(boundary_loops(left_cavity), key=len)].mean(axis=0)
    wall = surface.vertices[np.unique(left_cavity)]
    apex = wall[np.argmax(np.linalg.norm(wall - opening, axis=1))]
    towards_left = wall.mean(axis=0) - surface.vertices[np.unique(right_cavity)].mean(axis=0)
    (left, back, up), centre = upright_frame(
        opening - apex, towards_left, surface.vertices[np.unique(surface.triangles)]
    )
    rows = ((left, up, back), (-left, up, -back), (left, back, -up), (left, up, back))
    return [View(name, np.array(axes), centre) for name, axes in zip(VIEWS, rows, strict=True)]


def _draw(axes: Axes, view: View, surface: LabelledSurface | LabelledMesh, *, cast: bool) -> None:
    """Painter's algorithm; as a cast, without epicardium and with cavities as if they were full."""
    triangles, labels = surface.triangles, surface.labels
    if cast:
        shown = labels != Label.EPICARDIUM
        triangles, labels = triangles[shown], labels[shown]
        walls = np.isin(labels, ENDOCARDIA)
        triangles = np.where(walls[:, np.newaxis], triangles[:, ::-1], triangles)
    colours = np.array([to_rgb(COLOURS[Label(label)]) for label in labels])
    paint(axes, view, surface.vertices, triangles, colours)
