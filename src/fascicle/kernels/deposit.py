"""Deposit of each element's wave front into a time histogram per channel.

With τ linear in a tetrahedron, the volume that the front passes per unit of time is the quadratic
B-spline b whose knots are the four nodal times (Hermite–Genocchi). Its third derivative is four
jumps, b‴ = −6 Σₖ δ(t − tₖ)/Πⱼ(tₖ − tⱼ), whatever the front's duration. So the jumps of all elements
are summed at the vertices, the sum at each vertex is spread over a few bins, and three cumulative
sums over the bins give the histogram.
"""

import numpy as np

from fascicle.kernels.jit import CHANNELS, add_to_rows, allocating_kernel, kernel, prefetch

# Closest that two times of an element may be (bins); closer ones are moved apart. Where all four
# are close, the jumps grow as 1/gap³ and with them the rounding error that the running sums leave:
# 0.05 keeps it near 1e-6 of what that element contributes, over 500 bins.
KNOT_GAP = 0.05


@allocating_kernel()
def _smear(histogram, t, c, source, first, shares):
    """Add the jump c·Σᵢ shareᵢ·source[first + i] at time t: third difference of hats.

    That is a quartic B-spline, times 4!.
    """
    i = int(t)
    g = t - i
    f = 1.0 - g
    spline = (
        c * (f * f * f * f),
        c * (1.0 + f * (4.0 + f * (6.0 + f * (4.0 - 4.0 * f)))),
        c * (11.0 + f * (12.0 - f * (6.0 + f * (12.0 - 6.0 * f)))),
        c * (1.0 + g * (4.0 + g * (6.0 + g * (4.0 - 4.0 * g)))),
        c * (g * g * g * g),
    )
    add_to_rows(histogram, (i, i + 1, i + 2, i + 3, i + 4), spline, source, first, shares)


@allocating_kernel()
def _pooled(y, k):
    """Value k of the isotonic regression of four numbers, by its max-min formula."""
    highest = -np.inf
    for i in range(k + 1):
        lowest, total = np.inf, 0.0
        for j in range(i, 4):
            total += y[j]
            if j >= k:
                lowest = min(lowest, total / (j - i + 1))
        highest = max(highest, lowest)
    return highest


@allocating_kernel()
def _spread(a, b, c, d):
    """The four times sorted and moved at least `KNOT_GAP` apart, as little as possible.

    Each cluster of close times keeps its mean and the others stay where they are.
    """
    a, b = min(a, b), max(a, b)
    c, d = min(c, d), max(c, d)
    a, c = min(a, c), max(a, c)
    b, d = min(b, d), max(b, d)
    b, c = min(b, c), max(b, c)
    y = (a, b - KNOT_GAP, c - 2.0 * KNOT_GAP, d - 3.0 * KNOT_GAP)
    return (
        _pooled(y, 0), _pooled(y, 1) + KNOT_GAP,
        _pooled(y, 2) + 2.0 * KNOT_GAP, _pooled(y, 3) + 3.0 * KNOT_GAP,
    )  # fmt: skip


@allocating_kernel(inline="always")
def _jumps(a, b, c, d):
    """−6/Πⱼ(tₖ − tⱼ) of each of the four times, over the 4! of `_smear`."""
    ab, ac, ad, bc, bd, cd = b - a, c - a, d - a, c - b, d - b, d - c
    return (
        0.25 / (ab * ac * ad), -0.25 / (ab * bc * bd), 0.25 / (ac * bc * cd),
        -0.25 / (ad * bd * cd),
    )  # fmt: skip


@allocating_kernel(error_model="numpy")
def deposit(time, corners, weights, origin, width, bins):
    """Histogram of |e|·(Gᵢ∇τ·∇Z) over activation time, shape (bins, 8).

    Bins overlap: bin i weighs time t by the hat max(0, 1 − |t − tᵢ|/width) around its peak
    tᵢ = origin + i·width (ms), so that total and mean time of each element are kept. An element
    with an infinite time is left out.

    Parameters
    ----------
    time : (n,) array
        Activation at each vertex (ms), from origin + width to origin + (bins − 6)·width, or
        +inf.
    corners, weights : (m, 4) and (m, 3, 8) arrays
        As in `fascicle.forward.electrocardiogram.Electrocardiograph`.
    """
    time = (time - origin) / width
    at_vertex = np.zeros((len(time), CHANNELS))
    histogram = np.zeros((bins, CHANNELS))
    for e in range(len(corners)):
        if e + 6 < len(corners):  # prefetch the rows that the sixth element from here adds to
            for n in range(4):
                prefetch(at_vertex, np.int64(corners[e + 6, n]) * CHANNELS * 8)
        i, j, k, l = corners[e]  # noqa: E741
        a, b, c, d = time[i], time[j], time[k], time[l]
        if not a + b + c + d < np.inf:
            continue
        # |e|·(Gᵢ∇τ·∇Z) in each channel is the sum of these times weights[e]
        later = (b - a, c - a, d - a)
        closest = min(abs(b - a), abs(c - a), abs(d - a), abs(c - b), abs(d - b), abs(d - c))
        if closest > KNOT_GAP:
            jumps = _jumps(a, b, c, d)
            add_to_rows(at_vertex, (i, j, k, l), jumps, weights, 3 * e, later)
        else:
            a, b, c, d = _spread(a, b, c, d)
            at_a, at_b, at_c, at_d = _jumps(a, b, c, d)
            _smear(histogram, a, at_a, weights, 3 * e, later)
            _smear(histogram, b, at_b, weights, 3 * e, later)
            _smear(histogram, c, at_c, weights, 3 * e, later)
            _smear(histogram, d, at_d, weights, 3 * e, later)
    for v in range(len(time)):
        if time[v] < np.inf:
            _smear(histogram, time[v], 1.0, at_vertex, v, (1.0,))
    for _ in range(3):
        for i in range(1, bins):
            for n in range(CHANNELS):
                histogram[i, n] += histogram[i - 1, n]
    return width * histogram


@allocating_kernel()
def respond(histogram, kernel, stride, samples):
    """Convolution of a (bins, 8) histogram with a kernel (k,), taken every `stride` bins.

    Sample n of the result (8, samples) is Σⱼ kernel[j]·histogram[n·stride + k − 1 − j].
    """
    response = np.zeros((CHANNELS, samples))
    total = np.zeros(CHANNELS)
    last = len(kernel) - 1
    for n in range(samples):
        total[:] = 0.0
        for j in range(len(kernel)):
            for c in range(CHANNELS):
                total[c] += kernel[j] * histogram[n * stride + last - j, c]
        response[:, n] = total
    return response


@kernel()
def reweight(weights, factors, axial, along, back, out):
    """Weights (m, 3, 8) of the ECG integral with other sources, written into `out`.

    Weights w of an element become f·(w + axial·b(aᵀw)): f is its row of `factors` (m,), a of `back`
    (m, 3) and b of `along` (m, 3). `axial` changes the component along the fibre.
    """
    for e in range(len(weights)):
        for c in range(weights.shape[2]):
            part = np.float32(0.0)
            for i in range(3):
                part += back[e, i] * weights[e, i, c]
            part *= axial
            for i in range(3):
                out[e, i, c] = factors[e] * (weights[e, i, c] + along[e, i] * part)
