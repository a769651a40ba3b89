"""From vertices through the edges and the elements around them, their stars.

What the sweep spends its time on, and so arranged that the processor need not wait: neither for
memory, which is asked for before its turn, nor to learn which way a branch goes. So a batch of
vertices is worked on at a time, in steps: elements that may lower a corner are picked out first,
what is known of them is laid side by side in blocks of `LANES`, and each block is worked on at
once.
"""

import numpy as np

from fascicle.kernels.arrays import CACHE_LINE, CORNERS, SQUARES
from fascicle.kernels.jit import kernel
from fascicle.kernels.local_solver import from_new_corner
from fascicle.kernels.prefetch import prefetch
from fascicle.kernels.queue import IN_BATCH, WAITS_NOT, lower

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A slope of the times in an element that exceeds 1 by less is rounding.
STEEP = 1.0 + 1e-12

BATCH = 8  # vertices worked on at a time, at most

# PAIRS[s]: where, among the six pairs of a tetrahedron's corners, stand those of corner s with the
# others a, b, c, and the pairs ab, ac, bc
PAIRS = np.array(
    [[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]], np.uint32
)

# COLUMNS[s, k]: the columns of `EikonalMesh.solver` with what `from_new_corner` is given for the
# face of corner s opposite to a, b or c: products, and all squares but the one of the far edge
_PAIRS_FROM = PAIRS[:, PAIRS[1:]]
COLUMNS = np.ascontiguousarray(
    np.concatenate([_PAIRS_FROM, _PAIRS_FROM[:, :, :5] + np.uint32(SQUARES)], axis=2)
)

REST = np.array([[1, 2], [0, 2], [0, 1]], np.uint32)  # of a, b, c without one of them

# An item of a mesh's star is CORNERS·tetrahedron + place, CORNERS being a power of 2:
PLACE_BITS = np.uint32(CORNERS.bit_length() - 1)  # what is above these bits is the tetrahedron,
PLACE_MASK = np.uint32(CORNERS - 1)  # what is in them the vertex's place among its corners

LANES = 8  # in a block: as many as the widest registers hold

# Rows of a block of elements, for a vertex s and the other corners a, b, c: products
# (`EikonalMesh.solver`) of the pairs sa, sb, sc, ab, ac, bc; times less that of s; whether
# they rise too steeply
PRODUCT, DA, DB, DC, RISE = 0, 6 * LANES, 7 * LANES, 8 * LANES, 9 * LANES
ELEMENTS_BLOCK = 10 * LANES  # numbers in such a block

# Rows of a block of faces s, j, k opposite to a corner: what `from_new_corner` is given, products
# and squares first, and its result
SHAPE = COLUMNS.shape[2]  # how many products and squares
TJ, TK, DELAY = SHAPE * LANES, (SHAPE + 1) * LANES, (SHAPE + 2) * LANES
FACES_BLOCK = (SHAPE + 3) * LANES


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
def fetch_star(node, mesh):
    """Ask for the lists of a vertex's neighbours and elements."""
    first, last = mesh.star_start[node], mesh.star_start[node + 1]
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
def _through_edges(node, at, mesh, front, size):
    """Lower the neighbours through edges, and note their times from `at` on.

    Returns the queue's size. Corners that wait in the queue lend their times to no face: when the
    last corner of a face is taken, it passes on what comes through all of it.
    """
    time, bucket, around = front.time, front.queue.bucket, front.around
    now, first = time[node], mesh.link_start[node]
    for k in range(mesh.link_start[node + 1] - first):
        other, arrival = np.int64(mesh.link[first + k]), now + mesh.link_time[first + k]
        if arrival < time[other] - SETTLED:
            time[other], front.origin[other] = arrival, front.origin[node]
            size = lower(other, time, front.queue, size)
        around.time[at + k] = time[other]
        around.lent[at + k] = time[other] if bucket[other] == WAITS_NOT else np.inf
    return size


@kernel(inline="always")
def _choose(node, at, count, mesh, front):
    """List the elements around a vertex that it may lower a corner of; returns how many there are.

    What is known of them is asked for.
    """
    around = front.around
    now, begin, chosen = front.time[node], count, around.chosen
    for e in range(np.uint32(mesh.star_start[node]), np.uint32(mesh.star_start[node + 1])):
        a, b, c = at + mesh.others[e, 0], at + mesh.others[e, 1], at + mesh.others[e, 2]
        ready_a, ready_b = around.lent[a] < np.inf, around.lent[b] < np.inf
        ready_c = around.lent[c] < np.inf
        to_a = (ready_b | ready_c) & (now + mesh.least[e, 0] < around.time[a])
        to_b = (ready_a | ready_c) & (now + mesh.least[e, 1] < around.time[b])
        to_c = (ready_a | ready_b) & (now + mesh.least[e, 2] < around.time[c])
        chosen.item[count], chosen.corners[count] = e, to_a + 2 * to_b + 4 * to_c
        chosen.vertex[count], chosen.at[count] = node, at
        count += np.uint64(to_a | to_b | to_c)
    for i in range(begin, count):
        row = np.int64(mesh.star[chosen.item[i]] >> PLACE_BITS) * 2 * SQUARES * 8
        prefetch(mesh.solver, row)
        prefetch(mesh.solver, row + CACHE_LINE)
    return count


@kernel(inline="always")
def _lay_out(count, mesh, front):
    """Lay what the slopes in the chosen elements depend on side by side."""
    around = front.around
    rows = around.elements
    for i in range(count):
        e, at = around.chosen.item[i], around.chosen.at[i]
        t, s = mesh.star[e] >> PLACE_BITS, mesh.star[e] & PLACE_MASK
        lane = (i // LANES) * ELEMENTS_BLOCK + i % LANES
        for k in range(6):
            rows[lane + PRODUCT + k * LANES] = mesh.solver[t, PAIRS[s, k]]
        for k in range(3):
            rows[lane + DA + k * LANES] = around.time[at + mesh.others[e, k]] - around.now[at]


@kernel(error_model="numpy")
def _slopes(f):
    """Which elements of a block have times that rise steeper than a front does: 1, or 0."""
    for i in range(LANES):
        psa, psb, psc = f[i], f[LANES + i], f[2 * LANES + i]
        pab, pac, pbc = f[3 * LANES + i], f[4 * LANES + i], f[5 * LANES + i]
        da, db, dc = f[DA + i], f[DB + i], f[DC + i]
        square = -(
            psa * da * da + psb * db * db + psc * dc * dc
            + pab * (da - db) ** 2 + pac * (da - dc) ** 2 + pbc * (db - dc) ** 2
        )  # fmt: skip
        f[RISE + i] = 1.0 if square > STEEP else 0.0


@kernel(inline="always")
def _faces(count, front):
    """List the faces through which a corner may be lowered; returns how many.

    Where times rise no steeper than a front does, nothing in the element can be earlier.
    """
    around, n = front.around, np.uint64(0)
    for i in range(count):
        lane = (i // LANES) * ELEMENTS_BLOCK + i % LANES
        wanted = around.chosen.corners[i] * np.uint32(around.elements[lane + RISE])
        for k in range(CORNERS - 1):
            around.face.row[n], around.face.corner[n] = i, k
            n += np.uint64((wanted >> np.uint32(k)) & np.uint32(1))
    return np.int64(n)


@kernel(inline="always")
def _lay_out_faces(n, mesh, around):
    """Lay what the delays through the faces depend on side by side."""
    f = around.faces
    for i in range(n):
        c, k = around.face.row[i], around.face.corner[i]
        e, at = around.chosen.item[c], around.chosen.at[c]
        t, s = mesh.star[e] >> PLACE_BITS, mesh.star[e] & PLACE_MASK
        lane = (i // LANES) * FACES_BLOCK + i % LANES
        for m in range(SHAPE):
            f[lane + m * LANES] = mesh.solver[t, COLUMNS[s, k, m]]
        now = around.now[at]
        f[lane + TJ] = around.lent[at + mesh.others[e, REST[k, 0]]] - now
        f[lane + TK] = around.lent[at + mesh.others[e, REST[k, 1]]] - now


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
def _take(n, mesh, front, size):
    """Lower corners to what the first n faces offer; returns the queue's size."""
    time, around = front.time, front.around
    for i in range(n):
        c, k = around.face.row[i], around.face.corner[i]
        e, node, at = around.chosen.item[c], around.chosen.vertex[c], around.chosen.at[c]
        lane = (i // LANES) * FACES_BLOCK + i % LANES
        arrival = around.now[at] + around.faces[lane + DELAY]
        first = mesh.link_start[node]
        other = np.int64(mesh.link[first + mesh.others[e, k]])
        if arrival < time[other] - SETTLED:
            # the origin of the face's earliest corner
            source, soonest = np.int64(node), 0.0
            for m in range(2):
                if around.faces[lane + TJ + m * LANES] < soonest:
                    soonest = around.faces[lane + TJ + m * LANES]
                    source = np.int64(mesh.link[first + mesh.others[e, REST[k, m]]])
            time[other], front.origin[other] = arrival, front.origin[source]
            size = lower(other, time, front.queue, size)
    return size


@kernel(inline="always")
def through_stars(taken, mesh, front, size):
    """From a batch of vertices along their edges and through the elements around them.

    Returns the queue's size.

    Parameters
    ----------
    taken : int
        How many vertices are in `front.around.batch`.
    mesh, front : EikonalMesh, Front
        See `fascicle.kernels.arrays`.
    size : int
        How many nodes are in the queue.
    """
    around, bucket = front.around, front.queue.bucket
    room, chosen = len(around.time) // len(around.batch), np.uint64(0)
    for k in range(taken):
        node = around.batch[k]
        if bucket[node] != IN_BATCH:
            continue  # lowered by another of the batch, it is to be taken again
        bucket[node] = WAITS_NOT
        at = np.uint32(k * room)
        around.now[at] = front.time[node]
        size = _through_edges(node, at, mesh, front, size)
        chosen = _choose(node, at, chosen, mesh, front)
    count = np.int64(chosen)
    _lay_out(count, mesh, front)
    for first in range(0, count, LANES):
        block = (first // LANES) * ELEMENTS_BLOCK
        _slopes(around.elements[block : block + ELEMENTS_BLOCK])
    count = _faces(count, front)
    _lay_out_faces(count, mesh, around)
    for first in range(0, count, LANES):
        block = (first // LANES) * FACES_BLOCK
        _delays(around.faces[block : block + FACES_BLOCK])
    return _take(count, mesh, front, size)
