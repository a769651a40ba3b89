"""From a vertex through the edges and the elements around it, its star.

What the sweep spends its time on, and so arranged that the processor need not wait: neither for
memory, which is asked for before its turn, nor to learn which way a branch goes. Elements that may
lower a corner are picked out first, what is known of them is laid side by side in blocks of
`LANES`, and each block is worked on at once.
"""

import numpy as np

from fascicle.kernels.arrays import CORNERS, SQUARES
from fascicle.kernels.jit import kernel
from fascicle.kernels.local_solver import from_new_corner
from fascicle.kernels.prefetch import CACHE_LINE, prefetch
from fascicle.kernels.queue import lower

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A slope of the times in an element that exceeds 1 by less is rounding.
STEEP = 1.0 + 1e-12

# PAIRS[s]: where, among the six pairs of a tetrahedron's corners, stand those of corner s with the
# others a, b, c, and the pairs ab, ac, bc
PAIRS = np.array(
    [[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]], np.uint32
)

# An item of a mesh's star is CORNERS·tetrahedron + place, CORNERS being a power of 2:
PLACE_BITS = np.uint32(CORNERS.bit_length() - 1)  # what is above these bits is the tetrahedron,
PLACE_MASK = np.uint32(CORNERS - 1)  # what is in them the vertex's place among its corners

BY_EDGE, NOT_LOWERED = -1, -2  # instead of the face that a neighbour was lowered by

LANES = 8  # in a block: as many as the widest registers hold

# Rows of a block of elements, for a vertex s and the other corners a, b, c: products and squares
# (`EikonalMesh.solver`) of the pairs sa, sb, sc, ab, ac, bc; times less that of s; squared slope
PRODUCT, SQUARE, DA, DB, DC, SLOPE = 0, 6 * LANES, 12 * LANES, 13 * LANES, 14 * LANES, 15 * LANES
ELEMENTS_BLOCK = 16 * LANES  # numbers in such a block

# Rows of a block of faces s, j, k opposite to a corner: what `from_new_corner` is given, its result
FACE_PRODUCT, FACE_SQUARE, TJ, TK, DELAY = 0, 6 * LANES, 11 * LANES, 12 * LANES, 13 * LANES
FACES_BLOCK = 14 * LANES


@kernel()
def number_neighbours(star_start, corners, link_start, link, others):
    """Find the corners of each vertex's elements among the vertices that share an edge with it.

    Parameters
    ----------
    star_start, link_start, link
        See `EikonalMesh`.
    corners : (4m, 3) array
        The other three corners of each of the vertices' tetrahedra.
    others : (4m, 3) array
        Overwritten: their places in the list of the vertex's neighbours.
    """
    for node in range(len(star_start) - 1):
        first, last = link_start[node], link_start[node + 1]
        for e in range(star_start[node], star_start[node + 1]):
            for k in range(CORNERS - 1):
                for place in range(last - first):
                    if link[first + place] == corners[e, k]:
                        others[e, k] = place


@kernel(inline="always")
def fetch_next(heap, size, mesh):
    """Ask for the elements of the vertex that is next, and for the stars of the two after it."""
    vertices = len(mesh.vertices)
    for k in range(min(size, 3)):
        node = heap[k]
        if node >= vertices:
            continue
        first, last = mesh.star_start[node], mesh.star_start[node + 1]
        if k == 0:
            for e in range(first, last):
                row = np.int64(mesh.star[e] >> PLACE_BITS) * 2 * SQUARES * 8
                prefetch(mesh.solver, row)
                prefetch(mesh.solver, row + CACHE_LINE)
            continue
        for byte in range(first * 4, last * 4, CACHE_LINE):
            prefetch(mesh.star, byte)
        for byte in range(first * 6, last * 6, CACHE_LINE):
            prefetch(mesh.others, byte)
        for byte in range(first * 12, last * 12, CACHE_LINE):
            prefetch(mesh.least, byte)
        first, last = mesh.link_start[node], mesh.link_start[node + 1]
        for byte in range(first * 4, last * 4, CACHE_LINE):
            prefetch(mesh.link, byte)
        for byte in range(first * 8, last * 8, CACHE_LINE):
            prefetch(mesh.link_time, byte)


@kernel(inline="always")
def _through_edges(node, mesh, front):
    """What the neighbours' times are, after the edges from the vertex, and which they lend."""
    time, place, around = front.time, front.queue.place, front.around
    now, first = time[node], mesh.link_start[node]
    for k in range(mesh.link_start[node + 1] - first):
        other, arrival = mesh.link[first + k], now + mesh.link_time[first + k]
        known = time[other]
        lowered = arrival < known - SETTLED
        around.time[k] = arrival if lowered else known
        around.by[k] = BY_EDGE if lowered else NOT_LOWERED
        around.lent[k] = known if (place[other] < 0) and not lowered else np.inf


@kernel(inline="always")
def _choose(node, mesh, front):
    """List the elements around the vertex that it may lower a corner of; returns how many.

    Corners that wait in the queue lend their times to no face: when the last corner of a face is
    taken, it passes on what comes through all of it.
    """
    time, lent, chosen = front.around.time, front.around.lent, front.around.chosen
    now, count = front.time[node], 0
    for e in range(mesh.star_start[node], mesh.star_start[node + 1]):
        a, b, c = mesh.others[e, 0], mesh.others[e, 1], mesh.others[e, 2]
        ready_a, ready_b, ready_c = lent[a] < np.inf, lent[b] < np.inf, lent[c] < np.inf
        to_a = (ready_b | ready_c) & (now + mesh.least[e, 0] < time[a])
        to_b = (ready_a | ready_c) & (now + mesh.least[e, 1] < time[b])
        to_c = (ready_a | ready_b) & (now + mesh.least[e, 2] < time[c])
        chosen[count, 0], chosen[count, 1] = e, to_a + 2 * to_b + 4 * to_c
        count += to_a | to_b | to_c
    return count


@kernel(inline="always")
def _lay_out(count, now, mesh, around):
    """Lay what is known of the chosen elements side by side."""
    rows, solver = around.elements, mesh.solver
    for i in range(count):
        e = around.chosen[i, 0]
        t, s = mesh.star[e] >> PLACE_BITS, mesh.star[e] & PLACE_MASK
        lane = (i // LANES) * ELEMENTS_BLOCK + i % LANES
        for k in range(6):
            pair = PAIRS[s, k]
            rows[lane + PRODUCT + k * LANES] = solver[t, pair]
            rows[lane + SQUARE + k * LANES] = solver[t, pair + np.uint32(SQUARES)]
        for k in range(3):
            rows[lane + DA + k * LANES] = around.time[mesh.others[e, k]] - now


@kernel(error_model="numpy")
def _slopes(f):
    """Squared slope of the times in each element of a block."""
    for i in range(LANES):
        psa, psb, psc = f[i], f[LANES + i], f[2 * LANES + i]
        pab, pac, pbc = f[3 * LANES + i], f[4 * LANES + i], f[5 * LANES + i]
        da, db, dc = f[DA + i], f[DB + i], f[DC + i]
        f[SLOPE + i] = -(
            psa * da * da + psb * db * db + psc * dc * dc
            + pab * (da - db) ** 2 + pac * (da - dc) ** 2 + pbc * (db - dc) ** 2
        )  # fmt: skip


@kernel(inline="always")
def _enter(n, corners, products, squares, tj, tk, around):
    """Write face number n, opposite corner a, with the others j and k."""
    f, lane = around.faces, (n // LANES) * FACES_BLOCK + n % LANES
    for k in range(6):
        f[lane + FACE_PRODUCT + k * LANES] = products[k]
    for k in range(5):
        f[lane + FACE_SQUARE + k * LANES] = squares[k]
    f[lane + TJ], f[lane + TK] = tj, tk
    around.corners[n, 0], around.corners[n, 1], around.corners[n, 2] = corners


@kernel(inline="always")
def _faces(count, now, mesh, around):
    """List the faces through which a corner may be lowered; returns how many.

    In names, a, b, c are the other corners of an element and s is the vertex: p.. are products,
    q.. squared travel times, t. the times that the corners lend, less that of the vertex. Each face
    is written, and written over by the next where it is not wanted.
    """
    rows, lent, n = around.elements, around.lent, 0
    for i in range(count):
        lane = (i // LANES) * ELEMENTS_BLOCK + i % LANES
        # where times rise no steeper than a front does, nothing in the element can be earlier
        if rows[lane + SLOPE] <= STEEP:
            continue
        e, wanted = around.chosen[i, 0], around.chosen[i, 1]
        a, b, c = mesh.others[e, 0], mesh.others[e, 1], mesh.others[e, 2]
        psa, psb, psc = rows[lane], rows[lane + LANES], rows[lane + 2 * LANES]
        pab, pac, pbc = rows[lane + 3 * LANES], rows[lane + 4 * LANES], rows[lane + 5 * LANES]
        lane += SQUARE
        qsa, qsb, qsc = rows[lane], rows[lane + LANES], rows[lane + 2 * LANES]
        qab, qac, qbc = rows[lane + 3 * LANES], rows[lane + 4 * LANES], rows[lane + 5 * LANES]
        ta, tb, tc = lent[a] - now, lent[b] - now, lent[c] - now
        products, squares = (psa, pab, pac, psb, psc, pbc), (qsa, qab, qac, qsb, qsc)
        _enter(n, (a, b, c), products, squares, tb, tc, around)
        n += wanted & 1
        products, squares = (psb, pab, pbc, psa, psc, pac), (qsb, qab, qbc, qsa, qsc)
        _enter(n, (b, a, c), products, squares, ta, tc, around)
        n += (wanted >> 1) & 1
        products, squares = (psc, pac, pbc, psa, psb, pab), (qsc, qac, qbc, qsa, qsb)
        _enter(n, (c, a, b), products, squares, ta, tb, around)
        n += (wanted >> 2) & 1
    return n


@kernel(error_model="numpy")
def _delays(f):
    """Delay of each face of a block."""
    for i in range(LANES):
        products = (
            f[i], f[LANES + i], f[2 * LANES + i],
            f[3 * LANES + i], f[4 * LANES + i], f[5 * LANES + i],
        )  # fmt: skip
        squares = (
            f[6 * LANES + i], f[7 * LANES + i], f[8 * LANES + i],
            f[9 * LANES + i], f[10 * LANES + i],
        )  # fmt: skip
        tj, tk = f[TJ + i], f[TK + i]
        f[DELAY + i] = from_new_corner(products, squares, tj, tk, tj < np.inf, tk < np.inf)


@kernel(inline="always")
def _take(n, now, around):
    """Lower the neighbours' times to what the first n faces offer."""
    for i in range(n):
        arrival = now + around.faces[(i // LANES) * FACES_BLOCK + i % LANES + DELAY]
        a = around.corners[i, 0]
        if arrival < around.time[a] - SETTLED:
            around.time[a], around.by[a] = arrival, i


@kernel(inline="always")
def _earliest(node, first, face, mesh, front):
    """The earliest corner of a face with the vertex."""
    around, earliest, soonest = front.around, node, front.time[node]
    for k in range(1, 3):
        other = around.corners[face, k]
        if around.lent[other] < soonest:
            earliest, soonest = np.int64(mesh.link[first + other]), around.lent[other]
    return earliest


@kernel(inline="always")
def _pass_on(node, mesh, front, size):
    """Enter the neighbours that were lowered into the queue; returns its size."""
    time, origin, around = front.time, front.origin, front.around
    first = mesh.link_start[node]
    for k in range(mesh.link_start[node + 1] - first):
        by = around.by[k]
        if by == NOT_LOWERED:
            continue
        source = _earliest(node, first, by, mesh, front) if by >= 0 else node
        other = np.int64(mesh.link[first + k])
        time[other], origin[other] = around.time[k], origin[source]
        size = lower(other, time, front.queue, size)
    return size


@kernel(inline="always")
def through_star(node, mesh, front, size):
    """From a vertex along its edges and through the elements around it; returns the queue's size.

    Parameters
    ----------
    node : int
        The vertex.
    mesh, front : EikonalMesh, Front
        See `fascicle.kernels.arrays`.
    size : int
        How many nodes are in the queue.
    """
    now, around = front.time[node], front.around
    _through_edges(node, mesh, front)
    count = _choose(node, mesh, front)
    _lay_out(count, now, mesh, around)
    for first in range(0, count, LANES):
        block = (first // LANES) * ELEMENTS_BLOCK
        _slopes(around.elements[block : block + ELEMENTS_BLOCK])
    count = _faces(count, now, mesh, around)
    for first in range(0, count, LANES):
        block = (first // LANES) * FACES_BLOCK
        _delays(around.faces[block : block + FACES_BLOCK])
    _take(count, now, around)
    return _pass_on(node, mesh, front, size)
