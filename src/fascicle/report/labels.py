"""The labels of a closed surface of the ventricles, to be confirmed by eye."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import NEEDED, Label, LabelledMesh, LabelledSurface
from fascicle.mesh.measures import triangle_areas
from fascicle.mesh.topology import boundary_loops
from fascicle.report.figures import (
    BLACK,
    BLUE,
    GREEN,
    LEGEND_STYLE,
    ORANGE,
    PURPLE,
    SKY,
    TITLE_SIZE,
    VERMILION,
    YELLOW,
    new_figure,
    scale_bar,
    set_title,
)
from fascicle.report.painting import paint
from fascicle.report.rendering import View, upright_frame

# Okabe and Ito's palette, and a light grey for what the others stand out from.
COLOURS = {
    Label.BASE: YELLOW,
    Label.EPICARDIUM: "#C4C4C4",
    Label.LV_ENDOCARDIUM: VERMILION,
    Label.RV_ENDOCARDIUM: BLUE,
    Label.MITRAL: ORANGE,
    Label.AORTIC: PURPLE,
    Label.TRICUSPID: GREEN,
    Label.PULMONARY: SKY,
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
MARGIN = 1.04  # frame over surface
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

    Raises
    ------
    InputError
        If one of the labels is missing, or an endocardium is not open.
    """
    for label in NEEDED:
        if not (surface.labels == label).any():
            raise InputError(
                f"{surface.name}: no triangle is labelled {NAMES[label]} ({label.value}); label "
                "the whole surface"
            )
    views = _views(surface)
    corners = [view.project(surface.vertices[surface.triangles])[..., :2] for view in views]
    boxes = [(c.min(axis=(0, 1)), c.max(axis=(0, 1))) for c in corners]
    width, height = MARGIN * np.max([high - low for low, high in boxes], axis=0)
    figure = new_figure(len(VIEWS) * PANEL + LEGEND, PANEL * float(height / width) + TITLE_ROOM)
    panels = figure.subplots(1, len(VIEWS))
    for axes, view, (low, high) in zip(panels, views, boxes, strict=True):
        _draw(axes, view, surface, cast=view.name == VIEWS[-1])
        middle = (low + high) / 2
        axes.set(
            xlim=(middle[0] - width / 2, middle[0] + width / 2),
            ylim=(middle[1] - height / 2, middle[1] + height / 2),
            aspect="equal",
        )
        axes.set_axis_off()
        axes.set_title(view.name, fontsize=TITLE_SIZE, color=BLACK)
    scale_bar(panels[0], SCALE_BAR)
    figure.legend(handles=_legend(surface), loc="outside right center", **LEGEND_STYLE)
    set_title(figure, surface.name)
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
    loops = boundary_loops(left_cavity)
    if not loops:
        raise InputError(
            f"{surface.name}: the LV endocardium is closed; label the base, where it is open"
        )
    opening = surface.vertices[max(loops, key=len)].mean(axis=0)
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


def _legend(surface: LabelledSurface | LabelledMesh) -> list[Patch]:
    return [
        Patch(facecolor=COLOURS[label], label=f"{NAMES[label]}\n{area:.1f} cm²")
        for label, area in label_areas(surface).items()
    ]
