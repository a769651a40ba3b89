"""Travel times from a junction to the vertices around it, along paths that stay in tissue."""

import math

import numpy as np
from numba import njit

MAX_CROSSINGS = 64  # elements a path may cross before it is given up


@njit(cache=True, nogil=True, inline="always")
def _travel(metric, t, x, y, z):
    """√(dᵀD⁻¹d) for d = (x, y, z) in tetrahedron t (ms)."""
    m = metric[t]
    return math.sqrt(
        m[0, 0] * x * x + m[1, 1] * y * y + m[2, 2] * z * z
        + 2.0 * (m[0, 1] * x * y + m[0, 2] * x * z + m[1, 2] * y * z)
    )  # fmt: skip


@njit(cache=True, nogil=True)
def path_time(start, tetrahedron, goal, vertices, corners, neighbours, gradients, metric):
    """Time (ms) along the straight line from `start` to `goal`, or inf if it leaves the tissue.

    Where the line meets the boundary the path follows the boundary face towards the goal and
    takes the straight line again as soon as it can. Any path inside the tissue takes at least
    the geodesic's time, so the result is never early.
    """
    x, y, z = start
    t, total = tetrahedron, 0.0
    for _ in range(MAX_CROSSINGS):
        dx, dy, dz = goal[0] - x, goal[1] - y, goal[2] - z
        sliding = False
        for _ in range(3):  # an element has at most three boundary faces to slide along
            leave, exit_face = 1.0, -1
            for k in range(4):
                g = gradients[t, k]
                rate = g[0] * dx + g[1] * dy + g[2] * dz
                if rate < -1e-12:
                    corner = vertices[corners[t, (k + 1) % 4]]
                    weight = (
                        g[0] * (x - corner[0]) + g[1] * (y - corner[1]) + g[2] * (z - corner[2])
                    )
                    s = max(weight, 0.0) / -rate
                    if s < leave:
                        leave, exit_face = s, k
            if exit_face < 0 or leave > 1e-9 or neighbours[t, exit_face] >= 0:
                break
            g = gradients[t, exit_face]  # on a boundary face and heading out: slide along it
            inwards = (g[0] * dx + g[1] * dy + g[2] * dz) / (
                g[0] * g[0] + g[1] * g[1] + g[2] * g[2]
            )
            dx, dy, dz = dx - inwards * g[0], dy - inwards * g[1], dz - inwards * g[2]
            sliding = True
        total += leave * _travel(metric, t, dx, dy, dz)
        x, y, z = x + leave * dx, y + leave * dy, z + leave * dz
        if exit_face < 0:
            if not sliding:
                return total
        elif neighbours[t, exit_face] >= 0:
            t = neighbours[t, exit_face]
        elif leave <= 1e-9:
            return np.inf
    return np.inf


@njit(cache=True, nogil=True)
def balls(
    positions, elements, radius,
    vertices, corners, neighbours, gradients, metric, vertex_start, vertex_tetrahedra,
):  # fmt: skip
    """Vertices within `radius` mm of each position, and the time to reach them.

    The corners of the position's own element always belong to its ball.

    Returns
    -------
    start, vertex, time : arrays
        ``vertex[start[i]:start[i + 1]]`` is the ball of position i, `time` in ms.
    """
    count = len(positions)
    start = np.zeros(count + 1, np.int64)
    capacity = 64 * count + 64
    vertex = np.empty(capacity, np.int64)
    time = np.empty(capacity)
    seen = np.full(len(vertices), -1, np.int64)
    n = 0
    for i in range(count):
        p, element = positions[i], elements[i]
        first = n
        for k in range(4):
            corner = corners[element, k]
            d = vertices[corner] - p
            seen[corner] = i
            vertex[n], time[n] = corner, _travel(metric, element, d[0], d[1], d[2])
            n += 1
        reached = first
        while reached < n:
            here = vertex[reached]
            reached += 1
            for k in range(vertex_start[here], vertex_start[here + 1]):
                tetrahedron = vertex_tetrahedra[k] >> 2
                for c in range(4):
                    candidate = corners[tetrahedron, c]
                    if seen[candidate] == i:
                        continue
                    seen[candidate] = i
                    d = vertices[candidate] - p
                    if d[0] * d[0] + d[1] * d[1] + d[2] * d[2] > radius * radius:
                        continue
                    arrival = path_time(
                        p, element, vertices[candidate],
                        vertices, corners, neighbours, gradients, metric,
                    )  # fmt: skip
                    if arrival == np.inf:
                        continue
                    if n == capacity:
                        capacity *= 2
                        larger_vertex, larger_time = (
                            np.empty(capacity, np.int64),
                            np.empty(capacity),
                        )
                        larger_vertex[:n], larger_time[:n] = vertex[:n], time[:n]
                        vertex, time = larger_vertex, larger_time
                    vertex[n], time[n] = candidate, arrival
                    n += 1
        start[i + 1] = n
    return start, vertex[:n].copy(), time[:n].copy()
