"""Propagation from vertices through the edges and elements around them, their stars.

The sweep spends its time here, so the processor must not wait: neither for memory, which is asked
for before its turn, nor to learn which way a branch goes. A batch of vertices is worked on at a
time, in steps: elements that may lower a corner are picked out first, then those of their faces
that may; the data of the faces are laid side by side in blocks of `LANES`, and each block is
worked on at once.
"""

import numpy as np

from fascicle.kernels.arrays import CACHE_LINE, CORNERS, LINK, SQUARES, STAR
from fascicle.kernels.jit import kernel, prefetch
from fascicle.kernels.local_solver import from_new_corner
from fascicle.kernels.queue import IN_BATCH, NOT_QUEUED, lower

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A slope of the times in an element that exceeds 1 by less is rounding.
STEEP = 1.0 + 1e-12

VERTICES_AT_ONCE = 8  # vertices worked on at a time, at most; a power of 2

# Cache lines prefetched: as many as most vertices' lists take. A loop as long as a list is dearer.
LINK_LINES, STAR_LINES = 4, 8
LINK_BYTES, STAR_BYTES = LINK.itemsize, STAR.itemsize

# PAIRS[s]: where, among the six pairs of a tetrahedron's corners, stand those of corner s with the
# others a, b, c, and the pairs ab, ac, bc
PAIRS = np.array(
    [[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]], np.uint32
)

# SOLVER_COLUMNS[s, k]: the columns of `EikonalMesh.solver` with what `from_new_corner` is given for
# the face of corner s opposite to a, b or c: products, and all squares but the one of the far edge
_PAIRS_FROM = PAIRS[:, PAIRS[1:]]
SOLVER_COLUMNS = np.ascontiguousarray(
    np.concatenate([_PAIRS_FROM, _PAIRS_FROM[:, :, :5] + np.uint32(SQUARES)], axis=2)
)

# An item of a mesh's star is CORNERS·tetrahedron + place, CORNERS being a power of 2: what is above
# these bits is the tetrahedron, what is in them the vertex's place among its corners. A face is
# CORNERS·element + which of a, b and c it is opposite to, likewise.
PLACE_BITS, PLACE_MASK = np.uint32(CORNERS.bit_length() - 1), np.uint32(CORNERS - 1)

LANES = 8  # in a block: as many as the widest registers hold

# Rows of a block of faces s, j, k opposite to a corner: what `from_new_corner` is given, products
# and squares first, and its result
TERMS = SOLVER_COLUMNS.shape[2]  # how many products and squares
TJ, TK, FROM_CORNER = TERMS * LANES, (TERMS + 1) * LANES, (TERMS + 2) * LANES
FACES_BLOCK = (TERMS + 3) * LANES

# A chosen element in one number: from the lowest bits on, which corners may be lowered (the sum of
# 1, 2 and 4), the vertex's place in the batch, and the element's place in `EikonalMesh.star`
CORNERS_MASK, SLOT_BITS = np.uint64(7), np.uint64(3)
SLOT_MASK, ITEM_BITS = (
    np.uint64(VERTICES_AT_ONCE - 1),
    np.uint64(3 + (VERTICES_AT_ONCE - 1).bit_length()),
)

# Raised by this share of its size, a number rounded to single precision is no less than before
ROUNDING = np.float32(2.0**-22)


@kernel()
def number_neighbours(star_start, corners, link_start, link, others):
    """Find the corners of each vertex's elements among the vertices that share an edge with it.

    `corners` (4m, 3) are the other three of each of the vertices' tetrahedra, `link` (l,) the
    vertices that share an edge with each, and `others` (4m, 3) becomes the corners' places there.
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
    """Prefetch the lists of a vertex's neighbours and elements."""
    first = mesh.link_start[node] * LINK_BYTES
    for line in range(LINK_LINES):
        prefetch(mesh.link, first + line * CACHE_LINE)
    first = mesh.star_start[node] * STAR_BYTES
    for line in range(STAR_LINES):
        prefetch(mesh.star, first + line * CACHE_LINE)


@kernel(inline="always")
def _through_edges(node, at, mesh, front, size):
    """Lower the neighbours through edges, note their times from `at` on; return the queue's size.

    Corners that wait in the queue lend their times to no face: the last corner of a face to be
    taken passes on the front that comes through all of it.
    """
    nodes, around = front.nodes, front.around
    now, first = nodes[node].time, mesh.link_start[node]
    for k in range(mesh.link_start[node + 1] - first):
        other = np.int64(mesh.link[first + k].vertex)
        arrival, time = now + mesh.link[first + k].time, nodes[other].time
        if arrival < time - SETTLED:
            time = arrival
            nodes[other].time, nodes[other].origin = arrival, nodes[node].origin
            size = lower(other, nodes, front.queue, size)
        later = np.float32(time - now)
        around.time[at + k] = time
        around.near[at + k].later = later + abs(later) * ROUNDING
        around.near[at + k].lends = nodes[other].bucket == NOT_QUEUED
    return size


@kernel(inline="always")
def _choose(node, slot, at, count, mesh, front):
    """List the elements in which a vertex may lower a corner, after `count` others; count all.

    `slot` is the vertex's place in the batch, and its neighbours stand from `at` on.
    """
    around, begin = front.around, count
    chosen, near = around.chosen, around.near[at:]
    for e in range(np.uint64(mesh.star_start[node]), np.uint64(mesh.star_start[node + 1])):
        row = mesh.star[e]
        a, b, c = row.a, row.b, row.c
        lends_a, lends_b, lends_c = near[a].lends, near[b].lends, near[c].lends
        to_a = (lends_b | lends_c) & np.uint32(row.least_a < near[a].later)
        to_b = (lends_a | lends_c) & np.uint32(row.least_b < near[b].later)
        to_c = (lends_a | lends_b) & np.uint32(row.least_c < near[c].later)
        corners = np.uint64(to_a + 2 * to_b + 4 * to_c)
        chosen[count] = (e << ITEM_BITS) | (slot << SLOT_BITS) | corners
        count += np.uint64(corners > 0)
    for i in range(begin, count):
        row = np.int64(mesh.star[chosen[i] >> ITEM_BITS].item >> PLACE_BITS) * 2 * SQUARES * 8
        prefetch(mesh.solver, row)
        prefetch(mesh.solver, row + CACHE_LINE)
    return count


@kernel(inline="always")
def _unpacked(element, mesh):
    """Row of the star of a chosen element, and its vertex's place in the batch."""
    return mesh.star[element >> ITEM_BITS], (element >> SLOT_BITS) & SLOT_MASK


@kernel(inline="always")
def _steep(p, s, da, db, dc):
    """Whether times in an element rise more steeply than in a front.

    `p` are its products, and the corners beside s are later than that by da, db and dc.
    """
    square = -(
        p[PAIRS[s, 0]] * da * da + p[PAIRS[s, 1]] * db * db + p[PAIRS[s, 2]] * dc * dc
        + p[PAIRS[s, 3]] * (da - db) ** 2 + p[PAIRS[s, 4]] * (da - dc) ** 2
        + p[PAIRS[s, 5]] * (db - dc) ** 2
    )  # fmt: skip
    return square > STEEP


@kernel(inline="always")
def _faces(count, room, mesh, front):
    """List the faces of chosen elements that may lower a corner; return their number.

    There is room for `room` neighbours of each vertex. Where times rise no steeper than a front
    does, nothing in the element can be earlier.
    """
    around, n = front.around, np.uint64(0)
    for i in range(np.uint32(count)):
        element = around.chosen[i]
        row, slot = _unpacked(element, mesh)
        at = slot * room
        t, s = row.item >> PLACE_BITS, row.item & PLACE_MASK
        now = around.now[slot]
        da, db = around.time[at + row.a] - now, around.time[at + row.b] - now
        steep = _steep(mesh.solver[t], s, da, db, around.time[at + row.c] - now)
        to_lower = np.uint32(element & CORNERS_MASK) * np.uint32(steep)
        for k in range(CORNERS - 1):
            around.face[n] = i * np.uint32(CORNERS) + np.uint32(k)
            n += np.uint64((to_lower >> np.uint32(k)) & np.uint32(1))
    return np.int64(n)


@kernel(inline="always")
def _lay_out_faces(n, room, mesh, around):
    """Lay the inputs of the delays through the faces side by side."""
    f = around.faces
    for i in range(n):
        k, element = around.face[i] & PLACE_MASK, around.chosen[around.face[i] >> PLACE_BITS]
        row, slot = _unpacked(element, mesh)
        at = slot * room
        t, s = row.item >> PLACE_BITS, row.item & PLACE_MASK
        lane = (i // LANES) * FACES_BLOCK + i % LANES
        for m in range(TERMS):
            f[lane + m * LANES] = mesh.solver[t, SOLVER_COLUMNS[s, k, m]]
        now = around.now[slot]
        at_j = at + (row.b if k == 0 else row.a)
        at_k = at + (row.b if k == 2 else row.c)
        f[lane + TJ] = around.time[at_j] - now if around.near[at_j].lends else np.inf
        f[lane + TK] = around.time[at_k] - now if around.near[at_k].lends else np.inf


@kernel(error_model="numpy")
def _delays(f):
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
        f[FROM_CORNER + i] = from_new_corner(products, squares, tj, tk, tj < np.inf, tk < np.inf)


@kernel(inline="always")
def _take(n, mesh, front, size):
    """Lower corners to their arrivals through the first n faces; returns the queue's size."""
    nodes, around = front.nodes, front.around
    for i in range(n):
        k, element = around.face[i] & PLACE_MASK, around.chosen[around.face[i] >> PLACE_BITS]
        row, slot = _unpacked(element, mesh)
        node = around.batch[slot]
        lane = (i // LANES) * FACES_BLOCK + i % LANES
        arrival = around.now[slot] + around.faces[lane + FROM_CORNER]
        first = mesh.link_start[node]
        place = row.a if k == 0 else (row.b if k == 1 else row.c)
        other = np.int64(mesh.link[first + place].vertex)
        if arrival < nodes[other].time - SETTLED:
            # the origin of the face's earliest corner
            source, soonest = node, 0.0
            if around.faces[lane + TJ] < soonest:
                soonest = around.faces[lane + TJ]
                source = np.int64(mesh.link[first + (row.b if k == 0 else row.a)].vertex)
            if around.faces[lane + TK] < soonest:
                source = np.int64(mesh.link[first + (row.b if k == 2 else row.c)].vertex)
            nodes[other].time, nodes[other].origin = arrival, nodes[source].origin
            size = lower(other, nodes, front.queue, size)
    return size


@kernel(inline="always")
def through_stars(taken, mesh, front, size):
    """Propagate from the first `taken` vertices of `front.around.batch` through edges and elements.

    `size` is the number of nodes in the queue; the number afterwards is returned.
    """
    around, nodes = front.around, front.nodes
    room, chosen = np.uint64(len(around.time) // len(around.batch)), np.uint64(0)
    for slot in range(np.uint64(taken)):
        node = around.batch[slot]
        if nodes[node].bucket != IN_BATCH:
            continue  # lowered by another of the batch, it is to be taken again
        nodes[node].bucket = NOT_QUEUED
        at = slot * room
        around.now[slot] = nodes[node].time
        size = _through_edges(node, at, mesh, front, size)
        chosen = _choose(node, slot, at, chosen, mesh, front)
    count = _faces(chosen, room, mesh, front)
    _lay_out_faces(count, room, mesh, around)
    for first in range(0, count, LANES):
        block = (first // LANES) * FACES_BLOCK
        _delays(around.faces[block : block + FACES_BLOCK])
    return _take(count, mesh, front, size)
