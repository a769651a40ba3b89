"""The pictures by which a heart and the labels of its surface are judged."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from scipy.spatial import cKDTree

from fascicle.build.check import check_heart
from fascicle.core.leads import ELECTRODES
from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.purkinje.chart import build_chart
from fascicle.reporting.heart import LABELS, check_figure, label_areas, labels_figure

AREAS = {  # cm²: walls and floors of the wells, all outside but the top, the top less the wells
    Label.BASE: (32 - 8) / 4,
    Label.EPICARDIUM: (32 + 2 * (48 + 24)) / 4,
    Label.LV_ENDOCARDIUM: (4 + 32) / 4,
    Label.RV_ENDOCARDIUM: (4 + 24) / 4,
}


@pytest.fixture(scope="module")
def surface(block):
    triangles = block.boundary[0]
    labels = np.full(len(triangles), Label.EPICARDIUM)
    centres = block.vertices[triangles].mean(axis=1)
    for cavity, label in ((block.lv, Label.LV_ENDOCARDIUM), (block.rv, Label.RV_ENDOCARDIUM)):
        walls = cKDTree(cavity.vertices[cavity.triangles].mean(axis=1))
        labels[walls.query(centres)[0] < 1e-6] = label
    labels[centres[:, 2] > block.vertices[:, 2].max() - 1e-9] = Label.BASE
    return LabelledSurface(block.vertices, triangles, labels.astype(np.int64), "block")


def shown(axes, label):
    """Area (cm²) that a panel shows in the hue of a label, and where its middle is (0 to 1)."""
    image = axes.images[0]
    colours = np.asarray(image.get_array())[..., :3] / 255
    hue = np.array(to_rgb(LABELS[label][1]))
    shade = colours @ hue / (hue @ hue)
    alike = np.abs(colours - shade[..., None] * hue).max(axis=2) < 0.03
    alike &= shade < 1.1  # not white
    left, right, bottom, top = image.get_extent()
    area = alike.mean() * (right - left) * (top - bottom) / 100
    return area, np.flatnonzero(alike.any(axis=0)).mean() / alike.shape[1] if area else np.nan


def test_areas_are_in_the_legend_and_each_view_shows_what_faces_it(surface):
    assert label_areas(surface) == pytest.approx(AREAS)
    figure = labels_figure(surface)
    assert [axes.get_title() for axes in figure.axes] == [
        "front", "back", "base", "front, without epicardium",
    ]  # fmt: skip
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries == [
        "base\n6.0 cm²", "epicardium\n44.0 cm²", "LV endocardium\n9.0 cm²",
        "RV endocardium\n7.0 cm²",
    ]  # fmt: skip
    # The long axis leans from the left well's opening to a corner of its floor.
    front, back, base, cast = labels_figure(surface).axes
    lean = 20 / np.hypot(20, np.hypot(5, 5))
    assert shown(base, Label.BASE)[0] == pytest.approx(6 * lean, rel=0.05)
    assert shown(base, Label.LV_ENDOCARDIUM)[0] > 0.9 * lean
    for axes in (front, back):
        assert shown(axes, Label.EPICARDIUM)[0] > 10
    assert shown(cast, Label.EPICARDIUM)[0] < 0.1
    assert shown(cast, Label.LV_ENDOCARDIUM)[0] > shown(cast, Label.RV_ENDOCARDIUM)[0] > 1
    for axes in (base, cast):  # the left is on the right
        left, right = (
            shown(axes, label)[1] for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
        )
        assert left > right + 0.2


@pytest.fixture(scope="module")
def checked(default_heart):
    charts = {e.side: build_chart(e) for e in default_heart.endocardia}
    return check_figure(default_heart, check_heart(default_heart, charts))


def test_the_page_on_a_heart_names_what_it_shows_with_what_room_there_is(checked):
    assert [axes.get_title() for axes in checked.axes] == [
        "endocardia and bundles (front)", "fibres, epicardium", "fibres, endocardia, front half",
        "torso, from the front", "torso, from the left", "fibre angles: median and IQR",
        "wall thickness",
    ]  # fmt: skip
    seeds, *_, front, left, helix, thickness = checked.axes
    assert {"LV root", "RV root", "20 mm"} <= {text.get_text() for text in seeds.texts}
    for axes in (front, left):
        assert {*ELECTRODES, "100 mm"} == {text.get_text() for text in axes.texts}
    assert helix.get_ylabel() == "helix angle (degrees)"
    assert thickness.get_xlabel() == "wall thickness (mm)"
    names = [text.get_text() for text in thickness.get_legend().get_texts()]
    assert [name.split(":")[0] for name in names] == ["LV free wall", "septum", "RV free wall"]
    checked.canvas.draw()
    upper, lower = checked.axes[:3], checked.axes[3:]
    inch = checked.dpi
    top, bottom = (f(a.get_window_extent().get_points()[k, 1] for a in upper)
                   for f, k in ((min, 1), (max, 0)))  # fmt: skip
    assert (checked.bbox.height - top) / inch < 1.0
    assert (bottom - max(axes.get_window_extent().y1 for axes in lower)) / inch < 1.0
    assert upper[0].get_window_extent().width > 0.28 * checked.bbox.width
