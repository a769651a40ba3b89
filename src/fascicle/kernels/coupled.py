"""Trees and myocardium in one label-correcting sweep."""

import numpy as np

from fascicle.kernels.arrays import CORNERS, FACES, SQUARES
from fascicle.kernels.jit import kernel
from fascicle.kernels.local_solver import from_face
from fascicle.kernels.queue import IN_BATCH, lower, take
from fascicle.kernels.star import PAIRS, SETTLED, fetch_star, through_stars


@kernel()
def solve_trees(time, forest):
    """Lower the times of tree nodes, in place, to their arrivals through the trees alone.

    c|∇τ·t| = 1 along each segment (the paper's equation `eikotree`): up the tree, then down.
    As in the sweep, what is earlier by rounding alone is left.
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
        state.time, state.origin = arrival, by
        if forest.site[other] >= 0:
            front.entered_by[forest.site[other]] = -1
        size = lower(vertices + other, front.nodes, front.queue, size)
    return size


@kernel(inline="always")
def _fire(site, now, sites, front, size):
    """Propagate from a site along its rays; returns the queue's size.

    The paper's coupling, τ(xⱼ) = √(D⁻¹(xⱼ − p)·(xⱼ − p)) + τ(p), for all xⱼ that rays reach, not
    only for the corners of the element around p.
    """
    nodes = front.nodes
    for k in range(sites.to_vertices.start[site], sites.to_vertices.start[site + 1]):
        vertex, arrival = sites.to_vertices.target[k], now + sites.to_vertices.time[k]
        if arrival < nodes[vertex].time - SETTLED:
            nodes[vertex].time, nodes[vertex].origin = arrival, site
            size = lower(vertex, nodes, front.queue, size)
    for k in range(sites.to_sites.start[site], sites.to_sites.start[site + 1]):
        entered = sites.to_sites.target[k]
        arrival = now + sites.to_sites.time[k] + sites.retrograde[entered]
        other = sites.node[entered]
        if arrival < nodes[other].time - SETTLED:
            nodes[other].time, nodes[other].origin = arrival, entered
            front.entered_by[entered] = site
            size = lower(other, nodes, front.queue, size)
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
            nodes[other].time, nodes[other].origin = arrival, site
            front.entered_by[site] = nodes[earliest].origin
            size = lower(other, nodes, front.queue, size)
    return size


@kernel(inline="always")
def _from_tree_node(node, vertices, forest, sites, front, size):
    """Propagate from a tree node along its segments and, if a site, its rays; returns the size."""
    now, by, node = front.nodes[node].time, front.nodes[node].origin, node - vertices
    parent, site = forest.parent[node], forest.site[node]
    if parent >= 0:
        arrival = now + forest.time[node]
        size = _to_tree_node(parent, arrival, by, vertices, forest, front, size)
    for k in range(forest.child_start[node], forest.child_start[node + 1]):
        child = forest.child[k]
        arrival = now + forest.time[child]
        size = _to_tree_node(child, arrival, by, vertices, forest, front, size)
    if site >= 0 and sites.anterograde[site] < np.inf:
        size = _fire(site, now + sites.anterograde[site], sites, front, size)
    return size


@kernel()
def sweep(front, sources, mesh, forest, sites):
    """Solve the coupled problem in place: the paper's equations `eikotree` and `eikomyo` at once.

    Nodes are numbered mesh vertices first, tree nodes after them. A node is taken when it is among
    the earliest, and again if its time is lowered later; nothing is skipped for being early, since
    with anisotropy and obtuse elements times need not settle in order.

    Linear interpolation is late where fronts are curved, most of all near a point source. So a
    site that fires, from its tree, as a stimulus or because the front comes by, offers what is
    around it the ray travel time, too. An offer depends on the times at which it starts alone, and
    does not become later when those become earlier: the result is the same in whatever order nodes
    are taken. Where fronts collide, linear interpolation between them is early, by a part of an
    edge's time.

    Parameters
    ----------
    front : Front
        Times (ms): inf but at the sources, with trees settled (`solve_trees`). Origins and sites
        that trees were entered from: -1. An empty queue. Overwritten.
    sources : (s,) array
        Nodes from which the front starts: vertices whose time is given, and the sites' nodes.
    """
    vertices, size = len(mesh.vertices), 0
    for source in sources:
        size = lower(source, front.nodes, front.queue, size)
    batch, nodes = front.around.batch, front.nodes
    while size > 0:
        count = 0
        while count < len(batch) and size > 0:
            node, size = take(nodes, front.queue), size - 1
            if node < vertices:
                batch[count], nodes[node].bucket = node, IN_BATCH
                count += 1
                fetch_star(node, mesh)
            else:
                size = _from_tree_node(node, vertices, forest, sites, front, size)
        size = through_stars(count, mesh, front, size)
        for k in range(count):
            size = _into_trees(batch[k], sites, mesh, front, size)
