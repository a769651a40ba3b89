"""Growth of a Purkinje tree in the disk: straight walks, nearest nodes, branching.

Positions are disk coordinates plus the triangle they lie in; lengths are physical (mm). All
directions are vectors of the disk; `metric` holds G₁₁, G₁₂, G₂₂ of each triangle.
"""

import math

import numpy as np
from numba import njit

GRID = 64  # cells per side of the hash that finds nearest nodes
GROWN = -1  # status: the tree is complete
FULL = -2  # status: more nodes than the arrays hold


@njit(cache=True, nogil=True, inline="always")
def _norm(metric, triangle, a, b):
    """√(dᵀGd) for d = (a, b): physical length per unit of disk."""
    return math.sqrt(
        metric[triangle, 0] * a * a
        + 2.0 * metric[triangle, 1] * a * b
        + metric[triangle, 2] * b * b
    )


@njit(cache=True, nogil=True)
def walk(u, v, triangle, a, b, length, points, triangles, neighbours, metric):
    """Walk `length` mm along the disk direction (a, b), exactly, triangle by triangle.

    Returns the new (u, v, triangle) and the length that was left over: positive only where the
    walk met the base.
    """
    while True:
        speed = _norm(metric, triangle, a, b)
        reach = length / speed
        exit_edge, nearest = -1, reach
        for k in range(3):
            p = triangles[triangle, (k + 1) % 3]
            q = triangles[triangle, (k + 2) % 3]
            ex, ey = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1]
            outwards = a * ey - b * ex  # rate at which the edge p->q is approached
            if outwards > 0.0:
                gap = (points[p, 0] - u) * ey - (points[p, 1] - v) * ex
                distance = max(gap, 0.0) / outwards
                if distance < nearest:
                    exit_edge, nearest = k, distance
        u += a * nearest
        v += b * nearest
        if exit_edge < 0:
            return u, v, triangle, 0.0
        length -= nearest * speed
        if neighbours[triangle, exit_edge] < 0:
            return u, v, triangle, max(length, 1e-300)
        triangle = neighbours[triangle, exit_edge]


@njit(cache=True, nogil=True, inline="always")
def _cell(x):
    return min(max(int((x + 1.0) * 0.5 * GRID), 0), GRID - 1)


@njit(cache=True, nogil=True)
def _nearest(u, v, triangle, start, own, sister, disk, branch, head, following, metric):
    """Nearest foreign node and its distance in the metric of `triangle` (mm).

    Nodes of the branch itself, of its sister and the node they start from are not foreign.
    """
    g11, g12, g22 = metric[triangle, 0], metric[triangle, 1], metric[triangle, 2]
    # smallest stretch: no node k cells away is nearer than this many mm
    smallest = math.sqrt((g11 + g22) / 2 - math.hypot((g11 - g22) / 2, g12)) * (2.0 / GRID)
    cu, cv = _cell(u), _cell(v)
    best, best_square = -1, np.inf
    for ring in range(GRID):
        if ring > 1 and (smallest * (ring - 1)) ** 2 > best_square:
            break
        for i in range(max(cu - ring, 0), min(cu + ring, GRID - 1) + 1):
            on_side = abs(i - cu) == ring
            step = 1 if on_side or ring == 0 else 2 * ring
            for j in range(cv - ring, cv + ring + 1, step):
                if j < 0 or j >= GRID:
                    continue
                node = head[i, j]
                while node >= 0:
                    if node != start and branch[node] != own and branch[node] != sister:
                        x, y = u - disk[node, 0], v - disk[node, 1]
                        square = g11 * x * x + 2.0 * g12 * x * y + g22 * y * y
                        if square < best_square:
                            best, best_square = node, square
                    node = following[node]
    return best, math.sqrt(best_square)


@njit(cache=True, nogil=True, inline="always")
def _add(n, u, v, t, up, mm, label, disk, triangle, parent, length, branch, head, following):
    """Write node n and enter it into the hash."""
    disk[n, 0], disk[n, 1] = u, v
    triangle[n], parent[n], length[n], branch[n] = t, up, mm, label
    i, j = _cell(u), _cell(v)
    following[n] = head[i, j]
    head[i, j] = n


@njit(cache=True, nogil=True)
def grow(
    root_u, root_v, root_triangle, direction_u, direction_v,
    bundle_length, fascicle_lengths, fascicle_angles,
    branch_length, segments, repulsion, branch_angle, generations, clearance,
    points, triangles, neighbours, metric, capacity,
):  # fmt: skip
    """Grow one tree.

    Returns
    -------
    status : int
        GROWN, FULL, or which stretch left the endocardium: 0 the bundle, k fascicle k.
    missing : float
        How much of that stretch could not be laid (mm).
    disk, triangle, parent, length : arrays
        One row a node: position, its triangle, the node before it (-1 at the root) and the
        length of the segment between them (mm).
    """
    step = branch_length / segments
    disk = np.empty((capacity, 2))
    triangle = np.empty(capacity, np.int64)
    parent = np.full(capacity, -1, np.int64)
    length = np.zeros(capacity)
    branch = np.empty(capacity, np.int64)
    head = np.full((GRID, GRID), -1, np.int64)
    following = np.empty(capacity, np.int64)
    _add(0, root_u, root_v, root_triangle, -1, 0.0, 0,
         disk, triangle, parent, length, branch, head, following)  # fmt: skip
    n = 1

    # bundle (stretch 0), then each fascicle from its end: straight in the disk
    fascicles = len(fascicle_lengths)
    ends = np.empty(fascicles + 1, np.int64)
    heading = np.empty((fascicles + 1, 2))
    for stretch in range(fascicles + 1):
        if stretch == 0:
            last, a, b, left = 0, direction_u, direction_v, bundle_length
        else:
            c, s = math.cos(fascicle_angles[stretch - 1]), math.sin(fascicle_angles[stretch - 1])
            a, b = c * heading[0, 0] - s * heading[0, 1], s * heading[0, 0] + c * heading[0, 1]
            last, left = ends[0], fascicle_lengths[stretch - 1]
        while left > 0.0:
            mm = min(step, left)
            u, v, t, missing = walk(disk[last, 0], disk[last, 1], triangle[last], a, b, mm,
                                    points, triangles, neighbours, metric)  # fmt: skip
            if missing > 0.0:
                return stretch, left - mm + missing, disk[:n], triangle[:n], parent[:n], length[:n]
            if n >= capacity:
                return FULL, 0.0, disk[:n], triangle[:n], parent[:n], length[:n]
            _add(n, u, v, t, last, mm, stretch,
                 disk, triangle, parent, length, branch, head, following)  # fmt: skip
            last = n
            n += 1
            left -= mm
        ends[stretch] = last
        heading[stretch, 0], heading[stretch, 1] = a, b

    # generations: every living end sprouts two branches, advanced a segment at a time in step
    tips, tip_heading = ends[1:].copy(), heading[1:].copy()
    next_label = fascicles + 1
    for _ in range(generations):
        count = 2 * len(tips)
        start = np.repeat(tips, 2)
        end = start.copy()
        toward = np.empty((count, 2))
        alive = np.ones(count, np.bool_)
        for k in range(count):
            angle = branch_angle if k % 2 == 0 else -branch_angle
            c, s = math.cos(angle), math.sin(angle)
            a, b = tip_heading[k // 2]
            toward[k, 0], toward[k, 1] = c * a - s * b, s * a + c * b
        for segment in range(segments):
            for k in range(count):
                if not alive[k]:
                    continue
                own, sister = next_label + k, next_label + (k ^ 1)
                u, v, t = disk[end[k], 0], disk[end[k], 1], triangle[end[k]]
                a, b = toward[k]
                if segment > 0:
                    near, distance = _nearest(u, v, t, start[k], own, sister,
                                              disk, branch, head, following, metric)  # fmt: skip
                    scale = _norm(metric, t, a, b)
                    a, b = a / scale, b / scale
                    if near >= 0 and distance > 0.0:
                        a += repulsion * (u - disk[near, 0]) / distance
                        b += repulsion * (v - disk[near, 1]) / distance
                u, v, t, missing = walk(u, v, t, a, b, step, points, triangles, neighbours, metric)
                if missing > 0.0:
                    alive[k] = False
                    continue
                _, distance = _nearest(u, v, t, start[k], own, sister,
                                       disk, branch, head, following, metric)  # fmt: skip
                if distance < clearance * step:
                    alive[k] = False
                    continue
                if n >= capacity:
                    return FULL, 0.0, disk[:n], triangle[:n], parent[:n], length[:n]
                _add(n, u, v, t, end[k], step, own,
                     disk, triangle, parent, length, branch, head, following)  # fmt: skip
                end[k] = n
                n += 1
                toward[k, 0], toward[k, 1] = a, b
        next_label += count
        tips, tip_heading = end[alive], toward[alive]
        if len(tips) == 0:
            break
    return GROWN, 0.0, disk[:n].copy(), triangle[:n].copy(), parent[:n].copy(), length[:n].copy()
