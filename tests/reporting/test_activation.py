"""Surfaces and activations, on the block, where it is known what every view shows."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from fascicle.core.errors import InputError
from fascicle.heart.endocardium import Endocardium
from fascicle.heart.heart import Heart
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.reporting import surfaces
from fascicle.reporting.activation import ActivationRow, activation_figure, spread_figure
from fascicle.reporting.style import new_figure
from fascicle.reporting.surfaces import DrawnSurface, draw_surfaces, heart_views

CELL, WIDTH = 5.0, 40.0  # mm
VIEWS = ("RV side", "anterior", "LV side", "base")


def turned(heart):
    """The same heart in another frame."""
    matrix, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    matrix *= np.linalg.det(matrix)

    def moved(positions):
        return positions @ matrix.T + [30.0, -80.0, 12.0]

    sides = [
        Endocardium(e.side, moved(e.vertices), e.triangles, e.root, e.direction)
        for e in heart.endocardia
    ]
    fibres = heart.fibres @ matrix.T
    return Heart(moved(heart.vertices), heart.tetrahedra, fibres, *sides, heart.electrodes)


def test_views_are_rotations_with_the_left_cavity_on_the_right_seen_from_the_front(block):
    views = heart_views(block)
    assert tuple(views) == VIEWS
    for view in views.values():
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.cross(view.axes[0], view.axes[1]), -view.axes[2], atol=1e-12)
    cavities = [e.vertices.mean(axis=0) for e in (block.rv, block.lv)]
    for name in ("anterior", "base"):
        right, left = views[name].project(np.array(cavities))
        assert left[0] - right[0] == pytest.approx(4 * CELL, rel=0.05)
    near = {name: [views[name].project(c)[2] for c in cavities] for name in views}
    assert near["RV side"][0] < near["RV side"][1]
    assert near["LV side"][1] < near["LV side"][0]


@pytest.mark.parametrize("name", VIEWS)
def test_views_follow_the_heart_into_any_frame(block, name):
    # the corners of the well's floor are equally far from the base: rounding must not choose
    floor = block.lv.vertices.copy()
    floor[np.lexsort(floor.T)[0]] -= [0.1, 0.1, 0.1]
    heart = replace(block, lv=Endocardium("lv", floor, block.lv.triangles, 0, 1))
    here = heart_views(heart)[name].project(heart.vertices)
    other = turned(heart)
    np.testing.assert_allclose(heart_views(other)[name].project(other.vertices), here, atol=1e-9)


def drawn(block, colour="red"):
    """The block from the front, with a margin."""
    axes, view = new_figure(3, 3).subplots(), heart_views(block)["anterior"]
    box = view.box(block.vertices)
    surface = DrawnSurface(block.vertices, block.boundary[0], {"color": colour})
    draw_surfaces(axes, view, surface, box=box, size=1.2 * np.ptp(box, axis=0))
    return axes, view


def test_a_surface_is_where_its_view_puts_it_and_faces_the_eye(block, pixels):
    """Just within the corners of its outline it is painted, just outside it is not."""
    axes, view = drawn(block)
    screen = view.project(block.vertices)[:, :2]
    corners, middle = screen[ConvexHull(screen).vertices], screen.mean(axis=0)
    assert axes.get_title() == "anterior"
    inside = pixels(axes, middle + 0.98 * (corners - middle))
    outside = pixels(axes, middle + 1.02 * (corners - middle))
    assert (inside[:, 1:] < 0.1).all()
    assert (outside == 1.0).all()
    # Turned inside out, the block shows its inner walls, not the near face.
    view = heart_views(block)["anterior"]
    middle = view.project(block.vertices.mean(axis=0)[None])[:, :2]
    axes = new_figure(3, 3).subplots()
    near = DrawnSurface(block.vertices, block.boundary[0], {"color": "red"})
    far = DrawnSurface(block.vertices, block.boundary[0][:, ::-1], {"color": "blue"})
    box = view.box(block.vertices)
    draw_surfaces(axes, view, near, far, box=box, size=np.ptp(box, axis=0))
    assert np.argmax(pixels(axes, middle)[0]) == 0
    draw_surfaces(axes, view, far, box=box, size=np.ptp(box, axis=0))
    shown = np.asarray(axes.images[-1].get_array())
    assert np.argmax(shown[shown.shape[0] // 2, shown.shape[1] // 2, :3]) == 2


def test_where_nothing_renders_the_panel_says_so(block, monkeypatch):
    monkeypatch.setattr(surfaces, "_plotter", lambda: None)
    axes, _ = drawn(block)
    assert not axes.images
    assert "neither EGL nor OSMesa" in axes.texts[0].get_text()


def tree_in(endocardium):
    lengths = np.array([0.0, CELL, CELL, CELL])
    parents = np.array([-1, 0, 1, 1])
    return PurkinjeTree(endocardium.side, endocardium.vertices[:4], parents, lengths)


def rows(heart):
    activation = 20 + heart.vertices[:, 0]  # 20 to 60 ms, from right to left
    trees = tuple((tree_in(e), np.array([0.0, 10, 30, 45])) for e in heart.endocardia)
    return [ActivationRow("before", activation, trees), ActivationRow("after", activation + 37)]


def test_rows_share_one_scale_with_the_trees_in_their_cavities(block, pixels):
    figure = activation_figure(block, rows(block))
    *panels, bar = figure.axes
    assert len(panels) == 2 * (len(VIEWS) + 2)
    assert bar.get_ylabel() == "time since the first activation (ms)"
    norms = [c.norm for axes in panels for c in axes.collections if c.get_array() is not None]
    assert len({id(norm) for norm in norms}) == 1
    np.testing.assert_allclose(norms[0].boundaries, np.arange(20, 101, 5))
    assert norms[0].extend == "min"  # roots fire before any tissue
    widths = [np.ptp(axes.get_xlim()) for axes in panels]
    assert np.ptp(widths[: len(VIEWS)]) < 1e-9
    assert widths[0] > WIDTH
    assert widths[4] == pytest.approx(widths[5])
    assert widths[4] < widths[0]
    assert [t.get_text() for t in panels[0].texts] == ["before"]
    assert [axes.get_title() for axes in panels[:6]] == [
        *VIEWS, "LV Purkinje network", "RV Purkinje network",
    ]  # fmt: skip
    axes = next(a for a in figure.axes if a.get_title() == "LV Purkinje network")
    coloured = [c for c in axes.collections if c.get_array() is not None]
    assert sorted(np.concatenate([c.get_array() for c in coloured])) == [10.0, 30.0, 45.0]
    centre = heart_views(block)["LV side"].project(block.lv.vertices.mean(axis=0)[None])[:, :2]
    assert pixels(axes, centre).min() < 0.99  # the wall is behind them


def test_surface_has_the_colours_of_its_times(block, pixels):
    """In the front view the band changes every 5 mm, in the hues of the colour bar."""
    figure = activation_figure(block, rows(block)[:1])
    axes, view = figure.axes[1], heart_views(block)["anterior"]
    middles = np.arange(2.5, WIDTH, 5)
    places = np.column_stack([middles, np.zeros(8), np.full(8, 12.0)])
    shown = pixels(axes, view.project(places)[:, :2])
    norm = figure.axes[-1]._colorbar.norm
    expected = matplotlib.colormaps["viridis_r"](norm(20 + middles))[:, :3]
    hue, wanted = (c / np.linalg.norm(c, axis=1, keepdims=True) for c in (shown, expected))
    np.testing.assert_allclose(hue, wanted, atol=0.03)
    brightness = np.linalg.norm(shown, axis=1) / np.linalg.norm(expected, axis=1)
    assert (brightness > 0.6).all()
    assert (brightness < 1.05).all()


def test_what_is_never_reached_is_grey_and_no_time_at_all_refused(block, pixels):
    activation = np.where(block.vertices[:, 0] > 20, np.inf, block.vertices[:, 0])
    figure = spread_figure(block, {"blocked": activation})
    assert figure.axes[-1].get_ylabel() == "standard deviation (ms)"
    place = heart_views(block)["anterior"].project(np.array([[32.0, 0.0, 12.0]]))[:, :2]
    assert np.ptp(pixels(figure.axes[1], place)) < 0.02
    with pytest.raises(InputError, match="ever activated"):
        spread_figure(block, {"none": np.full_like(activation, np.inf)})


def test_times_since_the_first_activation_are_those_of_tissue_and_trees(block):
    before = rows(block)[0]
    activation = np.where(block.vertices[:, 0] > 35, np.inf, before.activation)
    row = ActivationRow("paced", activation, before.trees).since_first()
    assert np.nanmin(row.activation) == 0.0
    assert (np.isnan(row.activation) == (block.vertices[:, 0] > 35)).all()
    for (_, shifted), (_, times) in zip(row.trees, before.trees, strict=True):
        np.testing.assert_allclose(shifted, times - before.activation.min())


def test_long_names_of_rows_stay_beside_their_rows(block):
    names = [f"{k}-a-scenario-without-end" * 4 for k in range(2)]
    times = 20 + block.vertices[:, 0]
    figure = spread_figure(block, dict.fromkeys(names, times))
    figure.canvas.draw()
    panels = figure.axes[: 2 * len(VIEWS) : len(VIEWS)]
    upper, lower = (axes.texts[0].get_window_extent() for axes in panels)
    assert upper.y0 > lower.y1
    assert min(upper.x0, lower.x0) >= 0
    assert panels[0].get_window_extent().width > 50  # pixels; names leave room for hearts
