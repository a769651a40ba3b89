"""Trees and myocardium in one label-correcting sweep."""

import numpy as np
from numba import njit

from fascicle.kernels.local_solver import from_face, from_new_corner
from fascicle.kernels.queue import lower, pop
from fascicle.kernels.ray import ray_time, travel

# Smallest decrease (ms) that is worth passing on; below the rounding that matters, above noise.
SETTLED = 1e-10

# A ray is traced only if it would arrive first were it to take this share of what it would take in
# a medium that is everywhere as at its site; otherwise that guess stands for it.
NEAR = 0.8

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # than each corner: a, b, c
# SIDES[s]: where among a tetrahedron's six squared lengths stand those from corner s to a, b, c,
# and ab, ac, bc
SIDES = np.array([[0, 1, 2, 3, 4, 5], [0, 3, 4, 1, 2, 5], [1, 3, 5, 0, 2, 4], [2, 4, 5, 0, 1, 3]])


@njit(cache=True, nogil=True, inline="always")
def _earliest(a, b, c, time):
    """The earliest of three nodes."""
    if time[b] < time[a]:
        a = b
    return c if time[c] < time[a] else a


@njit(cache=True, nogil=True, inline="always")
def _through_tree(node, vertices, start, link, travel_time, site_of,
                  time, origin, entered_by, heap, place, size):  # fmt: skip
    """From a tree node along its segments; returns the queue's size."""
    now = time[vertices + node]
    for k in range(start[node], start[node + 1]):
        other, arrival = vertices + link[k], now + travel_time[k]
        if arrival < time[other] - SETTLED:
            time[other], origin[other] = arrival, origin[vertices + node]
            if site_of[link[k]] >= 0:
                entered_by[site_of[link[k]]] = -1
            size = lower(other, time, heap, place, size)
    return size


@njit(cache=True, nogil=True, inline="always")
def _offer(at, known, s, j, k, ss, jj, kk, sj, sk, jk, ts, tj, tk,
           time, origin, heap, place, size):  # fmt: skip
    """From the face s, j, k to the corner `at`, whose time so far is `known`.

    `ss`, `jj`, `kk` are the squared travel times from the face's corners to `at`, `sj`, `sk`, `jk`
    those between them (ms²). Returns the corner's time and the queue's size.
    """
    arrival = from_new_corner(
        ss, 0.5 * (ss + jj - sj), 0.5 * (ss + kk - sk), jj, 0.5 * (jj + kk - jk), kk, ts, tj, tk
    )
    if arrival < known - SETTLED:
        time[at] = known = arrival
        origin[at] = origin[_earliest(s, j, k, time)]
        size = lower(at, time, heap, place, size)
    return known, size


@njit(cache=True, nogil=True, inline="always")
def _through_elements(node, star_start, star, star_vertex, reach, height, squares,
                      time, origin, heap, place, size):  # fmt: skip
    """From a vertex through the elements around it; returns the queue's size."""
    now = time[node]
    for k in range(star_start[node], star_start[node + 1]):
        va, vb, vc = star_vertex[k, 0], star_vertex[k, 1], star_vertex[k, 2]
        ta, tb, tc = time[va], time[vb], time[vc]
        # corner a from the face of the node, b and c; then the others
        to_a = now + reach[k, 0] < ta and min(now, tb, tc) + height[k, 0] < ta
        to_b = now + reach[k, 1] < tb and min(now, ta, tc) + height[k, 1] < tb
        to_c = now + reach[k, 2] < tc and min(now, ta, tb) + height[k, 2] < tc
        if not (to_a or to_b or to_c):
            continue
        t, s = star[k] >> 2, star[k] & 3
        sa, sb, sc = squares[t, SIDES[s, 0]], squares[t, SIDES[s, 1]], squares[t, SIDES[s, 2]]
        ab, ac, bc = squares[t, SIDES[s, 3]], squares[t, SIDES[s, 4]], squares[t, SIDES[s, 5]]
        if to_a:
            ta, size = _offer(va, ta, node, vb, vc, sa, ab, ac, sb, sc, bc, now, tb, tc,
                              time, origin, heap, place, size)  # fmt: skip
        if to_b:
            tb, size = _offer(vb, tb, node, va, vc, sb, ab, bc, sa, sc, ac, now, ta, tc,
                              time, origin, heap, place, size)  # fmt: skip
        if to_c:
            tc, size = _offer(vc, tc, node, va, vb, sc, ac, bc, sa, sb, ab, now, ta, tb,
                              time, origin, heap, place, size)  # fmt: skip
    return size


@njit(cache=True, nogil=True)
def _arrival_inside(x, y, z, t, squares, points, corners, cells, time):
    """Earliest arrival (ms) at a point of tetrahedron t, from its four faces."""
    best = np.inf
    to_corner = np.empty(4)
    for c in range(4):
        v = corners[t, c]
        to_corner[c] = travel(cells, t, points[v, 0] - x, points[v, 1] - y, points[v, 2] - z) ** 2
    for skip in range(4):
        i, j, k = OTHERS[skip, 0], OTHERS[skip, 1], OTHERS[skip, 2]
        aii, ajj, akk = to_corner[i], to_corner[j], to_corner[k]
        aij = 0.5 * (aii + ajj - squares[t, SIDES[skip, 3]])
        aik = 0.5 * (aii + akk - squares[t, SIDES[skip, 4]])
        ajk = 0.5 * (ajj + akk - squares[t, SIDES[skip, 5]])
        vi, vj, vk = corners[t, i], corners[t, j], corners[t, k]
        best = min(best, from_face(aii, aij, aik, ajj, ajk, akk, time[vi], time[vj], time[vk]))
    return best


@njit(cache=True, nogil=True, inline="always")
def _into_trees(node, reader_start, reader, positions, elements, node_of, delay, squares,
                points, corners, cells, time, origin, entered_by,
                heap, place, size):  # fmt: skip
    """From a vertex to the sites in the elements around it; returns the queue's size."""
    for k in range(reader_start[node], reader_start[node + 1]):
        site = reader[k]
        other, t = node_of[site], elements[site]
        earliest = node
        for c in range(4):
            if time[corners[t, c]] < time[earliest]:
                earliest = corners[t, c]
        if time[earliest] + delay[site] >= time[other]:
            continue
        arrival = delay[site] + _arrival_inside(
            positions[site, 0], positions[site, 1], positions[site, 2], t,
            squares, points, corners, cells, time,
        )  # fmt: skip
        if arrival < time[other] - SETTLED:
            time[other], origin[other], entered_by[site] = arrival, site, origin[earliest]
            size = lower(other, time, heap, place, size)
    return size


@njit(cache=True, nogil=True, inline="always")
def _find(target, site, head, ray_site, ray_next):
    """The ray from a site to a target, or -1."""
    entry = head[target]
    while entry >= 0 and ray_site[entry] != site:
        entry = ray_next[entry]
    return entry


@njit(cache=True, nogil=True, inline="always")
def _note(target, site, way, guess, head, ray_site, ray_way, ray_next, guessed, rays):
    """Add a ray to a target's list; returns how many rays there are."""
    ray_site[rays], ray_way[rays], guessed[rays] = site, way, guess
    ray_next[rays], head[target] = head[target], rays
    return rays + 1


@njit(cache=True, nogil=True, inline="always")
def _fire(site, fired, positions, elements, points, corners, cells, time, origin,
          heap, place, size, head, ray_site, ray_way, ray_next, guessed, rays):  # fmt: skip
    """From a site to the corners of its element, along its first rays.

    Returns the sizes of the queue and of the list of rays.
    """
    t = elements[site]
    for c in range(4):
        vertex = corners[t, c]
        x = points[vertex, 0] - positions[site, 0]
        y = points[vertex, 1] - positions[site, 1]
        z = points[vertex, 2] - positions[site, 2]
        way = travel(cells, t, x, y, z)
        if _find(vertex, site, head, ray_site, ray_next) < 0:
            rays = _note(vertex, site, way, False, head, ray_site, ray_way, ray_next, guessed, rays)
        if fired[site] + way < time[vertex] - SETTLED:
            time[vertex], origin[vertex] = fired[site] + way, site
        # its new ray is to be followed even where it is not the first
        size = lower(vertex, time, heap, place, size)
    return size, rays


@njit(cache=True, nogil=True, inline="always")
def _along_rays(node, fired, link_start, link, reader_start, reader, positions, elements, node_of,
                antidromic, points, cells, across, slowness, slack,
                time, origin, entered_by, heap, place, size,
                head, ray_site, ray_way, ray_next, guessed, rays):  # fmt: skip
    """From a vertex along the rays that come through it.

    Returns the sizes of the queue and of the list of rays, and how many were traced.
    """
    vertices, traced = len(points), 0
    now = time[node]
    degree = link_start[node + 1] - link_start[node]
    targets = degree + reader_start[node + 1] - reader_start[node]
    here = head[node]
    while here >= 0:
        site, way = ray_site[here], ray_way[here]
        here = ray_next[here]
        if way < 0.0 or not (fired[site] + way - now) * way <= slack:
            continue
        spare = slack / max(way, 1e-3)
        first = fired[site] + way <= now + SETTLED
        px, py, pz = positions[site, 0], positions[site, 1], positions[site, 2]
        for k in range(targets):
            if k < degree:
                target = link[link_start[node] + k]
                other, delay = target, 0.0
                x, y, z = points[target, 0], points[target, 1], points[target, 2]
            else:
                entered = reader[reader_start[node] + k - degree]
                if entered == site:
                    continue
                target, other, delay = vertices + entered, node_of[entered], antidromic[entered]
                x, y, z = positions[entered, 0], positions[entered, 1], positions[entered, 2]
            entry = _find(target, site, head, ray_site, ray_next)
            # as fast as the medium is at the site, could it be first?
            guess = travel(cells, elements[site], x - px, y - py, z - pz)
            if fired[site] + NEAR * guess + delay >= time[other]:
                # if not, but nearly so, it is followed at that guess
                late = fired[site] + guess - time[other]
                if entry < 0 and k < degree and late * guess <= slack:
                    rays = _note(
                        target, site, guess, True, head, ray_site, ray_way, ray_next, guessed, rays
                    )
                    if place[other] < 0:  # taken before this ray came
                        size = lower(other, time, heap, place, size)
                continue
            limit = time[other] + spare - fired[site] - delay
            new = entry < 0
            if new:
                entry = rays
                rays = _note(
                    target, site, -0.0, False, head, ray_site, ray_way, ray_next, guessed, rays
                )
            if new or guessed[entry] or (ray_way[entry] < 0.0 and -ray_way[entry] < limit):
                # not tried yet, or given up when this much was not wanted
                traced += 1
                new, guessed[entry] = True, False
                ray_way[entry] = ray_time(
                    px, py, pz, elements[site], x, y, z, limit, slowness, first, cells, across
                )
            if ray_way[entry] < 0.0:
                continue
            arrival = fired[site] + ray_way[entry] + delay
            if arrival < time[other] - SETTLED:
                time[other] = arrival
                if k < degree:
                    origin[other] = site
                else:
                    origin[other], entered_by[entered] = entered, site
                size = lower(other, time, heap, place, size)
            elif (
                new
                and k < degree
                and place[other] < 0
                and (arrival - time[other]) * ray_way[entry] <= slack
            ):  # taken before this ray came, which is to be followed too
                size = lower(other, time, heap, place, size)
    return size, rays, traced


@njit(cache=True, nogil=True)
def _longer(array, capacity):
    """A copy with room for more."""
    longer = np.empty(capacity, array.dtype)
    longer[: len(array)] = array
    return longer


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
    Where fronts collide, linear interpolation between them is early, by a part of an edge's time.

    Parameters
    ----------
    time : (vertices + tree nodes,) array
        Times (ms); inf but at the sources. Overwritten.
    origin : (vertices + tree nodes,) array
        -1; overwritten by the site that fired each vertex, or by which the front entered a
        tree; -1 stays where neither is so.
    entered_by : (sites,) array
        -1; overwritten by the site whose front entered a tree at each site.
    sources : (s,) array
        Nodes whose time is given.
    mesh, forest, sites : Mesh, Forest, Sites
        See `fascicle.kernels.arrays`.

    Returns
    -------
    taken, traced : int
        Nodes taken from the queue, counting repeats, and rays traced.
    """
    points, corners, squares, cells = mesh.vertices, mesh.corners, mesh.squares, mesh.cells
    star_start, star, star_vertex = mesh.star_start, mesh.star, mesh.star_vertex
    reach, height, across = mesh.reach, mesh.height, mesh.across
    link_start, link = mesh.link_start, mesh.link
    tree_start, tree_link, tree_time = forest.start, forest.node, forest.time
    site_of = forest.site
    positions, elements, node_of = sites.positions, sites.elements, sites.node
    orthodromic, antidromic = sites.orthodromic, sites.antidromic
    reader_start, reader = sites.reader_start, sites.reader
    slowness, slack = mesh.slowness, mesh.slack
    vertices = len(points)
    fired = np.full(len(node_of), np.inf)  # when each site fires the myocardium
    heap, place, size = np.empty(len(time), np.int64), np.full(len(time), -1, np.int64), 0
    for source in sources:
        size = lower(source, time, heap, place, size)
    # the rays that were tried at each target (vertices, then sites), as linked lists: the site
    # each comes from, and the time it takes (below 0 the least that it can take, where that was
    # enough to know), or a guess of it
    capacity, rays = 8 * vertices + 64, 0
    head = np.full(vertices + len(node_of), -1, np.int64)
    ray_site, ray_way = np.empty(capacity, np.int32), np.empty(capacity)
    ray_next, guessed = np.empty(capacity, np.int64), np.empty(capacity, np.bool_)
    taken = traced = 0
    while size > 0:
        node, size = pop(time, heap, place, size)
        taken += 1
        new = 4
        if node < vertices:  # the most rays it can add: one for each ray here and target around
            new, entry = 0, head[node]
            while entry >= 0:
                new, entry = new + 1, ray_next[entry]
            targets = link_start[node + 1] - link_start[node]
            new *= targets + reader_start[node + 1] - reader_start[node]
        if rays + new > capacity:
            capacity = 2 * (rays + new)
            ray_site, ray_way = _longer(ray_site, capacity), _longer(ray_way, capacity)
            ray_next, guessed = _longer(ray_next, capacity), _longer(guessed, capacity)
        if node >= vertices:
            size = _through_tree(
                node - vertices, vertices, tree_start, tree_link, tree_time, site_of,
                time, origin, entered_by, heap, place, size,
            )  # fmt: skip
            site = site_of[node - vertices]
            if site >= 0 and elements[site] >= 0 and orthodromic[site] < np.inf:
                fired[site] = time[node] + orthodromic[site]
                size, rays = _fire(
                    site, fired, positions, elements, points, corners, cells,
                    time, origin, heap, place, size,
                    head, ray_site, ray_way, ray_next, guessed, rays,
                )  # fmt: skip
            continue
        size = _through_elements(
            node, star_start, star, star_vertex, reach, height, squares,
            time, origin, heap, place, size,
        )  # fmt: skip
        size = _into_trees(
            node, reader_start, reader, positions, elements, node_of, antidromic, squares,
            points, corners, cells, time, origin, entered_by, heap, place, size,
        )  # fmt: skip
        size, rays, more = _along_rays(
            node, fired, link_start, link, reader_start, reader, positions, elements, node_of,
            antidromic, points, cells, across, slowness, slack,
            time, origin, entered_by, heap, place, size,
            head, ray_site, ray_way, ray_next, guessed, rays,
        )  # fmt: skip
        traced += more
    return taken, traced
