"""Growth of a Purkinje tree in the disk: straight walks, nearest nodes, branching.

Positions are disk coordinates plus the triangle they lie in; lengths are physical (mm). All
directions are vectors of the disk. A `surface` is the tuple of a chart's arrays (points, triangles,
neighbours, metric), `metric` holding G₁₁, G₁₂, G₂₂ of each triangle (mm²).
"""

import math

import numpy as np
from numba import njit

GROWN = -1  # status: the tree is complete
GRID = 64  # cells per side of the hash that finds nearest nodes
ROOM = 8192  # nodes there is room for before the array must grow

# What the search for the nearest node reads of a node lies together: one cache line, not five.
NODE = np.dtype(
    [
        ("u", np.float64),
        ("v", np.float64),
        ("branch", np.int32),  # number of the branch it belongs to
        ("following", np.int32),  # next node in the same cell of the hash, or -1
        ("parent", np.int32),  # node before it, -1 at the root
        ("triangle", np.int32),
        ("length", np.float64),  # of the segment to its parent (mm)
    ]
)


@njit(cache=True, nogil=True, inline="always")
def _norm(metric, triangle, a, b):
    """√(dᵀGd) for d = (a, b): physical length per unit of disk."""
    return math.sqrt(
        metric[triangle, 0] * a * a
        + 2.0 * metric[triangle, 1] * a * b
        + metric[triangle, 2] * b * b
    )


@njit(cache=True, nogil=True)
def walk(u, v, triangle, a, b, length, surface):
    """Walk `length` mm along the disk direction (a, b), exactly, triangle by triangle.

    Returns the new (u, v, triangle) and the length that was left over: positive only where the
    walk met the base.
    """
    points, triangles, neighbours, metric = surface
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


@njit(cache=True, nogil=True, inline="always")
def _square(u, v, node, metric, triangle):
    """Squared distance (mm²) from (u, v) to a node in the metric of a triangle."""
    x, y = u - node.u, v - node.v
    return (
        metric[triangle, 0] * x * x
        + 2.0 * metric[triangle, 1] * x * y
        + metric[triangle, 2] * y * y
    )


@njit(cache=True, nogil=True)
def _nearest(u, v, triangle, start, own, sister, best, best_square, nodes, head, metric):
    """Nearest foreign node and its squared distance in the metric of `triangle` (mm²).

    Nodes of the branch itself, of its sister and the node they start from are not foreign. Only a
    node nearer than `best_square` replaces `best`.
    """
    g11, g12, g22 = metric[triangle, 0], metric[triangle, 1], metric[triangle, 2]
    # the box around the ellipse of that distance; the disk is nowhere further away than 2
    reach = best_square / (g11 * g22 - g12 * g12)
    du, dv = min(math.sqrt(reach * g22), 2.0), min(math.sqrt(reach * g11), 2.0)
    for i in range(_cell(u - du), _cell(u + du) + 1):
        for j in range(_cell(v - dv), _cell(v + dv) + 1):
            k = head[i, j]
            while k >= 0:
                node = nodes[k]
                if k != start and node.branch != own and node.branch != sister:
                    square = _square(u, v, node, metric, triangle)
                    if square < best_square:
                        best, best_square = k, square
                k = node.following
    return best, best_square


@njit(cache=True, nogil=True)
def _nearest_of(first, last, u, v, triangle, sister, best, best_square, nodes, metric):
    """As `_nearest`, among the nodes `first` to `last` - 1, none of which is the branch's own."""
    for k in range(first, last):
        square = _square(u, v, nodes[k], metric, triangle)
        if square < best_square and nodes[k].branch != sister:
            best, best_square = k, square
    return best, best_square


@njit(cache=True, nogil=True, inline="always")
def _write(nodes, head, n, u, v, triangle, parent, length, branch):
    """Write node n and enter it into the hash."""
    node = nodes[n]
    node.u, node.v, node.triangle = u, v, triangle
    node.parent, node.length, node.branch = parent, length, branch
    i, j = _cell(u), _cell(v)
    node.following = head[i, j]
    head[i, j] = n


@njit(cache=True, nogil=True)
def _with_room(nodes, n, more):
    """The nodes, in a longer array where `more` would not fit behind the first `n`."""
    if n + more <= len(nodes):
        return nodes
    longer = np.empty(2 * (n + more), NODE)
    longer[:n] = nodes[:n]
    return longer


@njit(cache=True, nogil=True)
def _lay(start, a, b, length, step, branch, n, nodes, head, surface):
    """Lay a straight stretch of `length` mm from node `start`, the last segment shorter.

    Returns the nodes, how many there are, the last of the stretch (on the base, if it meets that)
    and what could not be laid (mm).
    """
    nodes = _with_room(nodes, n, int(length / step) + 2)
    last, left = start, length
    while left > 0.0:
        mm = min(step, left)
        end = nodes[last]
        u, v, triangle, missing = walk(end.u, end.v, end.triangle, a, b, mm, surface)
        _write(nodes, head, n, u, v, triangle, last, mm - missing, branch)
        last = n
        n += 1
        left -= mm
        if missing > 0.0:
            return nodes, n, last, left + missing
    return nodes, n, last, 0.0


@njit(cache=True, nogil=True, inline="always")
def _turned(heading, angle):
    """Give `heading` turned counter-clockwise."""
    c, s = math.cos(angle), math.sin(angle)
    return c * heading[0] - s * heading[1], s * heading[0] + c * heading[1]


@njit(cache=True, nogil=True, inline="always")
def _steered(u, v, triangle, a, b, best, square, repulsion, nodes, metric):
    """Unit vector along (a, b) plus w∇d_CP, the gradient of the distance to the nearest node.

    `square` is the square of that distance (mm²). Equation 1 of the paper, but for the
    normalisation, which `walk` does.
    """
    scale = _norm(metric, triangle, a, b)
    a, b = a / scale, b / scale
    if best >= 0 and square > 0.0:
        distance = math.sqrt(square)
        a += repulsion * (u - nodes[best].u) / distance
        b += repulsion * (v - nodes[best].v) / distance
    return a, b


@njit(cache=True, nogil=True)
def _sprout(tips, heading, step, segments, repulsion, branch_angle, clearance,
            label, n, nodes, head, surface):  # fmt: skip
    """Grow one generation: two branches from every tip, advanced a segment at a time in step.

    Returns the nodes, how many there are, and the tips and headings of the branches that lived.
    """
    metric = surface[3]
    count = 2 * len(tips)
    end = np.repeat(tips, 2)
    toward = np.empty((count, 2))
    for k in range(count):
        toward[k] = _turned(heading[k // 2], branch_angle if k % 2 == 0 else -branch_angle)
    alive = np.ones(count, np.bool_)
    near = np.full(count, -1, np.int64)  # nearest foreign node of each end
    near_square = np.full(count, np.inf)  # and its squared distance (mm²)
    seen = np.zeros(count, np.int64)  # among the nodes before this one
    too_near = (clearance * step) ** 2
    for segment in range(segments):
        nodes = _with_room(nodes, n, count)
        for k in range(count):
            if not alive[k]:
                continue
            start, own, sister = tips[k // 2], label + k, label + (k ^ 1)
            u, v, t = nodes[end[k]].u, nodes[end[k]].v, nodes[end[k]].triangle
            a, b = toward[k, 0], toward[k, 1]
            guess = nodes[start].parent  # a foreign node, and none when the tree starts here
            if segment > 0:
                # known from when this end was laid; since then only others have laid nodes
                guess, square = _nearest_of(seen[k], n, u, v, t, sister, near[k], near_square[k],
                                            nodes, metric)  # fmt: skip
                a, b = _steered(u, v, t, a, b, guess, square, repulsion, nodes, metric)
            u, v, t, missing = walk(u, v, t, a, b, step, surface)
            if missing > 0.0:
                alive[k] = False
                continue
            # what was nearest before the step bounds the search after it
            bound = _square(u, v, nodes[guess], metric, t) if guess >= 0 else np.inf
            if segment == segments - 1 and bound > too_near:
                guess, bound = -1, too_near  # no step follows: only the stop test matters
            near[k], near_square[k] = _nearest(u, v, t, start, own, sister, guess, bound,
                                               nodes, head, metric)  # fmt: skip
            if near_square[k] < too_near:
                alive[k] = False
                continue
            _write(nodes, head, n, u, v, t, end[k], step, own)
            end[k] = n
            n += 1
            seen[k] = n
            toward[k, 0], toward[k, 1] = a, b
    return nodes, n, end[alive], toward[alive]


@njit(cache=True, nogil=True)
def grow(
    root_u, root_v, root_triangle, direction_u, direction_v,
    bundle_length, fascicle_lengths, fascicle_angles,
    branch_length, segments, repulsion, branch_angle, generations, clearance,
    surface,
):  # fmt: skip
    """Grow one tree.

    Returns
    -------
    status : int
        GROWN, or which stretch left the endocardium: 0 the bundle, k fascicle k.
    missing : float
        How much of that stretch could not be laid (mm).
    nodes : array of NODE
        One row a node; parents come before their children. The last is where a stretch that left
        the endocardium met the base.
    """
    step = branch_length / segments
    nodes = np.empty(ROOM, NODE)
    head = np.full((GRID, GRID), -1, np.int32)
    _write(nodes, head, 0, root_u, root_v, root_triangle, -1, 0.0, 0)
    bundle = np.array([direction_u, direction_v])
    nodes, n, fork, missing = _lay(0, direction_u, direction_v, bundle_length, step, 0, 1,
                                   nodes, head, surface)  # fmt: skip
    if missing > 0.0:
        return 0, missing, nodes[:n]

    fascicles = len(fascicle_lengths)
    tips, heading = np.empty(fascicles, np.int64), np.empty((fascicles, 2))
    for f in range(fascicles):
        a, b = _turned(bundle, fascicle_angles[f])
        nodes, n, tips[f], missing = _lay(fork, a, b, fascicle_lengths[f], step, f + 1, n,
                                          nodes, head, surface)  # fmt: skip
        if missing > 0.0:
            return f + 1, missing, nodes[:n]
        heading[f, 0], heading[f, 1] = a, b

    label = fascicles + 1
    for _ in range(generations):
        sprouts = 2 * len(tips)
        nodes, n, tips, heading = _sprout(tips, heading, step, segments, repulsion, branch_angle,
                                          clearance, label, n, nodes, head, surface)  # fmt: skip
        label += sprouts
        if len(tips) == 0:
            break
    return GROWN, 0.0, nodes[:n]


@njit(cache=True, nogil=True)
def lift(nodes, points, vertices, triangles):
    """Positions of the nodes on the endocardium (mm), shape (n, 3)."""
    positions = np.empty((len(nodes), 3))
    for n in range(len(nodes)):
        p, q, r = triangles[nodes[n].triangle]
        x, y = nodes[n].u - points[p, 0], nodes[n].v - points[p, 1]
        qx, qy = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1]
        rx, ry = points[r, 0] - points[p, 0], points[r, 1] - points[p, 1]
        area = qx * ry - qy * rx
        second, third = (x * ry - y * rx) / area, (qx * y - qy * x) / area
        for d in range(3):
            positions[n, d] = (
                (1.0 - second - third) * vertices[p, d]
                + second * vertices[q, d]
                + third * vertices[r, d]
            )
    return positions
