"""Trees and myocardium in one label-correcting sweep."""

import numpy as np

from fascicle.kernels.arrays import FACES
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


@kernel(inline="always")
def _earliest(a, b, c, time):
    """The earliest of three nodes."""
    if time[b] < time[a]:
        a = b
    return c if time[c] < time[a] else a


@kernel()
def settle_trees(time, forest):
    """Lower the times of tree nodes to what the trees alone make of them, in place."""
    nodes = len(forest.order)
    for k in range(nodes - 1, -1, -1):
        node = forest.order[k]
        parent = forest.parent[node]
        if parent >= 0:
            time[parent] = min(time[parent], time[node] + forest.time[node])
    for k in range(nodes):
        node = forest.order[k]
        parent = forest.parent[node]
        if parent >= 0:
            time[node] = min(time[node], time[parent] + forest.time[node])


@kernel(inline="always")
def _to_tree_node(other, arrival, by, vertices, forest, time, origin, entered_by, queue, size):
    """Within a tree: a front that site `by` let in comes to node `other`; returns the size."""
    if arrival < time[vertices + other] - SETTLED:
        time[vertices + other], origin[vertices + other] = arrival, by
        if forest.site[other] >= 0:
            entered_by[forest.site[other]] = -1
        size = lower(vertices + other, time, queue.heap, queue.place, size)
    return size


@kernel(inline="always")
def _through_tree(node, vertices, forest, time, origin, entered_by, queue, size):
    """From a tree node along its segments; returns the queue's size."""
    now, by, parent = time[vertices + node], origin[vertices + node], forest.parent[node]
    if parent >= 0:
        size = _to_tree_node(parent, now + forest.time[node], by, vertices, forest,
                             time, origin, entered_by, queue, size)  # fmt: skip
    for k in range(forest.child_start[node], forest.child_start[node + 1]):
        child = forest.child[k]
        size = _to_tree_node(child, now + forest.time[child], by, vertices, forest,
                             time, origin, entered_by, queue, size)  # fmt: skip
    return size


@kernel(inline="always")
def _fire(site, now, sites, time, origin, entered_by, queue, size):
    """From a site straight to what is near it; returns the queue's size."""
    for k in range(sites.near.start[site], sites.near.start[site + 1]):
        vertex, arrival = sites.near.target[k], now + sites.near.time[k]
        if arrival < time[vertex] - SETTLED:
            time[vertex], origin[vertex] = arrival, site
            size = lower(vertex, time, queue.heap, queue.place, size)
    for k in range(sites.beside.start[site], sites.beside.start[site + 1]):
        entered = sites.beside.target[k]
        arrival = now + sites.beside.time[k] + sites.antidromic[entered]
        other = sites.node[entered]
        if arrival < time[other] - SETTLED:
            time[other], origin[other], entered_by[entered] = arrival, entered, site
            size = lower(other, time, queue.heap, queue.place, size)
    return size


@kernel(inline="always")
def _through_edges(node, mesh, time, origin, queue, size):
    """From a vertex along the edges; returns the queue's size."""
    now, by = time[node], origin[node]
    for k in range(mesh.link_start[node], mesh.link_start[node + 1]):
        other, arrival = mesh.link[k], now + mesh.link_time[k]
        if arrival < time[other] - SETTLED:
            time[other], origin[other] = arrival, by
            size = lower(other, time, queue.heap, queue.place, size)
    return size


@kernel(inline="always")
def _offer(at, known, s, j, k, way, time, origin, queue, size):
    """To corner `at`, whose time is `known`, `way` after s; returns its time and the size."""
    arrival = time[s] + way
    if arrival < known - SETTLED:
        time[at] = known = arrival
        origin[at] = origin[_earliest(s, j, k, time)]
        size = lower(at, time, queue.heap, queue.place, size)
    return known, size


@kernel(inline="always")
def _through_elements(node, mesh, time, origin, queue, size):
    """From a vertex through the faces and elements around it; returns the queue's size.

    Comes after `_through_edges`, by which every corner has a time. Corners that still waited when
    it began lend their times to no face: when the last corner of a face is taken, it passes on what
    comes through all of it.
    """
    now, place, solver = time[node], queue.place, mesh.solver
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
        t, s = mesh.star[e, 3] >> 2, mesh.star[e, 3] & 3
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
        qsa, qsb, qsc = solver[t, 6 + sa], solver[t, 6 + sb], solver[t, 6 + sc]
        qab, qac, qbc = solver[t, 6 + ab], solver[t, 6 + ac], solver[t, 6 + bc]
        if to_a:
            way = from_new_corner(psa, pab, pac, psb, psc, pbc, qsa, qab, qac, qsb, qsc,
                                  db, dc, ready_b, ready_c)  # fmt: skip
            ta, size = _offer(a, ta, node, b, c, way, time, origin, queue, size)
            da = ta - now
        if to_b:
            way = from_new_corner(psb, pab, pbc, psa, psc, pac, qsb, qab, qbc, qsa, qsc,
                                  da, dc, ready_a, ready_c)  # fmt: skip
            tb, size = _offer(b, tb, node, a, c, way, time, origin, queue, size)
            db = tb - now
        if to_c:
            way = from_new_corner(psc, pac, pbc, psa, psb, pab, qsc, qac, qbc, qsa, qsb,
                                  da, db, ready_a, ready_b)  # fmt: skip
            tc, size = _offer(c, tc, node, a, b, way, time, origin, queue, size)
    return size


@kernel()
def _arrival_inside(site, t, sites, mesh, time):
    """Earliest arrival (ms) at a site in tetrahedron t, from its four faces."""
    best = np.inf
    for skip in range(4):
        i, j, k = FACES[skip, 0], FACES[skip, 1], FACES[skip, 2]
        qi, qj, qk = sites.to_corner[site, i], sites.to_corner[site, j], sites.to_corner[site, k]
        best = min(best, from_face(
            qi, 0.5 * (qi + qj - mesh.solver[t, 6 + PAIRS[skip, 3]]),
            0.5 * (qi + qk - mesh.solver[t, 6 + PAIRS[skip, 4]]), qj,
            0.5 * (qj + qk - mesh.solver[t, 6 + PAIRS[skip, 5]]), qk,
            time[mesh.corners[t, i]], time[mesh.corners[t, j]], time[mesh.corners[t, k]],
        ))  # fmt: skip
    return best


@kernel(inline="always")
def _into_trees(node, sites, mesh, time, origin, entered_by, queue, size):
    """From a vertex to the sites in the elements around it; returns the queue's size."""
    for k in range(sites.reader_start[node], sites.reader_start[node + 1]):
        site = sites.reader[k]
        other, t, delay = sites.node[site], sites.element[site], sites.antidromic[site]
        earliest = node
        for c in range(4):
            if time[mesh.corners[t, c]] < time[earliest]:
                earliest = mesh.corners[t, c]
        if time[earliest] + delay >= time[other]:
            continue
        arrival = delay + _arrival_inside(site, t, sites, mesh, time)
        if arrival < time[other] - SETTLED:
            time[other], origin[other], entered_by[site] = arrival, site, origin[earliest]
            size = lower(other, time, queue.heap, queue.place, size)
    return size


@kernel()
def sweep(time, origin, entered_by, sources, mesh, forest, sites, queue):
    """Solve the coupled problem in place.

    Nodes are numbered mesh vertices first, tree nodes after them. A node is taken when it is the
    earliest, and again if its time is lowered later; nothing is skipped for being early, since
    with anisotropy and obtuse elements times need not settle in order.

    Linear interpolation is late where fronts are curved, most of all near a point source. So a
    site that fires, be it from its tree, as a stimulus or because the front comes by, offers what
    is near it the travel time along the straight way, too. Each offer depends on nothing but the
    times at which it starts, and none becomes later when those become earlier: the result is the
    same in whatever order nodes are taken. Where fronts collide, linear interpolation between them
    is early, by a part of an edge's time.

    Parameters
    ----------
    time : (vertices + tree nodes,) array
        Times (ms); inf but at the sources. Trees are settled (`settle_trees`). Overwritten.
    origin : (vertices + tree nodes,) array
        -1; overwritten by the site that fired each vertex, or by which the front entered a
        tree; -1 stays where neither is so.
    entered_by : (sites,) array
        -1; overwritten by the site whose front entered a tree at each site.
    sources : (s,) array
        Nodes from which the front starts: vertices whose time is given, and the sites' nodes.
    mesh, forest, sites, queue : Mesh, Forest, Sites, Queue
        See `fascicle.kernels.arrays`.
    """
    vertices, size = len(mesh.vertices), 0
    for source in sources:
        size = lower(source, time, queue.heap, queue.place, size)
    while size > 0:
        node, size = pop(time, queue.heap, queue.place, size)
        if node < vertices:
            size = _through_edges(node, mesh, time, origin, queue, size)
            size = _through_elements(node, mesh, time, origin, queue, size)
            size = _into_trees(node, sites, mesh, time, origin, entered_by, queue, size)
            continue
        size = _through_tree(node - vertices, vertices, forest,
                             time, origin, entered_by, queue, size)  # fmt: skip
        site = forest.site[node - vertices]
        if site >= 0 and sites.orthodromic[site] < np.inf:
            size = _fire(site, time[node] + sites.orthodromic[site], sites,
                         time, origin, entered_by, queue, size)  # fmt: skip
