"""Growth of a Purkinje tree in the unit disk that an endocardium is mapped to.

A point is its disk coordinates and the triangle that it lies in, (u, v, triangle); a direction is a
vector (a, b) of the disk; lengths are those on the endocardium (mm). Charts and seeds are those of
`fascicle.purkinje`. "The paper" is Álvarez-Barrientos et al., see the README.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from fascicle.kernels.jit import allocating_kernel, kernel

GROWN, TOO_LARGE = -1, -2  # status of a complete tree, and of one larger than any heart's

# Fields of a node lie together, as the search for the nearest node then loads one cache line, not
# five
NODE = np.dtype(
    [
        ("u", np.float64),
        ("v", np.float64),
        ("branch", np.int32),  # number of the branch it belongs to
        ("following", np.int32),  # next node in the same cell of the spatial hash, or -1
        ("parent", np.int32),  # node before it, -1 at the root
        ("triangle", np.int32),
        ("length", np.float64),  # length of the segment to its parent (mm)
    ]
)


class Rules(NamedTuple):
    """Numbers of `fascicle.purkinje.growth.GrowthRules`; `step` is the length of a segment (mm)."""

    step: float
    segments: int
    generations: int
    branch_angle: float
    clearance: float
    most_nodes: int = 200_000  # in a tree: a hundred times a heart's; more would take minutes
    most_ends: int = 20_000  # in a generation; each becomes a junction, with rays to tissue


class Tree(NamedTuple):
    """Growing tree: array of nodes with spare rows, number of nodes, and (64, 64) spatial hash.

    A cell of the hash, by which nearest nodes are found, holds the node added last, or -1; from it
    `following` leads to the other nodes of the cell.
    """

    nodes: NDArray[np.void]
    size: int
    head: NDArray[np.int32]


@register_jitable
def repulsion(tip, nearest, metric, values):
    """w∇d_CP of equation 1 of the paper, the gradient of the distance to the nearest node.

    Parameters
    ----------
    tip : (u, v, a, b)
        End of a branch in the disk, and its heading, of unit length in the metric.
    nearest : (u, v, distance)
        Nearest node that does not belong to the branch, and its distance (mm), inf without one.
    metric : (G₁₁, G₁₂, G₂₂)
        Metric at the tip (mm²): (a, b) has the length √(G₁₁a² + 2G₁₂ab + G₂₂b²) mm.
    values : (1,) array
        Values of the term's parameters: here the weight w.

    Returns
    -------
    a, b : float
        Change of the heading, which is normalised afterwards.
    """
    u, v, distance = nearest
    return values[0] * (tip[0] - u) / distance, values[0] * (tip[1] - v) / distance


@kernel(inline="always")
def _square(metric, triangle, a, b):
    """Squared length (mm²) of d = (a, b), dᵀGd, in the metric of a triangle."""
    g11, g12, g22 = metric[triangle, 0], metric[triangle, 1], metric[triangle, 2]
    return g11 * a * a + 2.0 * g12 * a * b + g22 * b * b


@kernel()
def walk(u, v, triangle, a, b, length, chart):
    """Follow a straight line in the disk for `length` mm of the endocardium, triangle by triangle.

    Its direction (a, b) may have any magnitude. Returns the end, u, v and triangle, and the length
    (mm) that remains, positive only if the line met the base.
    """
    points, _, triangles, neighbours, metric = chart
    while True:
        speed = math.sqrt(_square(metric, triangle, a, b))
        exit_edge, nearest = -1, length / speed
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
            return u, v, triangle, max(length, 1e-300)  # not 0: the walk met the base
        triangle = neighbours[triangle, exit_edge]


@allocating_kernel()
def path_lengths(parents, lengths):
    """Length (mm) of the path from the root to each node (n,); nodes may be in any order."""
    along = np.full(len(parents), np.nan)
    waiting = np.empty(len(parents), np.int64)
    for start in range(len(parents)):
        node, count = start, 0
        while node >= 0 and np.isnan(along[node]):
            waiting[count] = node
            count += 1
            node = parents[node]
        total = along[node] if node >= 0 else 0.0
        for k in range(count - 1, -1, -1):
            total += lengths[waiting[k]]
            along[waiting[k]] = total
    return along


@kernel(inline="always")
def _cell(x, head):
    """Row or column of the spatial hash for a disk coordinate."""
    return min(max(int((x + 1.0) * 0.5 * len(head)), 0), len(head) - 1)


@kernel()
def _nearest(point, kin, nearest, nodes, head, metric):
    """Nearest node to a point outside its kin; squared distance in the point's metric (mm²).

    `kin` is (start, branch, sister, unseen): the node that the branch starts from, the branch, and
    its sister, of which only nodes numbered `unseen` and above are kin. `nearest` is a node, or -1,
    and a squared distance, which are returned unless a node is nearer.
    """
    u, v, triangle = point
    start, branch, sister, unseen = kin
    best, best_square = nearest
    g11, g12, g22 = metric[triangle, 0], metric[triangle, 1], metric[triangle, 2]
    # half-widths of the box around the ellipse of that distance, at most those of the disk
    reach = best_square / (g11 * g22 - g12 * g12)
    du, dv = min(math.sqrt(reach * g22), 2.0), min(math.sqrt(reach * g11), 2.0)
    for i in range(_cell(u - du, head), _cell(u + du, head) + 1):
        for j in range(_cell(v - dv, head), _cell(v + dv, head) + 1):
            k = head[i, j]
            while k >= 0:
                node = nodes[k]
                is_kin = (
                    k == start or node.branch == branch or (node.branch == sister and k >= unseen)
                )
                square = _square(metric, triangle, u - node.u, v - node.v)
                if square < best_square and not is_kin:
                    best, best_square = k, square
                k = node.following
    return best, best_square


@allocating_kernel(inline="always")
def _append(tree, point, parent, length, branch):
    """Append a node to the tree and its spatial hash; returns the tree."""
    nodes, n, head = tree
    u, v, triangle = point
    node = nodes[n]
    node.u, node.v, node.triangle = u, v, triangle
    node.parent, node.length, node.branch = parent, length, branch
    i, j = _cell(u, head), _cell(v, head)
    node.following = head[i, j]
    head[i, j] = n
    return Tree(nodes, n + 1, head)


@allocating_kernel()
def _with_room(tree, more):
    """Tree with room for `more` nodes, in a longer array if necessary."""
    nodes, n, head = tree
    if n + more <= len(nodes):
        return tree
    longer = np.empty(2 * (n + more), NODE)
    longer[:n] = nodes[:n]
    return Tree(longer, n, head)


@allocating_kernel()
def _lay(start, heading, length, step, branch, tree, chart):
    """Append a straight path of `length` mm from node `start`, in segments of `step` mm.

    The last segment may be shorter. Returns the tree, the last node, on the base if the path meets
    it, and the length (mm) that is missing then.
    """
    tree = _with_room(tree, int(length / step) + 2)
    a, b = heading
    last, remaining = start, length
    while remaining > 0.0:
        segment = min(step, remaining)
        end = tree.nodes[last]
        u, v, triangle, missing = walk(end.u, end.v, end.triangle, a, b, segment, chart)
        tree = _append(tree, (u, v, triangle), last, segment - missing, branch)
        last = tree.size - 1
        remaining -= segment
        if missing > 0.0:
            return tree, last, remaining + missing
    return tree, last, 0.0


@kernel(inline="always")
def _turned(heading, angle):
    """Turn `heading` counter-clockwise."""
    c, s = math.cos(angle), math.sin(angle)
    return c * heading[0] - s * heading[1], s * heading[0] + c * heading[1]


@kernel()
def _nearest_to_branch(point, kin, sister_end, nodes, head, metric):
    """Node to which d_CP in equation 1 of the paper is measured, and squared distance (mm²).

    It is the nearest node but for the branch, its start, and nodes that the sister, whose end is
    `sister_end`, got in this round: otherwise the sister that grows second would be repelled by
    one node more than the first, and left and right would differ.
    """
    start, _, _, unseen = kin
    if sister_end >= unseen:
        sister_end = nodes[sister_end].parent
    # The sister's end is usually the nearest node, and bounds the search if it is not. If the
    # sister has no node yet, the parent of the start bounds it; if the start is the root, nothing
    guess = sister_end if sister_end != start else nodes[start].parent
    u, v, triangle = point
    bound = np.inf
    if guess >= 0:
        bound = _square(metric, triangle, u - nodes[guess].u, v - nodes[guess].v)
    return _nearest(point, kin, (guess, bound), nodes, head, metric)


@allocating_kernel()
def _trunk(seed, bundle_length, fascicle_lengths, fascicle_angles, step, chart):
    """Tree of the bundle and the fascicles, which are straight paths in the disk.

    Returns status and missing length (see `make_grow`), the tree, and the last node and the heading
    of each fascicle.
    """
    fascicles = len(fascicle_lengths)
    tips, heading = np.empty(fascicles, np.int64), np.empty((fascicles, 2))
    tree = Tree(np.empty(8192, NODE), 0, np.full((64, 64), -1, np.int32))
    tree = _append(tree, (seed.point[0], seed.point[1], seed.triangle), -1, 0.0, 0)
    bundle = seed.heading[0], seed.heading[1]
    tree, fork, missing = _lay(0, bundle, bundle_length, step, 0, tree, chart)
    if missing > 0.0:
        return 0, missing, tree, tips, heading
    for f in range(fascicles):
        along = _turned(bundle, fascicle_angles[f])
        tree, tips[f], missing = _lay(fork, along, fascicle_lengths[f], step, f + 1, tree, chart)
        if missing > 0.0:
            return f + 1, missing, tree, tips, heading
        heading[f] = along
    return GROWN, 0.0, tree, tips, heading


@register_jitable
def _grow_generation(term, tips, heading, label, rules, values, tree, chart):
    """Grow two branches from every tip, numbered from `label` on, all by one segment at a time.

    Returns the tree, and the tips and headings of the branches that were not stopped.
    """
    metric, step = chart.metric, rules.step
    end, toward = np.repeat(tips, 2), np.empty((2 * len(tips), 2))
    alive = np.ones(len(end), np.bool_)
    for k in range(len(end)):
        angle = rules.branch_angle if k % 2 == 0 else -rules.branch_angle
        toward[k] = _turned(heading[k // 2], angle)
    too_near = (rules.clearance * step) ** 2
    for segment in range(rules.segments):
        tree = _with_room(tree, len(end))
        nodes, head, round_start = tree.nodes, tree.head, tree.size
        for k in range(len(end)):
            if not alive[k]:
                continue
            # sisters are branches 0 and 1, 2 and 3, ...: their numbers differ in the last bit
            start, branch, sister = tips[k // 2], label + k, label + (k ^ 1)
            u, v, t = nodes[end[k]].u, nodes[end[k]].v, nodes[end[k]].triangle
            a, b = toward[k, 0], toward[k, 1]
            if segment > 0:
                kin = start, branch, sister, round_start
                best, square = _nearest_to_branch((u, v, t), kin, end[k ^ 1], nodes, head, metric)
                scale = math.sqrt(_square(metric, t, a, b))
                a, b = a / scale, b / scale
                near = 0.0, 0.0, np.inf
                if best >= 0 and square > 0.0:
                    near = nodes[best].u, nodes[best].v, math.sqrt(square)
                local_metric = metric[t, 0], metric[t, 1], metric[t, 2]
                da, db = term((u, v, a, b), near, local_metric, values)
                a, b = a + da, b + db
            u, v, t, missing = walk(u, v, t, a, b, step, chart)
            if missing > 0.0:
                alive[k] = False
                continue
            # a branch is not stopped by its sister, as both begin closer together than `clearance`
            kin = start, branch, sister, 0
            _, square = _nearest((u, v, t), kin, (-1, too_near), nodes, head, metric)
            if square < too_near:
                alive[k] = False
                continue
            tree = _append(tree, (u, v, t), end[k], step, branch)
            end[k] = tree.size - 1
            toward[k, 0], toward[k, 1] = a, b
    return tree, end[alive], toward[alive]


def make_grow(term: Callable[..., tuple[float, float]], cache: bool) -> Any:
    """Compile the growth of a tree; `term`, called as `repulsion` is, bends every segment.

    `cache` says whether the compiled code is kept on disk, where Numba would not notice that a term
    has changed. The function returned is called as ``grow(seed, bundle_length, fascicle_lengths,
    fascicle_angles, rules, values, chart)``, with (f,) arrays of the fascicles' lengths (mm) and
    angles to the bundle (rad), and the (k,) values of the term's parameters. It returns a status:
    GROWN, TOO_LARGE, or what left the endocardium (0: the bundle, k: fascicle k); the length (mm)
    of that which is missing; and the nodes, an array of NODE in which parents come before their
    children. If a path left the endocardium, the last node is where it met the base.
    """

    @njit(cache=cache, nogil=True)
    def grow(seed, bundle_length, fascicle_lengths, fascicle_angles, rules, values, chart):
        status, missing, tree, tips, heading = _trunk(
            seed, bundle_length, fascicle_lengths, fascicle_angles, rules.step, chart
        )
        label = len(tips) + 1  # number of the first branch of a generation
        for _ in range(rules.generations if status == GROWN else 0):
            count = 2 * len(tips)
            if tree.size > rules.most_nodes or count > rules.most_ends:
                status = TOO_LARGE
                break
            tree, tips, heading = _grow_generation(
                term, tips, heading, label, rules, values, tree, chart
            )
            label += count
            if len(tips) == 0:
                break
        return status, missing, tree.nodes[: tree.size]

    return grow


@allocating_kernel()
def lift(nodes, chart):
    """Positions of the nodes, an array of NODE, on the endocardium (mm), shape (n, 3)."""
    points, vertices, triangles, _, _ = chart
    positions = np.empty((len(nodes), 3))
    for n in range(len(nodes)):
        p, q, r = triangles[nodes[n].triangle]
        x, y = nodes[n].u - points[p, 0], nodes[n].v - points[p, 1]
        qx, qy = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1]
        rx, ry = points[r, 0] - points[p, 0], points[r, 1] - points[p, 1]
        area = qx * ry - qy * rx
        b, c = (x * ry - y * rx) / area, (qx * y - qy * x) / area
        a = 1.0 - b - c
        for d in range(3):
            positions[n, d] = a * vertices[p, d] + b * vertices[q, d] + c * vertices[r, d]
    return positions
