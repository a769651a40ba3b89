"""Trees and myocardium in one label-correcting sweep."""

import numpy as np

from fascicle.kernels.arrays import CORNERS, FACES, SQUARES
from fascicle.kernels.jit import kernel
from fascicle.kernels.local_solver import from_face, from_new_corner
from fascicle.kernels.queue import lower, pop

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A slope of the times in an element that exceeds 1 by less is rounding.
STEEP = 1.0 + 1e-12

# PAIRS[s]: where, among the six pairs of a tetrahedron's corners, stand those of corner s with the
# others a, b, c, and the pairs ab, ac, bc
PAIRS = np.array([[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]])

# The last column of a mesh's star is CORNERS·tetrahedron + place, CORNERS being a power of 2:
PLACE_BITS = CORNERS.bit_length() - 1  # what is above these bits is the tetrahedron,
PLACE_MASK = CORNERS - 1  # what is in them the vertex's place among its corners


@kernel(inline="always")
def _earliest(a, b, c, time):
    """The earliest of three nodes."""
    if time[b] < time[a]:
        a = b
    return c if time[c] < time[a] else a


@kernel()
def settle_trees(time, forest):
    """Lower the times of tree nodes to what the trees alone make of them, in place.

    c|∇τ·t| = 1 along each segment (the paper's equation `eikotree`): up the tree, then down.
    As in the sweep, what is earlier by rounding alone is left.
    """
    nodes = len(forest.order)
    for k in range(nodes - 1, -1, -1):
        node = forest.order[k]
        parent = forest.parent[node]
        if parent >= 0:
            arrival = time[node] + forest.time[node]
            if arrival < time[parent] - SETTLED:
                time[parent] = arrival
    for k in range(nodes):
        node = forest.order[k]
        parent = forest.parent[node]
        if parent >= 0:
            arrival = time[parent] + forest.time[node]
            if arrival < time[node] - SETTLED:
                time[node] = arrival


@kernel(inline="always")
def _to_tree_node(other, arrival, by, vertices, forest, front, size):
    """Within a tree: a front that site `by` let in comes to node `other`; returns the size."""
    time = front.time
    if arrival < time[vertices + other] - SETTLED:
        time[vertices + other], front.origin[vertices + other] = arrival, by
        if forest.site[other] >= 0:
            front.entered_by[forest.site[other]] = -1
        size = lower(vertices + other, time, front.queue, size)
    return size


@kernel(inline="always")
def _through_tree(node, vertices, forest, front, size):
    """From a tree node along its segments; returns the queue's size."""
    now, by = front.time[vertices + node], front.origin[vertices + node]
    parent = forest.parent[node]
    if parent >= 0:
        arrival = now + forest.time[node]
        size = _to_tree_node(parent, arrival, by, vertices, forest, front, size)
    for k in range(forest.child_start[node], forest.child_start[node + 1]):
        child = forest.child[k]
        arrival = now + forest.time[child]
        size = _to_tree_node(child, arrival, by, vertices, forest, front, size)
    return size


@kernel(inline="always")
def _fire(site, now, sites, front, size):
    """From a site along the rays to what is around it; returns the queue's size.

    The paper's coupling, τ(xⱼ) = √(D⁻¹(xⱼ − p)·(xⱼ − p)) + τ(p), for all xⱼ that rays come to, not
    only for the corners of the element around p.
    """
    time, origin = front.time, front.origin
    for k in range(sites.to_vertices.start[site], sites.to_vertices.start[site + 1]):
        vertex, arrival = sites.to_vertices.target[k], now + sites.to_vertices.time[k]
        if arrival < time[vertex] - SETTLED:
            time[vertex], origin[vertex] = arrival, site
            size = lower(vertex, time, front.queue, size)
    for k in range(sites.to_sites.start[site], sites.to_sites.start[site + 1]):
        entered = sites.to_sites.target[k]
        arrival = now + sites.to_sites.time[k] + sites.antidromic[entered]
        other = sites.node[entered]
        if arrival < time[other] - SETTLED:
            time[other], origin[other], front.entered_by[entered] = arrival, entered, site
            size = lower(other, time, front.queue, size)
    return size


@kernel(inline="always")
def _through_edges(node, mesh, front, size):
    """From a vertex along the edges; returns the queue's size."""
    time, origin = front.time, front.origin
    now, by = time[node], origin[node]
    for k in range(mesh.link_start[node], mesh.link_start[node + 1]):
        other, arrival = mesh.link[k], now + mesh.link_time[k]
        if arrival < time[other] - SETTLED:
            time[other], origin[other] = arrival, by
            size = lower(other, time, front.queue, size)
    return size


@kernel(inline="always")
def _offer(at, known, face, delay, front, size):
    """To corner `at`, whose time is `known`, `delay` after a face's first corner.

    Returns the corner's time and the queue's size.
    """
    s, j, k = face
    time, origin = front.time, front.origin
    arrival = time[s] + delay
    if arrival < known - SETTLED:
        time[at] = known = arrival
        origin[at] = origin[_earliest(s, j, k, time)]
        size = lower(at, time, front.queue, size)
    return known, size


@kernel(inline="always")
def _through_elements(node, mesh, front, size):
    """From a vertex through the faces and elements around it; returns the queue's size.

    Comes after `_through_edges`, by which every corner has a time. Corners that still waited when
    it began lend their times to no face: when the last corner of a face is taken, it passes on what
    comes through all of it.

    In names, a, b, c are the other corners of an element and s is the vertex's own place in it:
    p.. are the products of `EikonalMesh.solver`, q.. its squared travel times, t. the times, d. the
    times less that of the vertex.
    """
    time, place, solver = front.time, front.queue.place, mesh.solver
    now = time[node]
    for e in range(mesh.star_start[node], mesh.star_start[node + 1]):
        a, b, c = mesh.star[e, 0], mesh.star[e, 1], mesh.star[e, 2]
        ta, tb, tc = time[a], time[b], time[c]
        ready_a, ready_b, ready_c = place[a] < 0, place[b] < 0, place[c] < 0
        soonest = now + mesh.least[e]
        to_a = (ready_b or ready_c) and soonest < ta
        to_b = (ready_a or ready_c) and soonest < tb
        to_c = (ready_a or ready_b) and soonest < tc
        if not (to_a or to_b or to_c):
            continue
        t, s = mesh.star[e, 3] >> PLACE_BITS, mesh.star[e, 3] & PLACE_MASK
        sa, sb, sc = PAIRS[s, 0], PAIRS[s, 1], PAIRS[s, 2]
        ab, ac, bc = PAIRS[s, 3], PAIRS[s, 4], PAIRS[s, 5]
        psa, psb, psc = solver[t, sa], solver[t, sb], solver[t, sc]
        pab, pac, pbc = solver[t, ab], solver[t, ac], solver[t, bc]
        da, db, dc = ta - now, tb - now, tc - now
        # where times rise no steeper than a front does, nothing in the element can be earlier
        if -(
            psa * da * da + psb * db * db + psc * dc * dc
            + pab * (da - db) ** 2 + pac * (da - dc) ** 2 + pbc * (db - dc) ** 2
        ) <= STEEP:  # fmt: skip
            continue
        qsa, qsb, qsc = solver[t, SQUARES + sa], solver[t, SQUARES + sb], solver[t, SQUARES + sc]
        qab, qac, qbc = solver[t, SQUARES + ab], solver[t, SQUARES + ac], solver[t, SQUARES + bc]
        if to_a:
            products, squares = (psa, pab, pac, psb, psc, pbc), (qsa, qab, qac, qsb, qsc)
            delay = from_new_corner(products, squares, db, dc, ready_b, ready_c)
            ta, size = _offer(a, ta, (node, b, c), delay, front, size)
            da = ta - now
        if to_b:
            products, squares = (psb, pab, pbc, psa, psc, pac), (qsb, qab, qbc, qsa, qsc)
            delay = from_new_corner(products, squares, da, dc, ready_a, ready_c)
            tb, size = _offer(b, tb, (node, a, c), delay, front, size)
            db = tb - now
        if to_c:
            products, squares = (psc, pac, pbc, psa, psb, pab), (qsc, qac, qbc, qsa, qsb)
            delay = from_new_corner(products, squares, da, db, ready_a, ready_b)
            tc, size = _offer(c, tc, (node, a, b), delay, front, size)
    return size


@kernel()
def _arrival_inside(site, t, sites, mesh, time):
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
        ti, tj = time[mesh.corners[t, i]], time[mesh.corners[t, j]]
        best = min(best, from_face(gram, (ti, tj, time[mesh.corners[t, k]])))
    return best


@kernel(inline="always")
def _into_trees(node, sites, mesh, front, size):
    """From a vertex to the sites in the elements around it; returns the queue's size."""
    time, origin = front.time, front.origin
    for k in range(sites.reader_start[node], sites.reader_start[node + 1]):
        site = sites.reader[k]
        other, t, delay = sites.node[site], sites.element[site], sites.antidromic[site]
        earliest = node
        for c in range(CORNERS):
            if time[mesh.corners[t, c]] < time[earliest]:
                earliest = mesh.corners[t, c]
        if time[earliest] + delay >= time[other]:
            continue
        arrival = delay + _arrival_inside(site, t, sites, mesh, time)
        if arrival < time[other] - SETTLED:
            time[other], origin[other], front.entered_by[site] = arrival, site, origin[earliest]
            size = lower(other, time, front.queue, size)
    return size


@kernel()
def sweep(front, sources, mesh, forest, sites):
    """Solve the coupled problem in place: the paper's equations `eikotree` and `eikomyo` at once.

    Nodes are numbered mesh vertices first, tree nodes after them. A node is taken when it is the
    earliest, and again if its time is lowered later; nothing is skipped for being early, since
    with anisotropy and obtuse elements times need not settle in order.

    Linear interpolation is late where fronts are curved, most of all near a point source. So a
    site that fires, be it from its tree, as a stimulus or because the front comes by, offers what
    is around it the ray travel time, too. Each offer depends on nothing but the
    times at which it starts, and none becomes later when those become earlier: the result is the
    same in whatever order nodes are taken. Where fronts collide, linear interpolation between them
    is early, by a part of an edge's time.

    Parameters
    ----------
    front : Front
        Times (ms): inf but at the sources, with trees settled (`settle_trees`). Origins, sites that
        trees were entered from and places in the queue: -1. Overwritten.
    sources : (s,) array
        Nodes from which the front starts: vertices whose time is given, and the sites' nodes.
    mesh, forest, sites : EikonalMesh, Forest, Sites
        See `fascicle.kernels.arrays`.
    """
    vertices, size = len(mesh.vertices), 0
    for source in sources:
        size = lower(source, front.time, front.queue, size)
    while size > 0:
        node, size = pop(front.time, front.queue, size)
        if node < vertices:
            size = _through_edges(node, mesh, front, size)
            size = _through_elements(node, mesh, front, size)
            size = _into_trees(node, sites, mesh, front, size)
            continue
        size = _through_tree(node - vertices, vertices, forest, front, size)
        site = forest.site[node - vertices]
        if site >= 0 and sites.orthodromic[site] < np.inf:
            size = _fire(site, front.time[node] + sites.orthodromic[site], sites, front, size)
