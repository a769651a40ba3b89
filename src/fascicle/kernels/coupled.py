"""Coupled eikonal solver: arrival times of trees and myocardium by one label-correcting sweep.

The queue holds nodes of both. A node that is taken from it lowers (makes earlier) the arrival times
of its neighbours through segments, edges and elements; these enter the queue, or move in it. "The
paper" is Álvarez-Barrientos et al., see the README.

The local solver gives the earliest arrival at a point from a face, edge or vertex, whose corners
are at eᵢ relative to the point. With A_ij = eᵢᵀD⁻¹eⱼ (ms²), the arrival time is the minimum of
Σλᵢτᵢ + √(λᵀAλ) over the simplex, τᵢ (ms) being the corners' times. In its interior it is

    μ = (b + √(b² − a(c − 1))) / a,   a = 1ᵀQ1,  b = 1ᵀQτ,  c = τᵀQτ,  Q = A⁻¹,

accepted when Q(μ1 − τ) ≥ 0; otherwise the minimum lies on an edge, by the same formula in two
unknowns, or at a vertex.

Most of the time is spent on the star of each vertex, the edges and elements around it. So memory is
prefetched and branches that the processor cannot predict are avoided. Vertices are taken in
batches: first the elements are chosen that may lower a corner, then those of their faces that may;
the faces' data are arranged in blocks of `LANES`, each of which is solved by vector instructions.
"""

import math
from enum import IntEnum

import numpy as np

from fascicle.kernels.arrays import CACHE_LINE, CORNERS, FACES, SQUARES
from fascicle.kernels.jit import kernel, prefetch

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A determinant below this fraction of the product of the diagonal: the point lies in the face, the
# inside of which is then not used. Meshes with flat elements are refused when they are read.
FLAT_ELEMENT = 1e-14

# PAIRS[s]: indices, among the six pairs of a tetrahedron's corners, of the pairs sa, sb, sc, ab, ac
# and bc, where a, b, c are the corners other than s
PAIRS = np.array(
    [[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]], np.uint32
)

# SOLVER_COLUMNS[s, k]: columns of `EikonalMesh.solver` with the arguments of `from_new_corner` for
# the face of corner s opposite to a, b or c: products, and all squares but that of the far edge
# (contiguous, as Numba caches no kernel with another array)
SOLVER_COLUMNS = np.ascontiguousarray(
    np.concatenate([PAIRS[:, PAIRS[1:]], PAIRS[:, PAIRS[1:, :5]] + np.uint32(SQUARES)], axis=2)
)

LAST = 2_000_000_000.0  # last bucket, also of all later times; −LAST also of all earlier ones
LANES = 8  # faces in a block: as many as the widest registers hold


class FaceRow(IntEnum):
    """Rows of a block of faces s, j, k of a corner, after the eleven of `SOLVER_COLUMNS`."""

    TJ = 11  # times of j and k, less that of s (ms); inf if they are not to be used
    TK = 12
    DELAY = 13  # after s (ms) with which the face fires the corner
    COUNT = 14


class Bucket(IntEnum):
    """Bucket of a node that is not in the queue."""

    NOT_QUEUED = np.iinfo(np.int32).min  # settled, or not reached yet
    IN_BATCH = np.iinfo(np.int32).min + 1  # its turn in a batch of nodes that were taken is to come


@kernel(inline="always")
def _unlink(node, nodes, head):
    before, after = nodes[node].before, nodes[node].after
    if before >= 0:
        nodes[before].after = after
    else:
        head[nodes[node].bucket & (len(head) - 1)] = after
    if after >= 0:
        nodes[after].before = before


@kernel()
def lower(node, arrival, origin, nodes, queue, size):
    """Lower a node to an arrival (ms), and enter or move it in a queue of `size` nodes.

    Nodes need not be taken in exact order, as a node that is taken too early is taken again. Its
    cost per node does not grow with the queue. Buckets form a ring: one list holds the nodes of
    buckets whose numbers differ by multiples of the ring's length.

    `nodes` is an array of STATE, and the `Queue` is one of `fascicle.kernels.arrays`. Returns the
    queue's size.
    """
    state, head = nodes[node], queue.head
    state.time, state.origin = arrival, origin
    # 20 buckets in 1 ms: an element's delay is longer than one, but on the finest meshes
    bucket = int(min(max(arrival * 20.0, -LAST), LAST))
    previous = state.bucket
    if previous == bucket:
        return size
    if previous > Bucket.IN_BATCH:
        _unlink(node, nodes, head)
        size -= 1
    first = head[bucket & (len(head) - 1)]
    state.before, state.after, state.bucket = -1, first, bucket
    if first >= 0:
        nodes[first].before = node
    head[bucket & (len(head) - 1)] = node
    queue.now[0] = min(queue.now[0], bucket)
    return size + 1


@kernel()
def take(nodes, queue):
    """Take a node of the earliest bucket out of a non-empty queue; returns the node."""
    head, bucket, passed = queue.head, queue.now[0], 0
    while True:
        node = head[bucket & (len(head) - 1)]
        while node >= 0 and nodes[node].bucket != bucket:
            node = nodes[node].after
        if node >= 0:
            break
        bucket, passed = bucket + 1, passed + 1
        if passed == len(head):  # the earliest bucket that holds a node is of a later lap
            bucket, passed = int(LAST), 0
            for k in range(len(head)):
                node = head[k]
                while node >= 0:
                    bucket = min(bucket, nodes[node].bucket)
                    node = nodes[node].after
    _unlink(node, nodes, head)
    nodes[node].bucket, queue.now[0] = Bucket.NOT_QUEUED, bucket
    return node


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
    """Earliest arrival (ms) through a face, its edges or its corners; times may be inf."""
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
    """Delay after s of the arrival at a through the inside of edge sj; inf if earliest at an end.

    As `from_edge` for times 0 and tj, with b² − a(c − det) = det·(sj − tj²).
    """
    aj = 0.5 * (ss + jj - sj)
    det = ss * jj - aj * aj
    mu = ((ss - aj) * tj + math.sqrt(det * (sj - tj * tj))) / sj
    inside = ((jj - aj) * mu + aj * tj >= 0.0) & ((ss - aj) * mu - ss * tj >= 0.0)
    return mu if inside & (det > FLAT_ELEMENT * ss * jj) else np.inf


@kernel(inline="always", error_model="numpy")
def from_new_corner(products, squares, tj, tk, use_j, use_k):
    """Delay (ms) after corner s of the arrival at corner a through the face s, j, k; or inf.

    The edge jk and the path from s itself are left out. The objective is convex: if its minimum in
    the plane of the face is outside the face, the minimum on the face is on an edge opposite to a
    corner whose weight is negative. The code has no branches, as several faces are solved at once.

    Parameters
    ----------
    products : tuple of 6 floats
        pᵢⱼ = ∇λᵢ·D∇λⱼ of the barycentric coordinates in the element a, s, j, k (1/ms²), for the
        pairs as, aj, ak, sj, sk, jk. The time in the element has the slope √(−Σ pᵢⱼ(τᵢ − τⱼ)²),
        which is 1 in a front; the front comes through the face if the weight of each of its
        corners is positive: Σⱼ pᵢⱼ τⱼ ≤ 0.
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


@kernel(inline="always")
def _fetch_star(node, mesh):
    """Prefetch the lists of a vertex's neighbours and elements."""
    # as many cache lines as most vertices' lists take: a loop as long as a list is dearer
    first = mesh.link_start[node] * mesh.link.itemsize
    for line in range(4):
        prefetch(mesh.link, first + line * CACHE_LINE)
    first = mesh.star_start[node] * mesh.star.itemsize
    for line in range(8):
        prefetch(mesh.star, first + line * CACHE_LINE)


@kernel(inline="always")
def _through_edges(node, at, mesh, front, size):
    """Lower the neighbours through edges; write their times from index `at` on; return queue size.

    Times of queued corners are not used for faces: the corner of a face that is taken last
    propagates the front through the whole face.
    """
    nodes, around = front.nodes, front.around
    node_time, first = nodes[node].time, mesh.link_start[node]
    for k in range(mesh.link_start[node + 1] - first):
        other = np.int64(mesh.link[first + k].vertex)
        arrival, time = node_time + mesh.link[first + k].time, nodes[other].time
        if arrival < time - SETTLED:
            time = arrival
            size = lower(other, arrival, nodes[node].origin, nodes, front.queue, size)
        later = np.float32(time - node_time)
        around.time[at + k] = time
        # no less than before it was rounded to single precision
        around.near[at + k].later = later + abs(later) * np.float32(2.0**-22)
        around.near[at + k].lends = nodes[other].bucket == Bucket.NOT_QUEUED
    return size


@kernel(inline="always")
def _divided(number):
    """Quotient and remainder of CORNERS·quotient + remainder, unsigned."""
    return number // np.uint32(CORNERS), number % np.uint32(CORNERS)


@kernel(inline="always")
def _choose(node, slot, at, count, mesh, front):
    """Append the elements in which a vertex may lower a corner to `count` others; the new count.

    `slot` is the index of the vertex in the batch; its neighbours are listed from `at` on.
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
        corners = to_a + 2 * to_b + 4 * to_c
        chosen[count].star, chosen[count].slot, chosen[count].corners = e, slot, corners
        count += np.uint64(corners > 0)
    for i in range(begin, count):
        t, _ = _divided(mesh.star[chosen[i].star].item)
        row = np.int64(t) * mesh.solver.strides[0]
        prefetch(mesh.solver, row)
        prefetch(mesh.solver, row + CACHE_LINE)
    return count


@kernel(inline="always")
def _is_steep(p, s, da, db, dc):
    """True if arrival times in an element rise more steeply than a front allows: ∇τᵀD∇τ > 1.

    `p` are the products of the element; da, db and dc are the delays of the other corners after s.
    """
    square = -(
        p[PAIRS[s, 0]] * da * da + p[PAIRS[s, 1]] * db * db + p[PAIRS[s, 2]] * dc * dc
        + p[PAIRS[s, 3]] * (da - db) ** 2 + p[PAIRS[s, 4]] * (da - dc) ** 2
        + p[PAIRS[s, 5]] * (db - dc) ** 2
    )  # fmt: skip
    return square > 1.0 + 1e-12  # below, it is rounding


@kernel(inline="always")
def _faces(count, room, mesh, front):
    """List the faces of chosen elements that may lower a corner; return their number.

    `room` is the number of rows for the neighbours of each vertex. In an element where times rise
    no more steeply than a front allows, no corner can be lowered.
    """
    around, n = front.around, np.uint64(0)
    for i in range(np.uint32(count)):
        element = around.chosen[i]
        row, slot = mesh.star[element.star], element.slot
        at = slot * room
        t, s = _divided(row.item)
        node_time = around.now[slot]
        da, db = around.time[at + row.a] - node_time, around.time[at + row.b] - node_time
        steep = _is_steep(mesh.solver[t], s, da, db, around.time[at + row.c] - node_time)
        to_lower = np.uint32(element.corners) * np.uint32(steep)
        for k in range(CORNERS - 1):
            around.face[n] = i * np.uint32(CORNERS) + np.uint32(k)
            n += np.uint64((to_lower >> np.uint32(k)) & np.uint32(1))
    return np.int64(n)


@kernel(inline="always")
def _lay_out_faces(n, room, mesh, around):
    """Arrange the inputs of `_delays`, for n faces, in blocks of `LANES`."""
    for i in range(n):
        place, k = _divided(around.face[i])
        element = around.chosen[place]
        row, slot = mesh.star[element.star], element.slot
        at = slot * room
        t, s = _divided(row.item)
        block, lane = around.faces[i // LANES], i % LANES
        for m in range(SOLVER_COLUMNS.shape[2]):
            block[m * LANES + lane] = mesh.solver[t, SOLVER_COLUMNS[s, k, m]]
        node_time = around.now[slot]
        at_j = at + (row.b if k == 0 else row.a)
        at_k = at + (row.b if k == 2 else row.c)
        block[FaceRow.TJ * LANES + lane] = (
            around.time[at_j] - node_time if around.near[at_j].lends else np.inf
        )
        block[FaceRow.TK * LANES + lane] = (
            around.time[at_k] - node_time if around.near[at_k].lends else np.inf
        )


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
        tj, tk = f[FaceRow.TJ * LANES + i], f[FaceRow.TK * LANES + i]
        f[FaceRow.DELAY * LANES + i] = from_new_corner(
            products, squares, tj, tk, tj < np.inf, tk < np.inf
        )


@kernel(inline="always")
def _lower_through_faces(n, mesh, front, size):
    """Lower corners to their arrivals through the first n faces; returns the queue's size."""
    nodes, around = front.nodes, front.around
    for i in range(n):
        place, k = _divided(around.face[i])
        element = around.chosen[place]
        row, slot = mesh.star[element.star], element.slot
        node = around.batch[slot]
        block, lane = around.faces[i // LANES], i % LANES
        arrival = around.now[slot] + block[FaceRow.DELAY * LANES + lane]
        first = mesh.link_start[node]
        corner = row.a if k == 0 else (row.b if k == 1 else row.c)
        other = np.int64(mesh.link[first + corner].vertex)
        if arrival < nodes[other].time - SETTLED:
            # the origin of the face's earliest corner
            source, soonest = node, 0.0
            tj, tk = block[FaceRow.TJ * LANES + lane], block[FaceRow.TK * LANES + lane]
            if tj < soonest:
                soonest = tj
                source = np.int64(mesh.link[first + (row.b if k == 0 else row.a)].vertex)
            if tk < soonest:
                source = np.int64(mesh.link[first + (row.b if k == 2 else row.c)].vertex)
            size = lower(other, arrival, nodes[source].origin, nodes, front.queue, size)
    return size


@kernel(inline="always")
def _through_stars(count, mesh, front, size):
    """Propagate from the first `count` vertices of `front.around.batch` through edges and elements.

    `size` is the number of nodes in the queue; the number afterwards is returned.
    """
    around, nodes = front.around, front.nodes
    room, chosen = np.uint64(len(around.time) // len(around.batch)), np.uint64(0)
    for slot in range(np.uint64(count)):
        node = around.batch[slot]
        if nodes[node].bucket != Bucket.IN_BATCH:
            continue  # lowered by another vertex of the batch, so in the queue again
        nodes[node].bucket = Bucket.NOT_QUEUED
        at = slot * room
        around.now[slot] = nodes[node].time
        size = _through_edges(node, at, mesh, front, size)
        chosen = _choose(node, slot, at, chosen, mesh, front)
    faces = _faces(chosen, room, mesh, front)
    _lay_out_faces(faces, room, mesh, around)
    for block in range((faces + LANES - 1) // LANES):
        _delays(around.faces[block])
    return _lower_through_faces(faces, mesh, front, size)


@kernel()
def solve_trees(time, forest):
    """Lower the times of tree nodes, in place, to their arrivals through the trees alone.

    c|∇τ·t| = 1 along each segment (the paper's equation `eikotree`), first towards the root, then
    away from it. As in the sweep, changes by rounding alone are ignored.
    """
    for node in forest.order[::-1]:
        parent = forest.parent[node]
        if parent >= 0:
            arrival = time[node] + forest.time[node]
            if arrival < time[parent] - SETTLED:
                time[parent] = arrival
    for node in forest.order:
        parent = forest.parent[node]
        if parent >= 0:
            arrival = time[parent] + forest.time[node]
            if arrival < time[node] - SETTLED:
                time[node] = arrival


@kernel(inline="always")
def _to_tree_node(other, arrival, by, vertices, forest, front, size):
    """Lower tree node `other` by a front that entered at site `by`; returns the queue's size."""
    state = front.nodes[vertices + other]
    if arrival < state.time - SETTLED:
        if forest.site[other] >= 0:
            front.entered_by[forest.site[other]] = -1
        size = lower(vertices + other, arrival, by, front.nodes, front.queue, size)
    return size


@kernel(inline="always")
def _fire(site, start, sites, front, size):
    """Propagate from a site that fires at `start` (ms) along its rays; returns the queue's size.

    The paper's coupling, τ(xⱼ) = √(D⁻¹(xⱼ − p)·(xⱼ − p)) + τ(p), for all xⱼ that rays reach, not
    only for the corners of the element around p.
    """
    nodes = front.nodes
    for k in range(sites.to_vertices.start[site], sites.to_vertices.start[site + 1]):
        vertex, arrival = sites.to_vertices.target[k], start + sites.to_vertices.time[k]
        if arrival < nodes[vertex].time - SETTLED:
            size = lower(vertex, arrival, site, nodes, front.queue, size)
    for k in range(sites.to_sites.start[site], sites.to_sites.start[site + 1]):
        entered = sites.to_sites.target[k]
        arrival = start + sites.to_sites.time[k] + sites.retrograde[entered]
        other = sites.node[entered]
        if arrival < nodes[other].time - SETTLED:
            front.entered_by[entered] = site
            size = lower(other, arrival, entered, nodes, front.queue, size)
    return size


@kernel()
def _arrival_inside(site, t, sites, mesh, nodes):
    """Earliest arrival (ms) at a site in tetrahedron t, from its four faces."""
    best = np.inf
    for skip in range(CORNERS):
        i, j, k = FACES[skip, 0], FACES[skip, 1], FACES[skip, 2]
        qi, qj, qk = sites.to_corner[site, i], sites.to_corner[site, j], sites.to_corner[site, k]
        gram = (
            qi, 0.5 * (qi + qj - mesh.solver[t, SQUARES + PAIRS[skip, 3]]),
            0.5 * (qi + qk - mesh.solver[t, SQUARES + PAIRS[skip, 4]]), qj,
            0.5 * (qj + qk - mesh.solver[t, SQUARES + PAIRS[skip, 5]]), qk,
        )  # fmt: skip
        ti, tj = nodes[mesh.corners[t, i]].time, nodes[mesh.corners[t, j]].time
        best = min(best, from_face(gram, (ti, tj, nodes[mesh.corners[t, k]].time)))
    return best


@kernel(inline="always")
def _into_trees(node, sites, mesh, front, size):
    """Propagate from a vertex to the sites in its elements; returns the queue's size."""
    nodes = front.nodes
    for k in range(sites.reader_start[node], sites.reader_start[node + 1]):
        site = sites.reader[k]
        other, t, delay = sites.node[site], sites.element[site], sites.retrograde[site]
        earliest = node
        for c in range(CORNERS):
            if nodes[mesh.corners[t, c]].time < nodes[earliest].time:
                earliest = mesh.corners[t, c]
        if nodes[earliest].time + delay >= nodes[other].time:
            continue
        arrival = delay + _arrival_inside(site, t, sites, mesh, nodes)
        if arrival < nodes[other].time - SETTLED:
            front.entered_by[site] = nodes[earliest].origin
            size = lower(other, arrival, site, nodes, front.queue, size)
    return size


@kernel(inline="always")
def _from_tree_node(node, vertices, forest, sites, front, size):
    """Propagate from a tree node along its segments and, if a site, its rays; returns the size."""
    node_time, by, node = front.nodes[node].time, front.nodes[node].origin, node - vertices
    parent, site = forest.parent[node], forest.site[node]
    if parent >= 0:
        arrival = node_time + forest.time[node]
        size = _to_tree_node(parent, arrival, by, vertices, forest, front, size)
    for k in range(forest.child_start[node], forest.child_start[node + 1]):
        child = forest.child[k]
        arrival = node_time + forest.time[child]
        size = _to_tree_node(child, arrival, by, vertices, forest, front, size)
    if site >= 0 and sites.anterograde[site] < np.inf:
        size = _fire(site, node_time + sites.anterograde[site], sites, front, size)
    return size


@kernel()
def sweep(front, sources, mesh, forest, sites):
    """Solve the paper's equations `eikotree` and `eikomyo` together, in place.

    Nodes are numbered mesh vertices first, tree nodes after them. A node is taken when it is among
    the earliest, and again if its time is lowered later; nothing is skipped for being early, since
    with anisotropy and obtuse elements times need not settle in order.

    Linear interpolation is late where fronts are curved, most of all near a point source. So a
    site that fires, from its tree, as a stimulus or as the front passes it, also activates the
    vertices and sites around it along rays, after the ray travel time. Such an arrival depends on
    the starting times alone and does not become later if those become earlier, so the result does
    not depend on the order in which nodes are taken. Where fronts collide, linear interpolation
    between them is early, by a part of an edge's time.

    Parameters
    ----------
    front : Front
        Times (ms): inf but at the sources, with trees settled (`solve_trees`). Origins and sites
        that trees were entered from: -1. An empty queue. Overwritten.
    sources : (s,) array
        Nodes from which the front starts: vertices whose time is given, and the sites' nodes.
    """
    batch, nodes = front.around.batch, front.nodes
    vertices, size = len(mesh.vertices), 0
    for source in sources:
        size = lower(source, nodes[source].time, nodes[source].origin, nodes, front.queue, size)
    while size > 0:
        count = 0
        while count < len(batch) and size > 0:
            node, size = take(nodes, front.queue), size - 1
            if node < vertices:
                batch[count], nodes[node].bucket = node, Bucket.IN_BATCH
                count += 1
                _fetch_star(node, mesh)
            else:
                size = _from_tree_node(node, vertices, forest, sites, front, size)
        size = _through_stars(count, mesh, front, size)
        for k in range(count):
            size = _into_trees(batch[k], sites, mesh, front, size)
