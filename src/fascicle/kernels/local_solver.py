"""Local solver of the anisotropic eikonal equation: earliest arrival from a face, edge or vertex.

For a point and the others at relative positions eᵢ, with A_ij = eᵢᵀD⁻¹eⱼ (ms²), the arrival time is
the minimum of Σλᵢτᵢ + √(λᵀAλ) over the simplex, τᵢ (ms) being their times. In its interior it is

    μ = (b + √(b² − a(c − 1))) / a,   a = 1ᵀQ1,  b = 1ᵀQτ,  c = τᵀQτ,  Q = A⁻¹,

accepted when Q(μ1 − τ) ≥ 0; otherwise the minimum lies on an edge, by the same formula in two
unknowns, or at a vertex.
"""

import math

import numpy as np

from fascicle.kernels.jit import kernel

# A determinant below this fraction of the product of the diagonal: the point lies in the face, the
# inside of which is then not used. Meshes with flat elements are refused when they are read.
FLAT_ELEMENT = 1e-14


@kernel(inline="always")
def from_edge(a11, a12, a22, t1, t2):
    """Earliest arrival (ms) through the inside of an edge; inf where the minimum is at an end."""
    det = a11 * a22 - a12 * a12
    if det <= FLAT_ELEMENT * a11 * a22:
        return np.inf
    q11, q12, q22 = a22, -a12, a11  # det·Q, so that a, b, c carry a factor det
    s1, s2 = q11 + q12, q12 + q22
    a = s1 + s2
    base = min(t1, t2)
    d1, d2 = t1 - base, t2 - base
    b = s1 * d1 + s2 * d2
    c = q11 * d1 * d1 + 2.0 * q12 * d1 * d2 + q22 * d2 * d2
    disc = b * b - a * (c - det)
    if disc < 0.0:
        return np.inf
    mu = (b + math.sqrt(disc)) / a
    r1, r2 = mu - d1, mu - d2
    if q11 * r1 + q12 * r2 < 0.0 or q12 * r1 + q22 * r2 < 0.0:
        return np.inf
    return base + mu


@kernel(inline="always")
def from_inside_face(gram, times):
    """Earliest arrival (ms) through the inside of a face; inf where the minimum is on an edge.

    `gram` holds A_ij in the order 11, 12, 13, 22, 23, 33, `times` the three τᵢ.
    """
    a11, a12, a13, a22, a23, a33 = gram
    t1, t2, t3 = times
    q11 = a22 * a33 - a23 * a23
    q12 = a13 * a23 - a12 * a33
    q13 = a12 * a23 - a13 * a22
    det = a11 * q11 + a12 * q12 + a13 * q13
    if det <= FLAT_ELEMENT * a11 * a22 * a33:
        return np.inf
    q22 = a11 * a33 - a13 * a13
    q23 = a12 * a13 - a11 * a23
    q33 = a11 * a22 - a12 * a12
    base = min(t1, t2, t3)
    d1, d2, d3 = t1 - base, t2 - base, t3 - base
    s1, s2, s3 = q11 + q12 + q13, q12 + q22 + q23, q13 + q23 + q33
    v1 = q11 * d1 + q12 * d2 + q13 * d3
    v2 = q12 * d1 + q22 * d2 + q23 * d3
    v3 = q13 * d1 + q23 * d2 + q33 * d3
    a = s1 + s2 + s3
    b = s1 * d1 + s2 * d2 + s3 * d3
    c = v1 * d1 + v2 * d2 + v3 * d3
    disc = b * b - a * (c - det)
    if disc < 0.0:
        return np.inf
    mu = (b + math.sqrt(disc)) / a
    if mu * s1 < v1 or mu * s2 < v2 or mu * s3 < v3:
        return np.inf
    return base + mu


@kernel()
def from_face(gram, times):
    """As `from_inside_face`, from the face's edges and corners, too; times may be inf."""
    a11, a12, a13, a22, a23, a33 = gram
    t1, t2, t3 = times
    best = min(t1 + math.sqrt(a11), t2 + math.sqrt(a22), t3 + math.sqrt(a33))
    if t1 < np.inf and t2 < np.inf:
        best = min(best, from_edge(a11, a12, a22, t1, t2))
        if t3 < np.inf:
            best = min(best, from_inside_face(gram, times))
    if t1 < np.inf and t3 < np.inf:
        best = min(best, from_edge(a11, a13, a33, t1, t3))
    if t2 < np.inf and t3 < np.inf:
        best = min(best, from_edge(a22, a23, a33, t2, t3))
    return best


@kernel(inline="always", error_model="numpy")
def _along_edge(ss, jj, sj, tj):
    """Delay after s with which the inside of the edge from s to j fires a; inf where its ends do.

    As `from_edge` for times 0 and tj, with b² − a(c − det) = det·(sj − tj²).
    """
    aj = 0.5 * (ss + jj - sj)
    det = ss * jj - aj * aj
    mu = ((ss - aj) * tj + math.sqrt(det * (sj - tj * tj))) / sj
    inside = ((jj - aj) * mu + aj * tj >= 0.0) & ((ss - aj) * mu - ss * tj >= 0.0)
    return mu if inside & (det > FLAT_ELEMENT * ss * jj) else np.inf


@kernel(inline="always", error_model="numpy")
def from_new_corner(products, squares, tj, tk, use_j, use_k):
    """Delay after corner s (ms) with which its face s, j, k fires corner a through s; or inf.

    The edge opposite s and the path from s itself are left out. The objective is convex: where its
    minimum in the face's plane lies outside the face, the minimum on the face lies on an edge that
    faces it, one opposite a corner whose weight is negative. Without branches: several faces are
    solved at a time.

    Parameters
    ----------
    products : tuple of 6 floats
        pᵢⱼ = ∇λᵢ·D∇λⱼ of the barycentric coordinates in the element a, s, j, k (1/ms²), for the
        pairs as, aj, ak, sj, sk, jk. The time in the element has the slope √(−Σ pᵢⱼ(τᵢ − τⱼ)²),
        which is 1 in a front; the front comes through the face if it leaves each of its corners
        behind: Σⱼ pᵢⱼ τⱼ ≤ 0.
    squares : tuple of 5 floats
        Squared travel times (ms²) from a to s, j and k, and from s to j and k.
    tj, tk, use_j, use_k : float, float, bool, bool
        Times of j and k, less that of s (ms), and which of the two are to be used.
    """
    pas, paj, pak, psj, psk, pjk = products
    ss, jj, kk, sj, sk = squares
    paa, pjj, pkk = -(pas + paj + pak), -(paj + psj + pjk), -(pak + psk + pjk)
    b = paj * tj + pak * tk
    vj, vk = pjj * tj + pjk * tk, pjk * tj + pkk * tk
    mu = (math.sqrt(b * b - paa * (vj * tj + vk * tk - 1.0)) - b) / paa  # NaN if there is no root
    behind_j = (paj * mu + vj <= 0.0) & use_j & use_k
    behind_k = (pak * mu + vk <= 0.0) & use_j & use_k
    inside = behind_j & behind_k & (pas * mu + psj * tj + psk * tk <= 0.0)
    delay = mu if inside else np.inf
    by_j, by_k = _along_edge(ss, jj, sj, tj), _along_edge(ss, kk, sk, tk)
    delay = min(delay, by_j if use_j & (not behind_k) else np.inf)
    return min(delay, by_k if use_k & (not behind_j) else np.inf)
