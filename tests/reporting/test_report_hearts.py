"""Rendering, on a block of tissue with two wells for cavities, where every area is known."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fascicle.core.errors import InputError
from fascicle.heart.endocardium import Endocardium, oriented_into_cavity
from fascicle.heart.heart import Heart
from fascicle.mesh.measures import signed_volumes, triangle_normals
from fascicle.purkinje.tree import PurkinjeTree
from fascicle.reporting.figures import new_figure
from fascicle.reporting.hearts import (
    SINCE_FIRST,
    SPREAD,
    VIEWS,
    ActivationRow,
    _bands,
    _draw_cavity,
    activation_figure,
)
from fascicle.reporting.rendering import (
    AMBIENT,
    View,
    back_to_front,
    cut_at_levels,
    heart_views,
    smooth_normals,
)

CELL = 5.0  # mm
CELLS = (8, 4, 6)  # x from right to left of the patient, y from front to back, z upwards
WELLS = {"rv": ((1, 3), (1, 3), (3, 6)), "lv": ((5, 7), (1, 3), (2, 6))}
KUHN = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)
WIDTH, DEPTH, HEIGHT = (CELL * n for n in CELLS)


def block_vertices():
    grid = np.indices([n + 1 for n in CELLS]).reshape(3, -1).T
    return grid * CELL


def vertex_number(i, j, k):
    return (i * (CELLS[1] + 1) + j) * (CELLS[2] + 1) + k


def solid_cells():
    solid = np.ones(CELLS, dtype=bool)
    for spans in WELLS.values():
        solid[tuple(slice(*span) for span in spans)] = False
    return np.argwhere(solid)


def endocardium(side, vertices, triangles):
    """Walls and floor of a well: boundary triangles on its box that are not on the top."""
    spans = CELL * np.array(WELLS[side], dtype=float)
    centres = vertices[triangles].mean(axis=1)
    inside = ((centres >= spans[:, 0] - 1e-9) & (centres <= spans[:, 1] + 1e-9)).all(axis=1)
    chosen = triangles[inside & (centres[:, 2] < HEIGHT - 1e-9)]
    used, local = np.unique(chosen, return_inverse=True)
    faces = oriented_into_cavity(vertices[used], local.reshape(-1, 3), side)
    return Endocardium(side, vertices[used], faces, 0, 1)


@pytest.fixture(scope="module")
def heart():
    vertices = block_vertices()
    corners = np.array([(c & 1, c >> 1 & 1, c >> 2 & 1) for c in range(8)])
    cubes = vertex_number(*np.moveaxis(solid_cells()[:, None] + corners, -1, 0))
    tetrahedra = cubes[:, KUHN].reshape(-1, 4)
    flip = signed_volumes(vertices, tetrahedra) < 0
    tetrahedra[flip] = tetrahedra[flip][:, [1, 0, 2, 3]]
    blank = Endocardium("lv", vertices[:3], np.array([[0, 1, 2]]), 0, 1)
    fibres = np.tile([1.0, 0, 0], (len(tetrahedra), 1))
    draft = Heart(vertices, tetrahedra, fibres, blank, blank, np.zeros((9, 3)))
    sides = {side: endocardium(side, vertices, draft.boundary[0]) for side in WELLS}
    return Heart(vertices, tetrahedra, fibres, sides["lv"], sides["rv"], np.zeros((9, 3)))


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


def area(polygons):
    """Sum of the areas of polygons (shoelace formula)."""
    total = 0.0
    for polygon in polygons:
        x, y = np.asarray(polygon).T
        total += abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    return total


def visible_area(heart, name):
    view, triangles = heart_views(heart)[name], heart.boundary[0]
    order = back_to_front(view, heart.vertices, triangles)
    return area(view.project(heart.vertices[triangles[order]])[..., :2])


def test_boundary_faces_outwards(heart):
    triangles = heart.boundary[0]
    flux = np.einsum(
        "ij,ij->", triangle_normals(heart.vertices, triangles), heart.vertices[triangles].mean(1)
    )
    assert flux / 3 == pytest.approx(heart.volumes.sum())


def test_views_are_rotations_with_the_left_cavity_on_the_right_seen_from_the_front(heart):
    views = heart_views(heart)
    for view in views.values():
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.cross(view.axes[0], view.axes[1]), -view.axes[2], atol=1e-12)
    cavities = [e.vertices.mean(axis=0) for e in (heart.rv, heart.lv)]
    for name in ("anterior", "base"):
        right, left = views[name].project(np.array(cavities))
        assert left[0] - right[0] == pytest.approx(4 * CELL, rel=0.05)
    near = {name: [views[name].project(c)[2] for c in cavities] for name in views}
    assert near["RV side"][0] < near["RV side"][1]
    assert near["LV side"][1] < near["LV side"][0]


@pytest.mark.parametrize("name", VIEWS)
def test_views_follow_the_heart_into_any_frame(heart, name):
    # the corners of the well's floor are equally far from the base: rounding must not choose
    floor = heart.lv.vertices.copy()
    floor[np.lexsort(floor.T)[0]] -= [0.1, 0.1, 0.1]
    lv = Endocardium("lv", floor, heart.lv.triangles, 0, 1)
    heart = replace(heart, lv=lv)
    here = heart_views(heart)[name].project(heart.vertices)
    other = turned(heart)
    np.testing.assert_allclose(heart_views(other)[name].project(other.vertices), here, atol=1e-9)


def test_from_the_base_the_floors_of_the_cavities_are_seen_and_nothing_twice(heart):
    axis = heart_views(heart)["base"].axes[2]
    cosine = abs(axis[2])  # the long axis ends in a corner of the floor, so it leans
    assert cosine > 0.9
    assert visible_area(heart, "base") >= WIDTH * DEPTH * cosine - 1e-9
    view, triangles = heart_views(heart)["base"], heart.boundary[0]
    order = back_to_front(view, heart.vertices, triangles)
    floors = heart.vertices[triangles[order]][..., 2]
    for bottom in (2 * CELL, 3 * CELL):
        assert np.count_nonzero((floors == bottom).all(axis=1)) >= 8
    depth = view.project(heart.vertices[triangles[order]])[..., 2].mean(axis=1)
    assert np.all(np.diff(depth) <= 1e-12)  # the farthest first


def test_shade_stays_between_ambient_and_full_and_creases_stay_sharp(heart):
    triangles = heart.boundary[0]
    normals = smooth_normals(heart.vertices, triangles)
    flat = triangle_normals(heart.vertices, triangles)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert np.einsum("ij,ij->i", normals, flat).min() > 0.98  # at rims, plain averages give 0.7
    shade = heart_views(heart)["anterior"].shade(normals)
    assert shade.min() >= AMBIENT
    assert AMBIENT < shade.max() <= 1.0


def test_cuts_keep_the_area_and_follow_the_isochrones():
    rng = np.random.default_rng(2)
    corners, times = rng.uniform(0, 10, (40, 3, 2)), rng.uniform(0, 59, (40, 3))
    levels = np.arange(0.0, 61.0, 10.0)
    pieces = list(zip(*cut_at_levels(corners, times, levels), strict=True))
    assert [k for k, _, _ in pieces] == sorted(k for k, _, _ in pieces)
    assert area([p for _, _, p in pieces]) == pytest.approx(area(corners))
    for k, band, polygon in pieces:
        edges = np.linalg.solve(
            np.vstack([corners[k].T, np.ones(3)]), np.vstack([polygon.T, np.ones(len(polygon))])
        )
        at = times[k] @ edges
        assert at.min() > levels[band] - 1e-6
        assert at.max() < levels[band + 1] + 1e-6


def test_a_triangle_that_is_never_activated_is_left_whole():
    corner = np.array([[[0.0, 0], [1, 0], [0, 1]]])
    triangle, band, polygons = cut_at_levels(
        corner, np.array([[1.0, np.inf, 30]]), np.array([0.0, 50])
    )
    assert (triangle, band) == (0, -1)
    np.testing.assert_array_equal(polygons, corner[:, [0, 1, 2, 2, 2]])


def test_no_piece_is_left_where_a_triangle_only_touches_an_isochrone():
    corner = np.array([[[0.0, 0], [1, 0], [0, 1]]])
    triangle, band, _ = cut_at_levels(corner, np.array([[5.0, 8.0, 10.0]]), np.array([0.0, 10, 20]))
    assert (triangle, band) == (0, 0)


def tree_in(endo):
    nodes = endo.vertices[:4]
    lengths = np.array([0.0, CELL, CELL, CELL])
    return PurkinjeTree(endo.side, nodes, np.array([-1, 0, 1, 1]), lengths)


def rows(heart):
    activation = 20 + heart.vertices[:, 0]  # 20 to 60 ms, from right to left
    trees = tuple((tree_in(e), np.array([0.0, 10, 30, 45])) for e in heart.endocardia)
    return [ActivationRow("before", activation, trees), ActivationRow("after", activation + 37)]


def test_rows_share_one_scale_of_round_isochrones(heart):
    figure = activation_figure(heart, rows(heart), SINCE_FIRST)
    *panels, bar = figure.axes
    assert len(panels) == 2 * (len(VIEWS) + 2)
    assert bar.get_ylabel() == "time since the first activation (ms)"
    norms = {id(c.norm) for axes in panels for c in axes.collections if c.get_array() is not None}
    assert len(norms) == 1
    norm = next(c.norm for a in panels for c in a.collections if c.get_array() is not None)
    np.testing.assert_allclose(np.diff(norm.boundaries), 5.0)
    assert (norm.boundaries[0], norm.boundaries[-1]) == (20.0, 100.0)
    assert norm.extend == "min"  # roots fire before any tissue


def test_hearts_share_one_scale_in_mm_and_trees_another(heart):
    *panels, _ = activation_figure(heart, rows(heart), SINCE_FIRST).axes
    widths = [np.ptp(axes.get_xlim()) for axes in panels]
    assert np.ptp(widths[: len(VIEWS)]) < 1e-9
    assert widths[0] > WIDTH
    assert widths[4] == pytest.approx(widths[5])
    assert widths[4] < widths[0]


def test_surface_has_the_colours_of_its_times(heart):
    figure = activation_figure(heart, rows(heart)[1:], SINCE_FIRST)
    names = [axes.get_title() for axes in figure.axes]
    # from right to left the front passes at 57 to 97 ms: each side shows one end of the map
    for name, place in (("RV side", 0.0), ("LV side", 1.0)):
        (surface,) = figure.axes[names.index(name)].collections
        assert len(surface.get_paths()) >= 2 * CELLS[1] * CELLS[2]
        nearest = surface.get_facecolor()[-10:, :3]  # painted last
        expected = np.array(matplotlib.colormaps["viridis_r"](place)[:3])
        brightness = nearest / expected
        of_the_end = np.ptp(brightness, axis=1) < 0.01  # the hue is the map's, only darkened
        assert of_the_end.sum() >= 8  # an edge of the block may come nearer than its side
        assert AMBIENT <= brightness[of_the_end].min() <= brightness[of_the_end].max() <= 1.001


def test_tree_segments_carry_their_node_times(heart):
    figure = activation_figure(heart, rows(heart), SINCE_FIRST)
    axes = next(a for a in figure.axes if a.get_title() == "LV tree")
    coloured = [c for c in axes.collections if c.get_array() is not None]
    times = np.concatenate([c.get_array() for c in coloured])
    assert sorted(times) == [10.0, 30.0, 45.0]


def test_a_heart_that_is_partly_silent_is_drawn_and_a_wholly_silent_one_refused(heart):
    activation = np.where(heart.vertices[:, 0] > 20, np.inf, heart.vertices[:, 0])
    assert (
        len(activation_figure(heart, [ActivationRow("blocked", activation)], SINCE_FIRST).axes) == 5
    )
    silent = ActivationRow("none", np.full(len(activation), np.inf))
    with pytest.raises(InputError, match="ever activated"):
        activation_figure(heart, [silent], SINCE_FIRST)


def test_times_since_the_first_activation_are_those_of_tissue_and_trees(heart):
    before = rows(heart)[0]
    activation = np.where(heart.vertices[:, 0] > 35, np.inf, before.activation)
    row = ActivationRow("paced", activation, before.trees).since_first()
    assert np.nanmin(row.activation) == 0.0
    assert (np.isnan(row.activation) == (heart.vertices[:, 0] > 35)).all()
    for (_, shifted), (_, times) in zip(row.trees, before.trees, strict=True):
        np.testing.assert_allclose(shifted, times - before.activation.min())


def test_other_times_are_named(heart):
    figure = activation_figure(heart, rows(heart)[:1], SPREAD)
    assert figure.axes[-1].get_ylabel() == "standard deviation (ms)"


def test_no_tree_leaves_its_endocardium_where_the_base_is_seen_from_above(heart):
    """The near wall then ends above the far one on the screen, and with it the trees on it."""
    view = heart_views(heart)["LV side"]
    tilted = View(
        "tilted", view.axes @ Rotation.from_euler("x", 25, degrees=True).as_matrix(), view.centre
    )
    base = heart.lv.vertices[heart.lv.vertices[:, 2] == HEIGHT]
    nodes = 0.99 * base + 0.01 * heart.lv.vertices.mean(axis=0)  # all around, just below the rim
    axes = new_figure(2, 2).subplots()
    row = ActivationRow("", np.linspace(0, 1, 3))
    _draw_cavity(axes, tilted, heart.lv, row, _bands([row]))
    walls = [path for each in axes.collections for path in each.get_paths()]
    places = tilted.project(nodes)[:, :2]
    inside = np.any([wall.contains_points(places, radius=0.01) for wall in walls], axis=0)
    assert inside.all()


def test_the_scale_bar_is_below_the_names_of_rows(heart):
    times = 20 + heart.vertices[:, 0]
    for name in ("best network", "a-scenario-without-end" * 4):
        figure = activation_figure(heart, [ActivationRow(name, times)], SPREAD)
        for _ in range(2):  # as when it is saved
            figure.canvas.draw()
        named, scale = figure.axes[0].texts
        assert scale.get_text() == "20 mm"
        assert 0 < scale.get_window_extent().y1 < named.get_window_extent().y0
        assert scale.get_window_extent().y0 >= 0


def test_long_names_of_rows_stay_beside_their_rows(heart):
    names = [f"{k}-a-scenario-without-end" * 4 for k in range(2)]
    times = 20 + heart.vertices[:, 0]
    figure = activation_figure(heart, [ActivationRow(name, times) for name in names], SPREAD)
    for _ in range(2):  # as when it is saved
        figure.canvas.draw()
    panels = figure.axes[: 2 * len(VIEWS) : len(VIEWS)]
    upper, lower = (axes.texts[0].get_window_extent() for axes in panels)
    assert upper.y0 > lower.y1
    assert min(upper.x0, lower.x0, lower.y0) >= 0
    assert upper.y1 <= figure.bbox.height
    assert panels[0].get_window_extent().width > 50  # pixels; names leave room for hearts
