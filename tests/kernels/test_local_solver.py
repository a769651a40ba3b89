"""The closed-form local solver against a brute-force minimum over the simplex."""

from __future__ import annotations

import numpy as np
from builders import GOLDEN, brute_force
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from fascicle.kernels.local_solver import from_edge, from_face

HALVINGS = 60  # golden sections; the interval shrinks to 3e-13
FLATTEST = 1e-6  # volume over the product of the edges at the vertex; 0.17 in a right-angled corner
coordinate = st.floats(-10.0, 10.0)
corners = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=3, max_size=3)
times = st.lists(st.floats(0.0, 40.0), min_size=3, max_size=3)


def gram_of(points, ratio):
    """eᵢᵀD⁻¹eⱼ (ms²) for corners around the vertex at the origin; D = diag(1, 1, ratio²)/4."""
    e = np.array(points) * np.array([1.0, 1.0, 1.0 / ratio])
    return 4.0 * e @ e.T


def face(gram, t):
    a = gram
    return from_face(a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2], *t)


@given(corners, times, st.floats(0.2, 5.0))
@example([(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)], [0.0, 0.0, 0.0], 1.0)
@example([(1.0, 0, 0), (1.0, 1e-5, 0), (0, 0, 1.0)], [0.0, 0.1, 0.0], 2.5)  # sliver
@example([(5.0, 0, 0.1), (-5.0, 0.2, 0.1), (0, 4.0, 0.1)], [0.0, 0.0, 0.0], 1.0)  # obtuse, flat
@example([(9.0, 0, 0), (9.0, 1.0, 0), (9.0, 0, 1.0)], [3.0, 40.0, 3.0], 0.2)
@settings(max_examples=300, deadline=None)
def test_from_face_is_the_minimum_over_the_simplex(points, t, ratio):
    gram, t = gram_of(points, ratio), np.array(t)
    lengths = np.sqrt(np.diag(gram))
    assume(lengths.min() > 0.03)
    assume(np.sqrt(max(np.linalg.det(gram), 0.0)) / 6 > FLATTEST * lengths.prod())
    value, reference = face(gram, t), brute_force(gram, t, HALVINGS)
    scale = lengths.max() + t.max()
    assert value >= t.min(), "arrives before its sources"
    assert value <= (t + lengths).min(), "later than a way from a vertex"
    assert value <= reference + 1e-9 * scale, "a better way was missed"
    # rounding in a nearly flat face makes λ inexact; the value must still be attainable
    assert value >= reference - 1e-6 * scale, "earlier than any way through the face"


@given(st.tuples(coordinate, coordinate), st.tuples(coordinate, coordinate), times)
@settings(max_examples=300, deadline=None)
def test_from_edge_is_the_minimum_inside_an_edge_or_inf(p, q, t):
    a11, a12, a22 = np.dot(p, p), np.dot(p, q), np.dot(q, q)
    assume(min(a11, a22) > 1e-3)
    assume(abs(p[0] * q[1] - p[1] * q[0]) > FLATTEST * np.sqrt(a11 * a22))
    share = np.linspace(0, 1, 100_001)
    ways = share * t[0] + (1 - share) * t[1]
    square = a11 * share**2 + 2 * a12 * share * (1 - share) + a22 * (1 - share) ** 2
    reference = (ways + np.sqrt(np.maximum(square, 0))).min()
    value = from_edge(a11, a12, a22, t[0], t[1])
    ends = min(t[0] + np.sqrt(a11), t[1] + np.sqrt(a22))
    assert min(value, ends) <= reference + 1e-9
    assert value >= reference - 1e-3, "earlier than every point of the edge (mesh of 1e-5)"


def test_golden_section_reference_finds_a_known_minimum():
    """From a face at distance h with no spread in τ the way is the perpendicular: h / speed."""
    gram = gram_of([(3.0, 0, 0), (3.0, 4.0, 0), (3.0, 0, 4.0)], 1.0)
    gram_shifted = gram_of([(3.0, -1, -1), (3.0, 4.0, -1), (3.0, -1, 4.0)], 1.0)
    for g in (gram, gram_shifted):
        assert abs(brute_force(g, np.zeros(3), HALVINGS) - 6.0) < 1e-12  # 3 mm at 0.5 mm/ms
    assert 0.6 < GOLDEN < 0.62


@given(corners, st.tuples(coordinate, coordinate, coordinate), st.floats(0.2, 5.0))
@settings(max_examples=300, deadline=None)
def test_planar_front_is_exact_where_its_ray_enters_through_the_face(points, normal, ratio):
    """τ = p·x with pᵀDp = 1 must arrive at the origin at 0 if its ray passes the face."""
    p, d = np.array(normal), np.diag([1.0, 1.0, ratio**2]) / 4.0
    assume(p @ d @ p > 1e-3)
    p /= np.sqrt(p @ d @ p)
    e = np.array(points)
    assume(abs(np.linalg.det(e)) > 1.0)  # mm³
    weights = np.linalg.solve(e.T, -d @ p)  # the ray runs backwards along −Dp
    value = face(gram_of(points, ratio), e @ p)
    if (weights >= 0).all():
        assert abs(value) < 1e-9
    else:
        assert value > -1e-9, "a front from outside the face must not arrive early"
