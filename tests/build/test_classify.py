"""Labels found on surfaces without any: right where they are known, with borders without teeth."""

import igl
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shapes import ellipsoid, read_labelled_surface

from fascicle.build.borders import cut_along_borders, cut_at_zero
from fascicle.build.classify import classify_surface
from fascicle.core.errors import InputError
from fascicle.heart.labelled_surface import NEEDED_LABELS, Label
from fascicle.mesh.measures import closed_volume, loop_length, triangle_areas
from fascicle.mesh.topology import boundary_loops, boundary_triangles, unique_edges

LV, RV, EPI, BASE = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.EPICARDIUM, Label.BASE)


def smooth_max(values, radius):
    """Largest of values; edges between them are rounded where the radius (mm) is not 0."""
    result = values[0]
    for value in values[1:]:
        h = np.maximum(radius - np.abs(result - value), 0) / max(radius, 1e-9)
        result = np.maximum(result, value) + radius * h**2 / 4
    return result


def distances(points, tilt):
    """Signed distances to epicardium, cavities and base; all negative in the tissue."""
    outer = ellipsoid(points, [36, 36, 80])
    right = ellipsoid(points, [42, 36, 68], [-32, 0, 0])
    lv = ellipsoid(points, [25, 25, 68])
    rv = np.maximum(ellipsoid(points, [38, 32, 63], [-32, 0, 0]), -outer)
    base = points @ [np.sin(tilt), 0, np.cos(tilt)]
    return {EPI: np.minimum(outer, right), LV: -lv, RV: -rv, BASE: base}


def grid(spacing):
    axes = [np.arange(low, high, spacing) for low, high in ((-80, 44), (-44, 44), (-86, 36))]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    points = np.stack([x, y, z], axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3)
    return points + 0.31, tuple(len(axis) for axis in axes)


def surface_of(values, points, shape):
    vertices, triangles = igl.marching_cubes(values, points, *shape, 0.0)[:2]
    return vertices, np.asarray(triangles, dtype=np.int64)


def shell(spacing=2.5, tilt=0.0, radius=0.0):
    """Marching cubes' surface of a left ellipsoid and a right crescent, and its true labels."""
    points, shape = grid(spacing)
    parts = distances(points, tilt)
    vertices, triangles = surface_of(smooth_max(list(parts.values()), radius), points, shape)
    there = distances(vertices[triangles].mean(axis=1), tilt)
    nearest = np.argmin([np.abs(d) for d in there.values()], axis=0)
    return vertices, triangles, np.array(list(there))[nearest]


def agreement(found, truth):
    """Share of the area with the same label: of all, and of each label of the truth."""
    area = igl.doublearea(found.vertices, found.triangles)
    same = found.labels == truth
    shares = {label: area[same & (truth == label)].sum() / area[truth == label].sum()
              for label in np.unique(truth)}  # fmt: skip
    return area[same].sum() / area.sum(), shares


def assert_clean(found):
    """Each label is one piece; each endocardium has one rim and the base three."""
    for label, rims in ((LV, 1), (RV, 1), (EPI, 1), (BASE, 3)):
        part = found.having(label)
        assert len(igl.boundary_loop_all(part)) == rims
        assert np.max(igl.bfs_orient(part)[1]) == 0


@pytest.fixture(scope="module")
def flat():
    """Shell with a flat base."""
    return shell(spacing=3.0)


def test_flat_base(flat):
    vertices, triangles, truth = flat
    found = classify_surface(vertices, triangles, "shell")
    whole, shares = agreement(found, truth)
    assert whole > 0.98
    assert min(shares[LV], shares[EPI]) > 0.99
    # marching cubes cut a chamfer of a cell along the edges, which is neither; below, all is right
    deep = (vertices[triangles][..., 2] < -3.0).all(axis=1)
    assert np.array_equal(found.labels[deep], truth[deep])
    assert_clean(found)


def test_rounded_rims_anywhere_in_space_and_noisy():
    vertices, triangles, truth = shell(spacing=2.5, tilt=0.35, radius=6.0)
    rng = np.random.default_rng(3)
    turned = Rotation.random(rng=rng).apply(vertices) + np.array([200, -50, 1000])
    turned += rng.normal(scale=0.1, size=turned.shape)
    found = classify_surface(turned, triangles, "shell")
    whole, shares = agreement(found, truth)
    assert whole > 0.98
    # where a rounded rim begins is a matter of taste
    assert min(shares[LV], shares[RV]) > 0.97
    assert_clean(found)


def test_orientation_does_not_matter_and_a_mirrored_heart_keeps_its_sides(flat):
    vertices, triangles, truth = flat
    turn = np.random.default_rng(0).random((len(triangles), 1)) < 0.5
    mixed = np.where(turn, triangles, triangles[:, ::-1])
    found = classify_surface(vertices * [-1, 1, 1], mixed, "shell")
    _, shares = agreement(found, truth)
    assert min(shares[LV], shares[RV]) > 0.97
    volume = abs(closed_volume(vertices, triangles))
    assert closed_volume(found.vertices, found.triangles) == pytest.approx(volume)


def test_statistical_mean_heart(data_folder):
    known = read_labelled_surface(data_folder / "hearts" / "cobiveco-geo1" / "heart.vtp")
    steps = []
    found = classify_surface(
        known.vertices, known.triangles, "geo1", lambda *step: steps.append(step)
    )
    whole, shares = agreement(found, known.labels)
    assert whole > 0.98
    assert min(shares[LV], shares[RV], shares[EPI]) > 0.985
    assert_clean(found)
    assert steps[-1][0] == steps[-1][1] > 0


def test_a_tetrahedral_heart(crtdemo):
    """The base is where the tissue was cut: flat up to its rounded rim."""
    heart = crtdemo
    triangles, _ = boundary_triangles(heart.tetrahedra)
    found = classify_surface(heart.vertices, triangles, "crtdemo")
    area = igl.doublearea(found.vertices, found.triangles) / 2
    for label, endocardium in ((LV, heart.lv), (RV, heart.rv)):
        distance, _ = cKDTree(endocardium.vertices).query(found.vertices)
        truth = (distance < 1e-3)[found.triangles].all(axis=1)
        wrong = (found.labels == label) != truth
        assert area[wrong].sum() < 0.002 * endocardium.area
    base = found.vertices[found.having(BASE)].reshape(-1, 3)
    base -= base.mean(axis=0)
    assert np.abs(base @ np.linalg.svd(base, full_matrices=False)[2][2]).max() < 1e-6
    assert_clean(found)
    assert set(found.labels) == set(NEEDED_LABELS)


def test_open_surface_is_refused_and_where():
    vertices, triangles, _ = shell(spacing=4.0)
    tip = np.argmin(vertices[triangles].mean(axis=1)[:, 2])
    with pytest.raises(InputError, match=r"3 of \d+ edges are open.*, -79\.\d\) mm"):
        classify_surface(vertices, np.delete(triangles, tip, axis=0), "shell")


def test_cavities_closed_at_the_base_are_refused():
    def shut(points):
        lv = -ellipsoid(points, [20, 20, 30], [5, 0, -20])
        rv = -ellipsoid(points, [15, 20, 30], [-45, 0, -20])
        return np.max([ellipsoid(points, [58, 40, 45], [-18, 0, -20]), lv, rv], axis=0)

    points, shape = grid(3.5)
    vertices, triangles = surface_of(shut(points), points, shape)
    words = r"falls into 3 pieces .*; keep one \(cavities must be open at the base\)"
    with pytest.raises(InputError, match=words):
        classify_surface(vertices, triangles, "shell")


def toothiness(vertices, loop, count=600, width=2.0):
    """Length of a loop over that of its smooth version, by a Gaussian of this deviation (mm)."""
    closed = vertices[np.append(loop, loop[0])]
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    at = np.arange(count) * along[-1] / count
    even = np.stack([np.interp(at, along, closed[:, k]) for k in range(3)], axis=1)
    smooth = gaussian_filter1d(even, width * count / along[-1], axis=0, mode="wrap")
    return along[-1] / loop_length(smooth, np.arange(count))


def test_loops_have_no_teeth_and_the_surface_stays_where_it_is():
    vertices, triangles, _ = shell(spacing=2.5, tilt=0.35)
    found = classify_surface(vertices, triangles, "shell")
    cut = cut_along_borders(found)
    assert_clean(cut)
    for label in (LV, RV, EPI):
        before, after = (
            toothiness(s.vertices, boundary_loops(s.having(label))[0]) for s in (found, cut)
        )
        assert before > 1.14  # along the edges of triangles
        assert after < 1.15  # the true edges of a crescent have corners
        assert after - 1 < 0.7 * (before - 1)
    assert (unique_edges(cut.triangles)[1] == 2).all()
    for measure in (closed_volume, lambda *surface: triangle_areas(*surface).sum()):
        before, after = (measure(s.vertices, s.triangles) for s in (found, cut))
        assert after == pytest.approx(before, rel=1e-9)


def test_cut_at_zero_of_a_linear_function_is_straight():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(36)])
    corner = np.array([6 * i + j for i in range(5) for j in range(5)])
    triangles = np.concatenate([corner[:, None] + [0, 6, 7], corner[:, None] + [0, 7, 1]])
    values = points[:, 0] + 0.3 * points[:, 1] - 2.35
    vertices, cut, _, side = cut_at_zero(points, triangles, values)
    there = vertices[cut].mean(axis=1)
    area = triangle_areas(vertices, cut)
    assert area.sum() == pytest.approx(25)
    assert (triangle_areas(points, triangles)[0] / area).max() < 100
    level = there[:, 0] + 0.3 * there[:, 1] - 2.35
    assert (np.sign(level) == side)[np.abs(level) > 0.2].all()
    # ∫ of x below the line: 2.35 - 0.3 y over 0..5
    assert area[side < 0].sum() == pytest.approx(2.35 * 5 - 0.3 * 12.5, abs=0.2)
