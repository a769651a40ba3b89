"""Deposit of each element's wave front into a time histogram per channel.

With τ linear in a tetrahedron, the share of its volume that the front has passed by time t is
the integral of the quadratic B-spline whose knots are the four nodal times (Hermite–Genocchi).
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always")
def _inverse(x):
    return 1.0 / x if x > 0.0 else 0.0


@njit(cache=True, nogil=True, inline="always")
def _passed(t, t0, t1, t2, t3, i10, i20, i30, i21, i31, i32):
    """`passed`, with the inverse knot distances given (i31 is 1/(t3 − t1)); t0 < t < t3."""
    if t < t1:
        x = t - t0
        return (x * i10) * (x * i20) * (x * i30)
    if t >= t2:
        x = t3 - t
        return 1.0 - (x * i32) * (x * i31) * (x * i30)
    # middle piece: its start, and the integral of the density from there, exact by Simpson's rule
    share = ((t1 - t0) * i20) * ((t1 - t0) * i30)
    s = 0.5 * (t1 + t)
    first = (t1 - t0) * i20
    middle = ((s - t0) * i20) * ((t2 - s) * i21) + ((t3 - s) * i31) * ((s - t1) * i21)
    last = ((t - t0) * i20) * ((t2 - t) * i21) + ((t3 - t) * i31) * ((t - t1) * i21)
    return share + (first + 4.0 * middle + last) * 0.5 * (t - t1) * i30


@njit(cache=True, nogil=True)
def passed(t, t0, t1, t2, t3):
    """Share of a tetrahedron's volume with τ < t, for sorted nodal times t0 ≤ t1 ≤ t2 ≤ t3.

    Each of the three polynomial pieces is written in ratios between 0 and 1 that stay finite when
    knots coincide.
    """
    if t <= t0:
        return 0.0
    if t >= t3:
        return 1.0
    return _passed(
        t, t0, t1, t2, t3,
        _inverse(t1 - t0), _inverse(t2 - t0), _inverse(t3 - t0),
        _inverse(t2 - t1), _inverse(t3 - t1), _inverse(t3 - t2),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def deposit(time, corners, weights, bin_width, bins):
    """Histogram of |e|·(Gᵢ∇τ·∇Z) over activation time.

    Parameters
    ----------
    time : (n,) array
        Activation at each vertex (ms).
    corners : (m, 4) array
        Vertices of each tetrahedron.
    weights : (m, channels, 4) array
        What each nodal time contributes to |e|·(Gᵢ∇τ·∇Z) in each channel.
    bin_width : float
        Width of a bin (ms); the first starts at time 0.
    bins : int
        Number of bins.

    Returns
    -------
    (bins, channels) array
    """
    channels = weights.shape[1]
    histogram = np.zeros((bins, channels))
    strength = np.empty(channels)
    for e in range(len(corners)):
        a, b = time[corners[e, 0]], time[corners[e, 1]]
        c, d = time[corners[e, 2]], time[corners[e, 3]]
        for k in range(channels):
            w = weights[e, k]
            strength[k] = w[0] * a + w[1] * b + w[2] * c + w[3] * d
        # sort the four times
        if b < a:
            a, b = b, a
        if d < c:
            c, d = d, c
        if c < a:
            a, c = c, a
        if d < b:
            b, d = d, b
        if c < b:
            b, c = c, b
        first, last = int(a / bin_width), int(d / bin_width)
        before = 0.0
        i10, i20, i30 = _inverse(b - a), _inverse(c - a), _inverse(d - a)
        i21, i31, i32 = _inverse(c - b), _inverse(d - b), _inverse(d - c)
        for i in range(first, last + 1):
            after = 1.0
            if i < last:
                after = _passed((i + 1) * bin_width, a, b, c, d, i10, i20, i30, i21, i31, i32)
            share = after - before
            before = after
            for k in range(channels):
                histogram[i, k] += share * strength[k]
    return histogram
