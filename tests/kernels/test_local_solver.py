"""The closed-form local solver against a brute-force minimum over the simplex."""

import numpy as np
from builders import _best_on_row, brute_force
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numba import njit

from fascicle.kernels.coupled import from_edge, from_face, from_new_corner

HALVINGS = 60  # golden sections; the interval shrinks to 3e-13
FLATTEST = 1e-6  # volume over the product of the edges at the vertex; 0.17 in a right-angled corner
BATCH = 100  # random cases an example
EXAMPLES = 100  # so 10,000 cases a test
coordinate = st.floats(-10.0, 10.0)
corners = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=3, max_size=3)
times = st.lists(st.floats(0.0, 40.0), min_size=3, max_size=3)
seeds = st.integers(0, 2**32 - 1)
flatness = st.sampled_from([1.0, 0.1, 1e-2, 1e-4])  # thickness of the tetrahedron over its width
spread = st.sampled_from([0.0, 1.0, 10.0, 40.0])  # ms between the corners' times


def edges_of(points, ratio):
    """Edges (ms) from the origin to points, where D = diag(1, 1, ratio²)/4 is made the identity."""
    return 2.0 * np.array(points) * np.array([1.0, 1.0, 1.0 / ratio])


def gram_of(points, ratio):
    """eᵢᵀD⁻¹eⱼ (ms²) for corners around the vertex at the origin."""
    e = edges_of(points, ratio)
    return e @ e.T


def face(gram, t):
    a = gram
    return from_face((a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2]), (t[0], t[1], t[2]))


def new_corner(edges, t, use_j=True, use_k=True):
    """Arrival by `from_new_corner` from s, j and k at `edges` (3, 3) in ms from a, isotropic."""
    inverse = np.linalg.inv(edges)
    gradients = np.column_stack([-inverse.sum(axis=1), inverse])  # of a, s, j and k
    p = gradients.T @ gradients
    ss, jj, kk = (edges**2).sum(axis=1)
    sj, sk = ((edges[1:] - edges[0]) ** 2).sum(axis=1)
    products = p[0, 1], p[0, 2], p[0, 3], p[1, 2], p[1, 3], p[2, 3]
    squares = ss, jj, kk, sj, sk
    return t[0] + from_new_corner(products, squares, t[1] - t[0], t[2] - t[0], use_j, use_k)


def random_cases(seed, thickness, latest, count=BATCH):
    """Edges at a vertex, their Gram matrices and times of tetrahedra; no degenerate ones.

    Of corners in a cube around the vertex most are obtuse there; a random symmetric positive
    definite D stretches them; `thickness` presses them into a random plane through the vertex.
    Edges are in ms, where D is the identity.
    """
    rng = np.random.default_rng(seed)
    edges = rng.uniform(-10, 10, (count, 3, 3))
    edges[:, :, 2] *= thickness
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    speeds = rng.uniform(0.1, 1.0, (count, 3))
    scaled = np.einsum("nij,njk->nik", edges, turn) / speeds[:, None, :]
    gram = scaled @ np.swapaxes(scaled, 1, 2)
    t = rng.uniform(0, latest, (count, 3))
    lengths = np.sqrt(np.einsum("nii->ni", gram))
    volume = np.abs(np.linalg.det(scaled)) / 6
    good = (volume > FLATTEST * lengths.prod(axis=1)) & (lengths.min(axis=1) > 0.05)
    return scaled[good], gram[good], t[good]


@njit
def references(grams, ts):
    """Minimum over each whole face, and over its edge opposite the first corner."""
    whole, rest = np.empty(len(grams)), np.empty(len(grams))
    for k in range(len(grams)):
        whole[k] = brute_force(grams[k], ts[k], HALVINGS)
        rest[k] = _best_on_row(grams[k], ts[k], 0.0, HALVINGS)
    return whole, rest


@given(seeds, flatness, spread)
@settings(max_examples=EXAMPLES, deadline=None)
def test_ten_thousand_faces(seed, thickness, latest):
    """`from_face` is the minimum over the simplex, obtuse and nearly flat faces included."""
    _, grams, ts = random_cases(seed, thickness, latest)
    assume(len(grams))
    value = np.array([face(g, t) for g, t in zip(grams, ts, strict=True)])
    lengths = np.sqrt(np.einsum("nii->ni", grams))
    scale = lengths.max(axis=1) + ts.max(axis=1)
    whole, _ = references(grams, ts)
    assert (value >= ts.min(axis=1)).all(), "arrives before its sources"
    assert (value <= (ts + lengths).min(axis=1)).all(), "later than from a vertex"
    assert (value <= whole + 1e-9 * scale).all(), "an earlier arrival was missed"
    # rounding in a nearly flat face makes λ inexact; the value must still be attainable
    assert (value >= whole - 1e-6 * scale).all(), "earlier than through any point of the face"
    if thickness == 1.0:
        regular = np.linalg.det(grams) > 1e-4 * lengths.prod(axis=1) ** 2
        assert (value >= whole - 1e-9 * scale)[regular].all()


@given(seeds, flatness, spread)
@settings(max_examples=EXAMPLES, deadline=None)
def test_ten_thousand_new_corners(seed, thickness, latest):
    """With the corner's own edge and the opposite one `from_new_corner` is the face's minimum.

    Alone it is never early; so where it says inf, the minimum is on one of those two edges.
    """
    edges, grams, ts = random_cases(seed, thickness, latest)
    assume(len(grams))
    value = np.array([new_corner(e, t) for e, t in zip(edges, ts, strict=True)])
    lengths = np.sqrt(np.einsum("nii->ni", grams))
    scale = lengths.max(axis=1) + ts.max(axis=1)
    whole, rest = references(grams, ts)
    known = np.minimum(ts[:, 0] + lengths[:, 0], rest)
    assert (np.minimum(value, known) <= whole + 1e-9 * scale).all(), "an earlier arrival was missed"
    assert (value >= whole - 1e-6 * scale).all(), "earlier than through any point of the face"
    if thickness == 1.0:
        regular = np.linalg.det(grams) > 1e-4 * lengths.prod(axis=1) ** 2
        assert (value >= whole - 1e-9 * scale)[regular].all()


def test_new_corner_is_both_used_and_left_out():
    """The property above would hold of a function that always gives the whole face's minimum.

    Paths through the inside of the face and along each of the edges at s must all come first in
    some cases, and in others nothing that touches s does.
    """
    edges, grams, ts = random_cases(0, 1.0, 10.0, 1000)
    value = np.array([new_corner(e, t) for e, t in zip(edges, ts, strict=True)])
    on_edge = np.array(
        [
            [t[0] + from_edge(g[0, 0], g[0, i], g[i, i], 0.0, t[i] - t[0]) for i in (1, 2)]
            for g, t in zip(grams, ts, strict=True)
        ]
    )
    known = np.minimum(ts[:, 0] + np.sqrt(grams[:, 0, 0]), references(grams, ts)[1])
    first = value < known - 1e-6
    by_edge = np.isclose(value[:, None], on_edge, rtol=0.0, atol=1e-9)
    assert 0.1 < np.mean(value == np.inf) < 0.5
    assert np.mean(first & ~by_edge.any(axis=1)) > 0.2, "through the inside"
    assert (np.mean(first[:, None] & by_edge, axis=0) > 0.1).all(), "along s-j and along s-k"


@given(seeds, flatness, spread)
@settings(max_examples=50, deadline=None)
def test_new_corner_beside_corners_that_still_wait(seed, thickness, latest):
    """Where j or k has no time to be used, only the edge to the other one counts.

    Not even a time that would be the earliest of all may be taken from the one that waits.
    """
    edges, grams, ts = random_cases(seed, thickness, latest, 50)
    for e, g, t in zip(edges, grams, ts, strict=True):
        scale = np.sqrt(np.diag(g)).max() + t.max()
        for ready, waits in ((1, 2), (2, 1)):
            exact = from_edge(g[0, 0], g[0, ready], g[ready, ready], t[0], t[ready])
            for stale in (t[waits], -100.0):
                lent = np.where(np.arange(3) == waits, stale, t)
                value = new_corner(e, lent, ready == 1, ready == 2)
                assert value == exact or abs(value - exact) < 1e-9 * scale
        assert new_corner(e, t, False, False) == np.inf


@given(corners, times, st.floats(0.2, 5.0))
@example([(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)], [0.0, 0.0, 0.0], 1.0)
@example([(1.0, 0, 0), (1.0, 1e-5, 0), (0, 0, 1.0)], [0.0, 0.1, 0.0], 2.5)  # sliver
@example([(5.0, 0, 0.1), (-5.0, 0.2, 0.1), (0, 4.0, 0.1)], [0.0, 0.0, 0.0], 1.0)  # obtuse, flat
@example([(9.0, 0, 0), (9.0, 1.0, 0), (9.0, 0, 1.0)], [3.0, 40.0, 3.0], 0.2)
@settings(max_examples=300, deadline=None)
def test_from_face_is_the_minimum_over_the_simplex(points, t, ratio):
    """As above, for the round and equal numbers that Hypothesis likes."""
    edges, gram, t = edges_of(points, ratio), gram_of(points, ratio), np.array(t)
    lengths = np.sqrt(np.diag(gram))
    assume(lengths.min() > 0.03)
    assume(np.sqrt(max(np.linalg.det(gram), 0.0)) / 6 > FLATTEST * lengths.prod())
    value, reference = face(gram, t), brute_force(gram, t, HALVINGS)
    scale = lengths.max() + t.max()
    assert value >= t.min(), "arrives before its sources"
    assert value <= (t + lengths).min(), "later than from a vertex"
    assert value <= reference + 1e-9 * scale, "an earlier arrival was missed"
    assert value >= reference - 1e-6 * scale, "earlier than through any point of the face"
    for turn in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        g, u = gram[np.ix_(turn, turn)], t[turn]
        touching = new_corner(edges[turn], u)
        known = min(u[0] + lengths[turn[0]], _best_on_row(g, u, 0.0, HALVINGS))
        assert min(touching, known) <= reference + 1e-9 * scale
        assert touching >= reference - 1e-6 * scale


@given(st.tuples(coordinate, coordinate), st.tuples(coordinate, coordinate), times)
@settings(max_examples=300, deadline=None)
def test_from_edge_is_the_minimum_inside_an_edge_or_inf(p, q, t):
    a11, a12, a22 = np.dot(p, p), np.dot(p, q), np.dot(q, q)
    assume(min(a11, a22) > 1e-3)
    assume(abs(p[0] * q[1] - p[1] * q[0]) > FLATTEST * np.sqrt(a11 * a22))
    share = np.linspace(0, 1, 100_001)
    starts = share * t[0] + (1 - share) * t[1]
    square = a11 * share**2 + 2 * a12 * share * (1 - share) + a22 * (1 - share) ** 2
    reference = (starts + np.sqrt(np.maximum(square, 0))).min()
    value = from_edge(a11, a12, a22, t[0], t[1])
    ends = min(t[0] + np.sqrt(a11), t[1] + np.sqrt(a22))
    assert min(value, ends) <= reference + 1e-9
    assert value >= reference - 1e-3, "earlier than every point of the edge (mesh of 1e-5)"


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
