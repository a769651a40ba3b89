"""Trees and myocardium in one label-correcting sweep."""

import numpy as np
from numba import njit

from fascicle.kernels.local_solver import from_face, from_new_corner
from fascicle.kernels.queue import lower, pop
from fascicle.kernels.ray import ray_time, travel

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A ray is traced only if it would arrive first were it to take this share of what it would take in
# a medium that is everywhere as at its site.
NEAR = 0.9

# SIDES[s]: where among a tetrahedron's six squared lengths stand those from corner s to a, b, c,
# and ab, ac, bc, where a, b, c are the other corners in ascending order
SIDES = np.array([[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]])
ABC = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # the other corners


@njit(cache=True, nogil=True, inline="always")
def _earliest(a, b, c, time):
    """The earliest of three nodes."""
    if time[b] < time[a]:
        a = b
    return c if time[c] < time[a] else a


@njit(cache=True, nogil=True, inline="always")
def _squares_to_corners(point, tetrahedron, mesh):
    """Squared travel times (ms²) from a point in a tetrahedron to its corners."""
    squares = np.empty(4)
    for c in range(4):
        corner = mesh.vertices[mesh.corners[tetrahedron, c]]
        squares[c] = travel(
            mesh.cells, tetrahedron,
            corner[0] - point[0], corner[1] - point[1], corner[2] - point[2],
        ) ** 2  # fmt: skip
    return squares


@njit(cache=True, nogil=True)
def _arrival_inside(point, tetrahedron, mesh, time):
    """Earliest arrival (ms) at a point of a tetrahedron, from its four faces."""
    best = np.inf
    row = mesh.squares[tetrahedron]
    to_corner = _squares_to_corners(point, tetrahedron, mesh)
    for skip in range(4):
        i, j, k = ABC[skip, 0], ABC[skip, 1], ABC[skip, 2]
        aii, ajj, akk = to_corner[i], to_corner[j], to_corner[k]
        aij = 0.5 * (aii + ajj - row[SIDES[skip, 3]])
        aik = 0.5 * (aii + akk - row[SIDES[skip, 4]])
        ajk = 0.5 * (ajj + akk - row[SIDES[skip, 5]])
        ti, tj, tk = (
            time[mesh.corners[tetrahedron, i]],
            time[mesh.corners[tetrahedron, j]],
            time[mesh.corners[tetrahedron, k]],
        )
        best = min(best, from_face(aii, aij, aik, ajj, ajk, akk, ti, tj, tk))
    return best


@njit(cache=True, nogil=True)
def sweep(time, origin, entered_by, sources, mesh, forest, sites):
    """Solve the coupled problem in place.

    Nodes are numbered mesh vertices first, tree nodes after them. A node is taken when it is the
    earliest, and again if its time is lowered later; nothing is skipped for being early, since
    with anisotropy and obtuse elements times need not settle in order.

    Linear interpolation is late where fronts are curved, most of all near a point source. So a
    fired site also offers its neighbourhood the travel time along straight rays, which is exact
    where the medium is uniform and late, never early, where it is not. Rays are followed from
    vertex to neighbour for as long as they are (within `Mesh.slack`) the first to arrive.

    Parameters
    ----------
    time : (vertices + tree nodes,) array
        Times (ms); inf but at the sources. Overwritten.
    origin : (vertices + tree nodes,) array
        The site that fired each vertex, or by which the front entered a tree; -1 at the sources.
        Overwritten.
    entered_by : (sites,) array
        The site whose front entered a tree there; else -1. Overwritten.
    sources : (s,) array
        Nodes whose time is given.
    mesh, forest, sites : Mesh, Forest, Sites
        See `fascicle.kernels.arrays`.

    Returns
    -------
    taken, rays : int
        Nodes taken from the queue, counting repeats, and rays traced.
    """
    points, corners, squares = mesh.vertices, mesh.corners, mesh.squares
    reach, height, cells, across = mesh.reach, mesh.height, mesh.cells, mesh.across
    star_start, star, star_vertex = mesh.star_start, mesh.star, mesh.star_vertex
    link_start, link = mesh.link_start, mesh.link
    tree_start, tree_link, tree_time = forest.start, forest.node, forest.time
    site_of = forest.site
    place_of, element_of, node_of = sites.positions, sites.elements, sites.node
    orthodromic, antidromic = sites.orthodromic, sites.antidromic
    reader_start, readers_at = sites.reader_start, sites.reader
    slowness, slack = mesh.slowness, mesh.slack
    vertices = len(points)
    heap = np.empty(len(time), np.int64)
    place = np.full(len(time), -1, np.int64)
    size = 0
    for source in sources:
        size = lower(source, time, heap, place, size)
    # the rays that were tried at each target (vertices, then sites), as linked lists
    head = np.full(vertices + len(node_of), -1, np.int64)
    capacity = 8 * vertices + 64
    ray_site = np.empty(capacity, np.int32)
    ray_way = np.empty(capacity)
    ray_next = np.empty(capacity, np.int64)
    rays = 0
    fired = np.full(len(node_of), np.inf)
    taken, traced = 0, 0
    while size > 0:
        node, size = pop(time, heap, place, size)
        taken += 1
        now = time[node]
        if node >= vertices:
            tree_node = node - vertices
            for k in range(tree_start[tree_node], tree_start[tree_node + 1]):
                other, arrival = vertices + tree_link[k], now + tree_time[k]
                if arrival < time[other] - SETTLED:
                    time[other], origin[other] = arrival, origin[node]
                    if site_of[tree_link[k]] >= 0:
                        entered_by[site_of[tree_link[k]]] = -1
                    size = lower(other, time, heap, place, size)
            site = site_of[tree_node]
            if site < 0 or element_of[site] < 0:
                continue
            fired[site] = now + orthodromic[site]
            element = element_of[site]
            for c in range(4):
                vertex = corners[element, c]
                way = travel(
                    cells, element,
                    points[vertex, 0] - place_of[site, 0],
                    points[vertex, 1] - place_of[site, 1],
                    points[vertex, 2] - place_of[site, 2],
                )  # fmt: skip
                entry = head[vertex]
                while entry >= 0 and ray_site[entry] != site:
                    entry = ray_next[entry]
                if entry < 0 and fired[site] < np.inf:
                    if rays == capacity:
                        capacity *= 2
                        ray_site = _longer(ray_site, capacity)
                        ray_way = _longer(ray_way, capacity)
                        ray_next = _longer(ray_next, capacity)
                    ray_site[rays], ray_way[rays], ray_next[rays] = site, way, head[vertex]
                    head[vertex] = rays
                    rays += 1
                if fired[site] + way < time[vertex] - SETTLED:
                    time[vertex], origin[vertex] = fired[site] + way, site
                    size = lower(vertex, time, heap, place, size)
            continue

        # through the elements around the vertex
        for k in range(star_start[node], star_start[node + 1]):
            va, vb, vc = star_vertex[k, 0], star_vertex[k, 1], star_vertex[k, 2]
            ta, tb, tc = time[va], time[vb], time[vc]
            # corner a from the face of the node, b and c; then the others
            to_a = now + reach[k, 0] < ta and min(now, tb, tc) + height[k, 0] < ta
            to_b = now + reach[k, 1] < tb and min(now, ta, tc) + height[k, 1] < tb
            to_c = now + reach[k, 2] < tc and min(now, ta, tb) + height[k, 2] < tc
            if not (to_a or to_b or to_c):
                continue
            tetrahedron, s = star[k] >> 2, star[k] & 3
            sa = squares[tetrahedron, SIDES[s, 0]]
            sb = squares[tetrahedron, SIDES[s, 1]]
            sc = squares[tetrahedron, SIDES[s, 2]]
            ab = squares[tetrahedron, SIDES[s, 3]]
            ac = squares[tetrahedron, SIDES[s, 4]]
            bc = squares[tetrahedron, SIDES[s, 5]]
            if to_a:
                arrival = from_new_corner(
                    sa, 0.5 * (sa + ab - sb), 0.5 * (sa + ac - sc),
                    ab, 0.5 * (ab + ac - bc), ac, now, tb, tc,
                )  # fmt: skip
                if arrival < ta - SETTLED:
                    time[va] = ta = arrival
                    origin[va] = origin[_earliest(node, vb, vc, time)]
                    size = lower(va, time, heap, place, size)
            if to_b:
                arrival = from_new_corner(
                    sb, 0.5 * (sb + ab - sa), 0.5 * (sb + bc - sc),
                    ab, 0.5 * (ab + bc - ac), bc, now, ta, tc,
                )  # fmt: skip
                if arrival < tb - SETTLED:
                    time[vb] = tb = arrival
                    origin[vb] = origin[_earliest(node, va, vc, time)]
                    size = lower(vb, time, heap, place, size)
            if to_c:
                arrival = from_new_corner(
                    sc, 0.5 * (sc + ac - sa), 0.5 * (sc + bc - sb),
                    ac, 0.5 * (ac + bc - ab), bc, now, ta, tb,
                )  # fmt: skip
                if arrival < tc - SETTLED:
                    time[vc] = arrival
                    origin[vc] = origin[_earliest(node, va, vb, time)]
                    size = lower(vc, time, heap, place, size)
        for k in range(reader_start[node], reader_start[node + 1]):
            site = readers_at[k]
            other = node_of[site]
            earliest = now
            for corner in range(4):
                earliest = min(earliest, time[corners[element_of[site], corner]])
            if earliest + antidromic[site] >= time[other]:
                continue
            arrival = antidromic[site] + _arrival_inside(
                sites.positions[site], element_of[site], mesh, time
            )
            if arrival < time[other] - SETTLED:
                time[other], origin[other], entered_by[site] = arrival, site, origin[node]
                size = lower(other, time, heap, place, size)

        # along rays
        here = head[node]
        while here >= 0:
            site = ray_site[here]
            way = ray_way[here]
            if way >= 0.0 and (fired[site] + way - now) * way <= slack:
                spare = slack / max(way, 1e-3)
                first = fired[site] + way <= now + SETTLED
                px, py, pz = place_of[site, 0], place_of[site, 1], place_of[site, 2]
                links = link_start[node + 1] - link_start[node]
                readers = reader_start[node + 1] - reader_start[node]
                for k in range(links + readers):
                    if k < links:
                        target = link[link_start[node] + k]
                        other, delay = target, 0.0
                        gx, gy, gz = points[target, 0], points[target, 1], points[target, 2]
                    else:
                        reader = readers_at[reader_start[node] + k - links]
                        if reader == site:
                            continue
                        target, other = vertices + reader, node_of[reader]
                        delay = antidromic[reader]
                        gx, gy, gz = place_of[reader, 0], place_of[reader, 1], place_of[reader, 2]
                    # as fast as the medium is at the site, would it be anywhere near first?
                    guess = travel(cells, element_of[site], gx - px, gy - py, gz - pz)
                    if fired[site] + NEAR * guess + delay >= time[other]:
                        continue
                    limit = time[other] + spare - fired[site] - delay
                    entry = head[target]
                    while entry >= 0 and ray_site[entry] != site:
                        entry = ray_next[entry]
                    if entry < 0:
                        if rays == capacity:
                            capacity *= 2
                            ray_site = _longer(ray_site, capacity)
                            ray_way = _longer(ray_way, capacity)
                            ray_next = _longer(ray_next, capacity)
                        entry = rays
                        ray_site[rays], ray_next[rays] = site, head[target]
                        ray_way[rays] = -0.0
                        head[target] = rays
                        rays += 1
                        untraced = True
                    else:  # given up before, and may be wanted now
                        untraced = ray_way[entry] < 0.0 and -ray_way[entry] < limit
                    if untraced:
                        traced += 1
                        ray_way[entry] = ray_time(
                            px, py, pz, element_of[site], gx, gy, gz, limit, slowness, first,
                            cells, across,
                        )  # fmt: skip
                    if ray_way[entry] < 0.0:
                        continue
                    arrival = fired[site] + ray_way[entry] + delay
                    if arrival < time[other] - SETTLED:
                        time[other], origin[other] = arrival, site
                        if k >= links:
                            origin[other], entered_by[reader] = reader, site
                        size = lower(other, time, heap, place, size)
            here = ray_next[here]
    return taken, traced


@njit(cache=True, nogil=True)
def _longer(array, capacity):
    """A copy with room for more."""
    longer = np.empty(capacity, array.dtype)
    longer[: len(array)] = array
    return longer
