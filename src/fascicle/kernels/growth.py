"""Growth of a Purkinje tree in the disk: straight walks, nearest nodes, branching.

Positions are disk coordinates plus the triangle they lie in, (u, v, triangle), directions vectors
(a, b) of the disk; lengths are physical (mm). Charts and seeds are those of `fascicle.purkinje`.
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

GROWN, TOO_LARGE = -1, -2  # status of a complete tree, and of one larger than that of any heart

# What the search for the nearest node reads of a node lies together: one cache line, not five
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


class Rules(NamedTuple):
    """Numbers of `fascicle.purkinje.growth.GrowthRules`, with `step` = l_b/N_s (mm)."""

    step: float
    segments: int
    generations: int
    branch_angle: float
    clearance: float
    most_nodes: int = 200_000  # of a tree: a hundred times those of a heart; more take minutes
    most_ends: int = 20_000  # of a generation; each end becomes a junction, with rays to the tissue


class Tree(NamedTuple):
    """A tree that grows: nodes and room for more, how many there are, and the (64, 64) hash.

    The hash finds nearest nodes: in each cell stands a node from which `following` leads to the
    others, or -1.
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
        The end of a branch in the disk, and its heading, of unit length in the metric.
    nearest : (u, v, distance)
        The nearest node that does not belong to the branch itself, and how far it is (mm); inf if
        there is none.
    metric : (G₁₁, G₁₂, G₂₂)
        In mm², where the tip is: (a, b) has the length √(G₁₁a² + 2G₁₂ab + G₂₂b²) mm.
    values : (1,) array
        Values of the term's parameters: here the weight w.

    Returns
    -------
    a, b : float
        What is added to the heading.
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
    """Walk `length` mm along a direction (a, b), of any length, exactly, triangle by triangle.

    Returns where the walk ends, u, v and triangle, and the length (mm) that was left over: positive
    only where it met the base.
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
    return min(max(int((x + 1.0) * 0.5 * len(head)), 0), len(head) - 1)


@kernel()
def _nearest(point, kin, nearest, nodes, head, metric):
    """Nearest foreign node of a point and its squared distance in its triangle's metric (mm²).

    Foreign are all but `kin`: the node that the branch starts from, the nodes of the branch itself,
    and of its sister's those numbered `unseen` and above. Only a nearer node replaces `nearest`.
    """
    u, v, triangle = point
    start, branch, sister, unseen = kin
    best, best_square = nearest
    g11, g12, g22 = metric[triangle, 0], metric[triangle, 1], metric[triangle, 2]
    # the box around the ellipse of that distance, which the disk bounds
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
    """Write the next node and enter it into the hash; returns the tree."""
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
    """The tree, in a longer array where `more` nodes would not fit."""
    nodes, n, head = tree
    if n + more <= len(nodes):
        return tree
    longer = np.empty(2 * (n + more), NODE)
    longer[:n] = nodes[:n]
    return Tree(longer, n, head)


@allocating_kernel()
def _lay(start, heading, length, step, branch, tree, chart):
    """Lay a straight stretch of `length` mm from node `start`, the last segment shorter.

    Returns the tree, the last node (on the base, if it meets that) and what was not laid (mm).
    """
    tree = _with_room(tree, int(length / step) + 2)
    a, b = heading
    last, left = start, length
    while left > 0.0:
        mm = min(step, left)
        end = tree.nodes[last]
        u, v, triangle, missing = walk(end.u, end.v, end.triangle, a, b, mm, chart)
        tree = _append(tree, (u, v, triangle), last, mm - missing, branch)
        last = tree.size - 1
        left -= mm
        if missing > 0.0:
            return tree, last, left + missing
    return tree, last, 0.0


@kernel(inline="always")
def _turned(heading, angle):
    """Turn `heading` counter-clockwise."""
    c, s = math.cos(angle), math.sin(angle)
    return c * heading[0] - s * heading[1], s * heading[0] + c * heading[1]


@kernel()
def _nearest_to_branch(point, kin, beside, nodes, head, metric):
    """The node to which d_CP in equation 1 of the paper is measured; its squared distance (mm²).

    The nearest of all but the branch, its start, and what the sister that ends in `beside` laid in
    this round: the sister that moves second must not see more of the first than the first sees of
    it, or left and right would differ.
    """
    start, _, _, unseen = kin
    if beside >= unseen:
        beside = nodes[beside].parent
    # the sister is mostly the nearest, and if not, bounds the search; where it laid nothing, the
    # parent does, and nothing when the tree starts here
    guess = beside if beside != start else nodes[start].parent
    u, v, triangle = point
    bound = np.inf
    if guess >= 0:
        bound = _square(metric, triangle, u - nodes[guess].u, v - nodes[guess].v)
    return _nearest(point, kin, (guess, bound), nodes, head, metric)


@allocating_kernel()
def _trunk(seed, bundle_length, fascicle_lengths, fascicle_angles, step, chart):
    """Lay the bundle and the fascicles.

    Returns status and missing length as `make_grow` says, the tree, and the last node and the
    heading of each fascicle.
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
    """Grow two branches from every tip, numbered from `label` on, a segment at a time in step.

    Returns the tree, and the tips and headings of the branches that lived.
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
            # sisters are 0 and 1, 2 and 3, ...: their numbers differ in the last bit
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
                here = metric[t, 0], metric[t, 1], metric[t, 2]
                da, db = term((u, v, a, b), near, here, values)
                a, b = a + da, b + db
            u, v, t, missing = walk(u, v, t, a, b, step, chart)
            if missing > 0.0:
                alive[k] = False
                continue
            # no node of the sister stops a branch: they begin nearer to each other than that
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
    """Compile growth with a term, called as `repulsion` is, in the direction of every segment.

    `cache` says whether it is kept on disk, where Numba would not see that a term has changed. The
    function returned is called as ``grow(seed, bundle_length, fascicle_lengths, fascicle_angles,
    rules, values, chart)``, with (f,) arrays of the fascicles' lengths (mm) and angles to the
    bundle (rad), and the (k,) values of the term's parameters. It gives a status: GROWN, TOO_LARGE,
    or which stretch left the endocardium, 0 the bundle, k fascicle k; how much of that could not be
    laid (mm); and the nodes, an array of NODE in which parents come before their children, the last
    being where a stretch that left the endocardium met the base.
    """

    @njit(cache=cache, nogil=True)
    def grow(seed, bundle_length, fascicle_lengths, fascicle_angles, rules, values, chart):
        status, missing, tree, tips, heading = _trunk(
            seed, bundle_length, fascicle_lengths, fascicle_angles, rules.step, chart
        )
        label = len(tips) + 1  # of the first branch of a generation
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
