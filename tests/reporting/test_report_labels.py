"""The picture of labels, on a block of tissue with two wells, where every area is known."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from fascicle.heart.labelled_surface import Label, LabelledSurface
from fascicle.mesh.measures import signed_volumes
from fascicle.mesh.topology import boundary_triangles
from fascicle.reporting.labels import COLOURS, VIEWS, label_areas, labels_figure

CELLS = (8, 4, 6)  # cells of 10 mm; x from right to left of the patient, y to the back, z upwards
LEFT, RIGHT = ((5, 7), (1, 3), (2, 6)), ((1, 3), (1, 3), (3, 6))
CUBE = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)
AREAS = {  # cm²: walls and floors of the wells, all outside but the top, the top less the wells
    Label.BASE: 32 - 8,
    Label.EPICARDIUM: 32 + 2 * (48 + 24),
    Label.LV_ENDOCARDIUM: 4 + 32,
    Label.RV_ENDOCARDIUM: 4 + 24,
}


@pytest.fixture(scope="module")
def surface():
    nodes = np.array([n + 1 for n in CELLS])
    vertices = 10.0 * np.indices(nodes).reshape(3, -1).T
    solid = np.ones(CELLS, dtype=bool)
    for well in (LEFT, RIGHT):
        solid[tuple(slice(*span) for span in well)] = False
    strides = np.array([nodes[1] * nodes[2], nodes[2], 1])
    corner = np.array([strides @ [b & 1, b >> 1 & 1, b >> 2] for b in range(8)])
    tetrahedra = ((np.argwhere(solid) @ strides)[:, None] + corner)[:, CUBE].reshape(-1, 4)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    triangles, _ = boundary_triangles(tetrahedra)
    if np.linalg.det(vertices[triangles]).sum() < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    centres = vertices[triangles].mean(axis=1)
    labels = np.full(len(triangles), Label.EPICARDIUM)
    for well, label in ((LEFT, Label.LV_ENDOCARDIUM), (RIGHT, Label.RV_ENDOCARDIUM)):
        low, high = 10.0 * np.array(well, dtype=float).T
        labels[((centres > low - 1e-9) & (centres < high + 1e-9)).all(axis=1)] = label
    labels[centres[:, 2] > 10.0 * CELLS[2] - 1e-9] = Label.BASE
    return LabelledSurface(vertices, triangles, labels.astype(np.int64), "block")


def test_areas(surface):
    assert label_areas(surface) == pytest.approx(AREAS)


def test_panels_and_legend(surface):
    figure = labels_figure(surface)
    assert [axes.get_title() for axes in figure.axes] == list(VIEWS)
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "LV endocardium\n36.0 cm²" in entries
    assert "epicardium\n176.0 cm²" in entries
    assert len(entries) == 4


def drawn(axes, label):
    """Triangles on the screen (k, 3, 2) that are drawn in the hue of a label (mm)."""
    drawing = axes.collections[0]
    colours, hue = drawing.get_facecolor()[:, :3], np.array(to_rgb(COLOURS[label]))
    shade = colours @ hue / (hue @ hue)
    alike = np.abs(colours - shade[:, None] * hue).max(axis=1) < 1e-6
    corners = np.array([path.vertices[:3] for path in drawing.get_paths()])
    return corners[alike]


def shown(axes, label):
    """Area (cm²) on the screen of what is drawn in the hue of a label."""
    corners = drawn(axes, label)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2 / 100


def test_each_view_shows_what_faces_it(surface):
    """The long axis leans from the left well's opening to a corner of its floor."""
    front, back, base, cast = labels_figure(surface).axes
    lean = 40 / np.hypot(40, np.hypot(10, 10))
    assert shown(base, Label.BASE) == pytest.approx(24 * lean, rel=0.02)
    assert shown(base, Label.LV_ENDOCARDIUM) > 4 * lean
    for axes in (front, back):
        assert shown(axes, Label.EPICARDIUM) > 40
    assert shown(cast, Label.EPICARDIUM) == 0
    assert shown(cast, Label.LV_ENDOCARDIUM) > shown(cast, Label.RV_ENDOCARDIUM) > 4


def test_left_is_on_the_right_from_the_front_and_from_the_base(surface):
    _, _, base, cast = labels_figure(surface).axes
    for axes in (base, cast):
        left, right = (
            drawn(axes, label)[..., 0].mean()
            for label in (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM)
        )
        assert left > right + 20
