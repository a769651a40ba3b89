"""Trees and myocardium in one label-correcting sweep."""

import math

import numpy as np
from numba import njit

from fascicle.kernels.local_solver import from_edge, from_face, from_inside_face
from fascicle.kernels.queue import lower, pop

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# PAIR[i, j]: where a tetrahedron's edge i-j stands among its six squared lengths
PAIR = np.array([[-1, 0, 1, 2], [0, -1, 3, 4], [1, 3, -1, 5], [2, 4, 5, -1]])


@njit(cache=True, nogil=True)
def _arrival(at, source, tetrahedron, corners, squares, time):
    """Earliest arrival (ms) at corner `at` of a tetrahedron by ways that touch corner `source`."""
    other = 6 - at - source  # the two remaining corners sum to this
    first = 0
    while first in (at, source):
        first += 1
    second = other - first
    ts = time[corners[tetrahedron, source]]
    t1, t2 = time[corners[tetrahedron, first]], time[corners[tetrahedron, second]]
    row = squares[tetrahedron]
    ass = row[PAIR[source, at]]
    best = ts + math.sqrt(ass)
    a11, a22 = row[PAIR[first, at]], row[PAIR[second, at]]
    as1 = 0.5 * (ass + a11 - row[PAIR[source, first]])
    as2 = 0.5 * (ass + a22 - row[PAIR[source, second]])
    if t1 < np.inf:
        best = min(best, from_edge(ass, as1, a11, ts, t1))
        if t2 < np.inf:
            a12 = 0.5 * (a11 + a22 - row[PAIR[first, second]])
            best = min(best, from_inside_face(ass, as1, as2, a11, a12, a22, ts, t1, t2))
    if t2 < np.inf:
        best = min(best, from_edge(ass, as2, a22, ts, t2))
    return best


@njit(cache=True, nogil=True)
def _arrival_inside(tetrahedron, to_corner, corners, squares, time):
    """Earliest arrival (ms) at a point of a tetrahedron, from its four faces.

    `to_corner` are the point's squared metric distances to the corners.
    """
    best = np.inf
    row = squares[tetrahedron]
    for skip in range(4):
        i, j, k = (skip + 1) % 4, (skip + 2) % 4, (skip + 3) % 4
        aii, ajj, akk = to_corner[i], to_corner[j], to_corner[k]
        aij = 0.5 * (aii + ajj - row[PAIR[i, j]])
        aik = 0.5 * (aii + akk - row[PAIR[i, k]])
        ajk = 0.5 * (ajj + akk - row[PAIR[j, k]])
        ti, tj, tk = (
            time[corners[tetrahedron, i]],
            time[corners[tetrahedron, j]],
            time[corners[tetrahedron, k]],
        )
        best = min(best, from_face(aii, aij, aik, ajj, ajk, akk, ti, tj, tk))
    return best


@njit(cache=True, nogil=True)
def sweep(
    time, sources,
    corners, squares, vertex_start, vertex_tetrahedra,
    link_start, link_node, link_time,
    junction_of, junction_tetrahedron, junction_to_corner,
    ball_start, ball_vertex, ball_time,
    reader_start, reader_junction,
    orthodromic_delay, antidromic_delay,
):  # fmt: skip
    """Solve the coupled problem in place.

    Nodes are numbered mesh vertices first, tree nodes after them. A node is taken when it is the
    earliest, and again if its time is lowered later; nothing is skipped for being early, since
    with anisotropy and obtuse elements times need not settle in order.

    Parameters
    ----------
    time : (vertices + tree nodes,) array
        Times (ms); inf but at the sources. Overwritten.
    sources : (s,) array
        Nodes whose time is given.
    corners : (m, 4) array
        Vertices of each tetrahedron.
    squares : (m, 6) array
        Squared travel times (ms²) along its edges 01, 02, 03, 12, 13, 23.
    vertex_start, vertex_tetrahedra : arrays
        The tetrahedra of each vertex, as 4·tetrahedron + corner.
    link_start, link_node, link_time : arrays
        Tree neighbours of each tree node and travel time to them (ms).
    junction_of : (tree nodes,) array
        Number of the junction at each tree node, or -1.
    junction_tetrahedron, junction_to_corner : (j,) and (j, 4) arrays
        The element each junction lies in, and squared travel times (ms²) to its corners.
    ball_start, ball_vertex, ball_time : arrays
        The vertices that a junction fires, and after what time (ms).
    reader_start, reader_junction : arrays
        The junctions whose element contains each vertex.
    orthodromic_delay, antidromic_delay : float
        Delay of a junction in either direction (ms).

    Returns
    -------
    int
        How many nodes were taken from the queue, counting repeats.
    """
    vertices = len(vertex_start) - 1
    junction_node = np.empty(len(junction_tetrahedron), np.int64)
    for node in range(len(junction_of)):
        if junction_of[node] >= 0:
            junction_node[junction_of[node]] = vertices + node
    heap = np.empty(len(time), np.int64)
    place = np.full(len(time), -1, np.int64)
    size = 0
    for source in sources:
        size = lower(source, time, heap, place, size)
    taken = 0
    while size > 0:
        node, size = pop(time, heap, place, size)
        taken += 1
        if node >= vertices:
            tree_node = node - vertices
            for k in range(link_start[tree_node], link_start[tree_node + 1]):
                other, arrival = vertices + link_node[k], time[node] + link_time[k]
                if arrival < time[other] - SETTLED:
                    time[other] = arrival
                    size = lower(other, time, heap, place, size)
            junction = junction_of[tree_node]
            if junction >= 0:
                fired = time[node] + orthodromic_delay
                for k in range(ball_start[junction], ball_start[junction + 1]):
                    vertex, arrival = ball_vertex[k], fired + ball_time[k]
                    if arrival < time[vertex] - SETTLED:
                        time[vertex] = arrival
                        size = lower(vertex, time, heap, place, size)
            continue
        for k in range(vertex_start[node], vertex_start[node + 1]):
            tetrahedron, source = vertex_tetrahedra[k] >> 2, vertex_tetrahedra[k] & 3
            for at in range(4):
                vertex = corners[tetrahedron, at]
                # a way from the popped vertex alone cannot arrive before it, but one through
                # earlier corners of the same face can, so compare with the earliest of them
                if at == source:
                    continue
                earliest = np.inf
                for corner in range(4):
                    if corner != at:
                        earliest = min(earliest, time[corners[tetrahedron, corner]])
                if time[vertex] <= earliest:
                    continue
                arrival = _arrival(at, source, tetrahedron, corners, squares, time)
                if arrival < time[vertex] - SETTLED:
                    time[vertex] = arrival
                    size = lower(vertex, time, heap, place, size)
        for k in range(reader_start[node], reader_start[node + 1]):
            junction = reader_junction[k]
            arrival = antidromic_delay + _arrival_inside(
                junction_tetrahedron[junction], junction_to_corner[junction], corners, squares, time
            )
            other = junction_node[junction]
            if arrival < time[other] - SETTLED:
                time[other] = arrival
                size = lower(other, time, heap, place, size)
    return taken
