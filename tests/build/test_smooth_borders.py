"""Borders between labels that are found from the shape: one loop each, without teeth."""

import numpy as np
import pytest

from fascicle.build.borders import cut_along_borders, cut_at_zero
from fascicle.build.classify import classify_surface
from fascicle.heart.labelled_surface import Label
from fascicle.mesh.measures import closed_volume, loop_length, triangle_areas
from fascicle.mesh.topology import boundary_loops, unique_edges
from tests.build.test_classify import assert_clean, shell

SAMPLES = 600
PARTS = (Label.LV_ENDOCARDIUM, Label.RV_ENDOCARDIUM, Label.EPICARDIUM)
MOST = 1.15  # the true edges of a crescent have corners
WIDTH = 2.0  # mm, standard deviation of the Gaussian that a loop is compared with


def toothiness(vertices, loop):
    """Length of a loop over that of its smooth version."""
    points = vertices[loop]
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    along = np.concatenate([[0], np.cumsum(steps)])
    at = np.arange(SAMPLES) * along[-1] / SAMPLES
    closed = np.concatenate([points, points[:1]])
    even = np.stack([np.interp(at, along, closed[:, k]) for k in range(3)], axis=1)
    frequency = np.fft.fftfreq(SAMPLES, along[-1] / SAMPLES)
    damped = np.fft.fft(even, axis=0) * np.exp(-2 * (np.pi * frequency * WIDTH) ** 2)[:, None]
    return loop_length(vertices, loop) / loop_length(
        np.fft.ifft(damped, axis=0).real, np.arange(SAMPLES)
    )


@pytest.fixture(scope="module", params=[0.0, 6.0])
def found(request):
    vertices, triangles, _ = shell(spacing=2.5, tilt=0.35, radius=request.param)
    return classify_surface(vertices, triangles, "shell")


def test_loops_have_no_teeth(found):
    cut = cut_along_borders(found)
    assert_clean(cut)
    for label in PARTS:
        before, after = (
            toothiness(s.vertices, boundary_loops(s.having(label))[0]) for s in (found, cut)
        )
        assert before > 1.14  # along the edges of triangles
        assert after < MOST
        assert after - 1 < 0.7 * (before - 1)


def test_the_surface_stays_where_it_is(found):
    cut = cut_along_borders(found)
    assert (unique_edges(cut.triangles)[1] == 2).all()
    assert closed_volume(cut.vertices, cut.triangles) == pytest.approx(
        closed_volume(found.vertices, found.triangles), rel=1e-9
    )
    areas = [triangle_areas(s.vertices, s.triangles).sum() for s in (found, cut)]
    assert areas[1] == pytest.approx(areas[0], rel=1e-9)


def test_cut_at_zero_of_a_linear_function_is_straight():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(36)])
    corner = np.array([6 * i + j for i in range(5) for j in range(5)])
    triangles = np.concatenate([corner[:, None] + [0, 6, 7], corner[:, None] + [0, 7, 1]])
    values = points[:, 0] + 0.3 * points[:, 1] - 2.35
    cut = cut_at_zero(points, triangles, values)
    there = cut.vertices[cut.triangles].mean(axis=1)
    area = triangle_areas(cut.vertices, cut.triangles)
    assert area.sum() == pytest.approx(25)
    assert (triangle_areas(points, triangles)[0] / area).max() < 100
    level = there[:, 0] + 0.3 * there[:, 1] - 2.35
    assert (np.sign(level) == cut.side)[np.abs(level) > 0.2].all()
    # ∫ of x below the line: 2.35 - 0.3 y over 0..5
    assert area[cut.side < 0].sum() == pytest.approx(2.35 * 5 - 0.3 * 12.5, abs=0.2)
