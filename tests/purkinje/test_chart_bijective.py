"""The chart: bijective, on the disk, oriented as seen from the blood, with exact lengths."""

import igl
import numpy as np
import pytest
from builders import half_ellipsoid

from fascicle.heart.endocardium import Endocardium
from fascicle.mesh.topology import boundary_loops
from fascicle.purkinje.chart import (
    _circle_by_arc_length,
    _mean_value_map,
    _metric,
    build_chart,
    stretch,
)


def harmonic_map(vertices, triangles):
    """The map, the boundary loop, and its place on the circle."""
    loop = boundary_loops(triangles)[0]
    circle = _circle_by_arc_length(vertices[loop])
    return np.asarray(igl.harmonic(vertices, triangles, loop, circle, 1)), loop, circle


def signed_areas_of(points, triangles):
    """Own shoelace, so that a sign slip in the package cannot hide itself."""
    x, y = points[triangles].transpose(2, 0, 1)
    shoelace = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)
    return shoelace / 2


def sliver_dome():
    """Dome with needle-shaped triangles, so obtuse that the cotangent map folds."""
    surface = half_ellipsoid(rings=10, sectors=24)
    vertices = surface.vertices.copy()
    rng = np.random.default_rng(2)
    inner = np.setdiff1d(np.arange(len(vertices)), boundary_loops(surface.triangles)[0])
    moved = rng.choice(inner, len(inner) // 2, replace=False)
    for v in moved:  # almost onto a neighbour
        around = np.unique(surface.triangles[(surface.triangles == v).any(axis=1)])
        goal = rng.choice(around[around != v])
        vertices[v] += 0.9 * (vertices[goal] - vertices[v])
    return vertices, surface.triangles


def test_every_triangle_keeps_its_orientation_and_the_disk_is_covered_once(surface):
    """Total area of a polygon inscribed in the circle; a fold would make area count twice."""
    _, chart, _ = surface
    areas = signed_areas_of(chart.points, chart.triangles)
    assert areas.min() > 0
    loop = boundary_loops(chart.triangles)[0]
    angle = np.unwrap(np.arctan2(chart.points[loop, 1], chart.points[loop, 0]))
    steps = np.diff(np.append(angle, angle[0] + 2 * np.pi))
    assert areas.sum() == pytest.approx(np.sin(steps).sum() / 2, rel=1e-12)


def test_boundary_is_on_the_circle_by_arc_length(surface):
    endocardium, chart, _ = surface
    loop = boundary_loops(chart.triangles)[0]
    np.testing.assert_allclose(np.linalg.norm(chart.points[loop], axis=1), 1.0, atol=1e-12)
    mm = np.linalg.norm(np.diff(endocardium.vertices[[*loop, loop[0]]], axis=0), axis=1)
    ring = chart.points[[*loop, loop[0]]]
    turns = ring[:-1, 0] * ring[1:, 1] - ring[:-1, 1] * ring[1:, 0]
    np.testing.assert_allclose(np.arcsin(turns), 2 * np.pi * mm / mm.sum(), rtol=1e-9)


@pytest.mark.parametrize("fixture", ["default_heart", "crtdemo"])
def test_triangles_turn_counter_clockwise_seen_from_the_cavity(fixture, request):
    """Off the surface against the normal lies tissue, along it blood; mirrored charts fail."""
    heart = request.getfixturevalue(fixture)
    tree = igl.AABB()
    tree.init(heart.vertices, heart.tetrahedra)

    def in_tissue(points):
        return np.asarray(igl.in_element(heart.vertices, heart.tetrahedra, points, tree)) >= 0

    for endocardium in heart.endocardia:
        corner = endocardium.vertices[build_chart(endocardium).triangles]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        centre = corner.mean(axis=1)
        assert in_tissue(centre - 1.5 * normal).mean() > 0.9
        assert in_tissue(centre + 1.5 * normal).mean() < 0.1


def test_metric_reproduces_every_edge_length(surface):
    assert_metric_is_exact(surface[1])


def assert_metric_is_exact(chart):
    g11, g12, g22 = chart.metric.T
    for a, b in ((0, 1), (1, 2), (2, 0)):
        i, j = chart.triangles[:, a], chart.triangles[:, b]
        u, v = (chart.points[j] - chart.points[i]).T
        mm = np.sqrt(g11 * u * u + 2 * g12 * u * v + g22 * v * v)
        wanted = np.linalg.norm(chart.vertices[j] - chart.vertices[i], axis=1)
        np.testing.assert_allclose(mm, wanted, rtol=1e-8)


def test_neighbours_lie_across_the_edge_opposite_each_corner(surface):
    """A rotated table would send walks into the wrong triangle without any error."""
    _, chart, _ = surface
    for corner in range(3):
        here = np.flatnonzero(chart.neighbours[:, corner] >= 0)
        there = chart.neighbours[here, corner]
        edge = chart.triangles[here][:, [(corner + 1) % 3, (corner + 2) % 3]]
        for end in edge.T:
            assert (chart.triangles[there] == end[:, None]).any(axis=1).all()
    loop = boundary_loops(chart.triangles)[0]
    assert (chart.neighbours < 0).sum() == len(loop)


def test_mean_value_map_takes_over_where_the_harmonic_map_folds():
    vertices, triangles = sliver_dome()
    harmonic, loop, circle = harmonic_map(vertices, triangles)
    assert signed_areas_of(harmonic, triangles).min() < 0, "the case no longer folds"
    mean_value = _mean_value_map(vertices, triangles, loop, circle)
    assert signed_areas_of(mean_value, triangles).min() > 0
    chart = build_chart(Endocardium("lv", vertices, triangles, 0, 1))
    np.testing.assert_array_equal(chart.points, mean_value)


def test_mean_value_map_reproduces_a_flat_disk():
    """Linear precision (Floater 2003): weights in the wrong triangle corner lose it."""
    chart = build_chart(half_ellipsoid(jitter=0.3))
    flat = np.column_stack([chart.points, np.zeros(len(chart.points))])
    loop = boundary_loops(chart.triangles)[0]
    mapped = _mean_value_map(flat, chart.triangles, loop, chart.points[loop])
    np.testing.assert_allclose(mapped, chart.points, atol=1e-12)


def test_mean_value_map_takes_over_where_the_harmonic_map_nearly_folds():
    """A rough dome on which the harmonic map stretches one triangle 245 times."""
    surface = half_ellipsoid(rings=10, sectors=24)
    vertices, triangles = surface.vertices.copy(), surface.triangles
    inner = np.setdiff1d(np.arange(len(vertices)), boundary_loops(triangles)[0])
    vertices[inner] += np.random.default_rng(84).normal(scale=3.0, size=(len(inner), 3))
    harmonic, _, _ = harmonic_map(vertices, triangles)
    assert signed_areas_of(harmonic, triangles).min() > 0
    assert stretch(_metric(harmonic, vertices, triangles)).max() > 200
    chart = build_chart(Endocardium("lv", vertices, triangles, 0, 1))
    assert signed_areas_of(chart.points, triangles).min() > 0
    assert stretch(chart.metric).max() < 6
    assert_metric_is_exact(chart)


def test_a_chart_that_is_hardly_stretched_is_the_harmonic_map(surface):
    endocardium, chart, _ = surface
    harmonic, _, _ = harmonic_map(endocardium.vertices, endocardium.triangles)
    np.testing.assert_array_equal(chart.points, harmonic)
