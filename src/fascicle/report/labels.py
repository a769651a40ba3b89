"""The labels of a closed surface of the ventricles, to be confirmed by eye."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import NEEDED, Label, LabelledMesh, LabelledSurface
from fascicle.mesh.measures import triangle_areas, unit
from fascicle.mesh.topology import boundary_loops
from fascicle.report.figures import (
    BLACK,
    BLUE,
    LABEL_SIZE,
    TICK_SIZE,
    TITLE_SIZE,
    VERMILION,
    new_figure,
)
from fascicle.report.rendering import View, back_to_front, smooth_normals

# Okabe and Ito's palette, and a light grey for what the others stand out from.
COLOURS = {
    Label.BASE: "#F0E442",
    Label.EPICARDIUM: "#C4C4C4",
    Label.LV_ENDOCARDIUM: VERMILION,
    Label.RV_ENDOCARDIUM: BLUE,
    Label.MITRAL: "#E69F00",
    Label.AORTIC: "#CC79A7",
    Label.TRICUSPID: "#009E73",
    Label.PULMONARY: "#56B4E9",
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
    figure = new_figure(len(VIEWS) * PANEL + LEGEND, PANEL * float(height / width) + 0.6)
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
    _scale_bar(panels[0])
    figure.legend(
        handles=_legend(surface), loc="outside right center", frameon=False, fontsize=LABEL_SIZE
    )
    figure.suptitle(surface.name, fontsize=TITLE_SIZE, x=0.01, ha="left")
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
    rims = boundary_loops(left_cavity)
    if not rims:
        raise InputError(
            f"{surface.name}: the LV endocardium is closed; label the base, where it is open"
        )
    opening = surface.vertices[max(rims, key=len)].mean(axis=0)
    wall = surface.vertices[np.unique(left_cavity)]
    up = unit(opening - wall[np.argmax(np.linalg.norm(wall - opening, axis=1))])
    left = wall.mean(axis=0) - surface.vertices[np.unique(right_cavity)].mean(axis=0)
    left = unit(left - (left @ up) * up)
    back = np.cross(up, left)
    frame = np.array([left, back, up])
    along = surface.vertices[np.unique(surface.triangles)] @ frame.T
    centre = (along.min(axis=0) + along.max(axis=0)) / 2 @ frame
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
    order = back_to_front(view, surface.vertices, triangles)
    normals = smooth_normals(surface.vertices, triangles)[order]
    palette = np.array([to_rgb(COLOURS[Label(label)]) for label in labels[order]])
    colours = palette * view.shade(normals)[:, np.newaxis]
    # a hairline in the face's own colour closes the gaps that antialiasing leaves
    axes.add_collection(
        PolyCollection(
            list(view.project(surface.vertices[triangles[order]])[..., :2]), facecolors=colours,
            edgecolors=colours, linewidths=0.35, rasterized=True,
        ),
        autolim=False,
    )  # fmt: skip


def _legend(surface: LabelledSurface | LabelledMesh) -> list[Patch]:
    return [
        Patch(facecolor=COLOURS[label], label=f"{NAMES[label]}\n{area:.1f} cm²")
        for label, area in label_areas(surface).items()
    ]


def _scale_bar(axes: Axes) -> None:
    (left, _), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    axes.plot([left, left + SCALE_BAR], [bottom] * 2, color=BLACK, linewidth=2, clip_on=False)
    axes.text(
        left + SCALE_BAR / 2, bottom + 0.015 * (top - bottom), f"{SCALE_BAR:.0f} mm", ha="center",
        va="bottom", fontsize=TICK_SIZE, color=BLACK,
    )  # fmt: skip
