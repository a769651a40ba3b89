"""Ray travel times: along straight lines from a site to the vertices and other sites around it.

From a point of a boundary triangle, the squared travel time to a vertex is a quadratic function of
where in the triangle the point lies: exactly, in a uniform medium. A table holds it at six points
of each triangle of the endocardia; in between it is interpolated. From any other site rays are
traced.
"""

import math

import numpy as np

from fascicle.kernels.arrays import CORNERS, FACES, SQUARES, Column, RayTravelTimes
from fascicle.kernels.jit import allocating_kernel, kernel

ARRIVED = 1.0 - 1e-9  # share of the path at which rounding decides what is crossed next

# The six points, as barycentric coordinates. Inside the triangle, so that rays start in its
# element: its corners and the middles of its sides, moved a little towards the centre.
POINTS = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0],
     [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]]
) * (1.0 - 3.0 * 0.002) + 0.002  # fmt: skip

# Row i: what a², b², c², ab, ac and bc of a point (a, b, c) add to the weight of each of the six
BASIS = np.linalg.inv(POINTS[:, [0, 1, 2, 0, 0, 1]] * POINTS[:, [0, 1, 2, 1, 2, 2]])


@kernel(inline="always")
def travel(cells, t, x, y, z):
    """√(dᵀD⁻¹d) for d = (x, y, z), in mm, in tetrahedron t (ms); `cells` of `EikonalMesh`."""
    return math.sqrt(
        cells[t, Column.XX] * x * x + cells[t, Column.YY] * y * y + cells[t, Column.ZZ] * z * z
        + 2.0 * (
            cells[t, Column.XY] * x * y + cells[t, Column.XZ] * x * z + cells[t, Column.YZ] * y * z
        )
    )  # fmt: skip


@kernel(inline="always")
def gradient(cells, t, corner):
    """Gradient of a corner's barycentric coordinate (1/mm); it points away from its face."""
    x, y, z = Column.GRADIENT_X, Column.GRADIENT_Y, Column.GRADIENT_Z
    return cells[t, x + corner], cells[t, y + corner], cells[t, z + corner]


@kernel(inline="always", error_model="numpy")
def _crossing(t, face, point, direction, cells):
    """Parameter s at which the line p + s·d leaves tetrahedron t through a face, or inf."""
    ax, ay, az = gradient(cells, t, face)
    rate = ax * direction[0] + ay * direction[1] + az * direction[2]
    s = -(ax * point[0] + ay * point[1] + az * point[2] + cells[t, Column.AT_ORIGIN + face]) / rate
    return s if rate < -1e-12 else np.inf  # else parallel to the face


@kernel(inline="always", error_model="numpy")
def _exit(t, point, direction, cells):
    """Parameter s at which the line leaves tetrahedron t, and the face through which.

    Without branches, as no processor could predict which face it is.
    """
    s0 = _crossing(t, 0, point, direction, cells)
    s1 = _crossing(t, 1, point, direction, cells)
    s2 = _crossing(t, 2, point, direction, cells)
    s3 = _crossing(t, 3, point, direction, cells)
    near, nearer = (1 if s1 < s0 else 0), (3 if s3 < s2 else 2)
    sa, sb = min(s0, s1), min(s2, s3)
    return min(sa, sb), (nearer if sb < sa else near)


@kernel(error_model="numpy")
def ray_time(start, t, goal, limit, cells, neighbours, slowness):
    """Time (ms) along the straight line from a point to another, or inf if it leaves the tissue.

    Where the line meets the boundary the path follows the boundary face towards the goal and takes
    the straight line again as soon as it can. Any path inside the tissue takes at least the
    geodesic's time, so the result is never early. It is inf, too, as soon as it is certain to be
    above `limit` (ms).

    `start` and `goal` are (x, y, z) in mm, `t` the tetrahedron that holds the start, and the rest
    fields of `EikonalMesh`.
    """
    x, y, z = start
    gx, gy, gz = goal
    dx, dy, dz = gx - x, gy - y, gz - z
    least = slowness * math.sqrt(dx * dx + dy * dy + dz * dz)
    total, done = 0.0, 0.0
    for _ in range(2000):  # elements, then the path is given up
        leave, face = _exit(t, (x, y, z), (dx, dy, dz), cells)
        full_time = travel(cells, t, dx, dy, dz)  # if all of the line had this element's D
        if leave >= ARRIVED:
            return total + (1.0 - done) * full_time
        leave = max(leave, done)
        total += (leave - done) * full_time
        done = leave
        if neighbours[t, face] < 0:
            x, y, z = x + done * dx, y + done * dy, z + done * dz
            return _slide((x, y, z), t, goal, total, limit, cells, neighbours, slowness)
        t = neighbours[t, face]
        if total + (1.0 - done) * least > limit:
            return np.inf
    return np.inf


@kernel(error_model="numpy")
def _slide(point, t, goal, total, limit, cells, neighbours, slowness):
    """Continue from a point of the boundary, in tetrahedron t, after `total` ms; see `ray_time`."""
    x, y, z = point
    gx, gy, gz = goal
    for _ in range(100):  # elements along the boundary
        dx, dy, dz = gx - x, gy - y, gz - z
        least = total + slowness * math.sqrt(dx * dx + dy * dy + dz * dz)
        if least > limit:
            return np.inf
        straight = True
        for _ in range(3):  # faces on the boundary, at most
            leave, face = _exit(t, (x, y, z), (dx, dy, dz), cells)
            leave = min(max(leave, 0.0), 1.0)
            if leave > 1.0 - ARRIVED or neighbours[t, face] >= 0:
                break
            # on a boundary face and heading out: slide along it
            ax, ay, az = gradient(cells, t, face)
            inwards = (ax * dx + ay * dy + az * dz) / (ax * ax + ay * ay + az * az)
            dx, dy, dz = dx - inwards * ax, dy - inwards * ay, dz - inwards * az
            straight = False
        total += leave * travel(cells, t, dx, dy, dz)
        x, y, z = x + leave * dx, y + leave * dy, z + leave * dz
        if leave == 1.0:
            if straight:
                return total
        elif neighbours[t, face] >= 0:
            t = neighbours[t, face]
        elif leave <= 1.0 - ARRIVED:
            return np.inf
    return np.inf


@kernel(inline="always")
def _row(positions, i):
    return positions[i, 0], positions[i, 1], positions[i, 2]


@kernel()
def trace_rays(points, elements, start, vertex, longest, mesh, square):
    """Squared travel times (ms²) from a few points each to the vertices around them.

    Parameters
    ----------
    points, elements : (r, k, 3) and (r,) arrays
        Where the rays start (mm), and the tetrahedron in which the points of a row lie.
    start, vertex : (r + 1,) and (p,) arrays
        The vertices that the points of a row are traced to.
    longest : float
        Rays that take longer (ms) are given up.
    square : (p, k) array
        inf; overwritten by the squared times, as far as none was given up.
    """
    medium = mesh.cells, mesh.neighbours, mesh.slowness
    for r in range(len(elements)):
        for k in range(start[r], start[r + 1]):
            goal = _row(mesh.vertices, vertex[k])
            for i in range(points.shape[1]):
                time = ray_time(_row(points[r], i), elements[r], goal, longest, *medium)
                square[k, i] = time * time if time <= longest else np.inf
                if square[k, i] == np.inf:  # a row is used only if all its times are finite
                    break


@kernel(inline="always")
def _from_table(row, coordinates, site, table, mesh, rays, used):
    """Append the vertices of a row of the table; returns how many there are now.

    `coordinates` are the site's barycentric ones in the row's triangle.
    """
    a, b, c = coordinates
    x, y, z = site
    w0, w1, w2 = _weight(0, a, b, c), _weight(1, a, b, c), _weight(2, a, b, c)
    w3, w4, w5 = _weight(3, a, b, c), _weight(4, a, b, c), _weight(5, a, b, c)
    begin, count = table.start[row], table.start[row + 1] - table.start[row]
    vertex = table.vertex[begin : begin + count]
    square = table.square[begin : begin + count].reshape(6 * count)
    target, time = rays.target[used : used + count], rays.time[used : used + count]
    for k in range(count):
        time[k] = (
            w0 * square[6 * k] + w1 * square[6 * k + 1] + w2 * square[6 * k + 2]
            + w3 * square[6 * k + 3] + w4 * square[6 * k + 4] + w5 * square[6 * k + 5]
        )  # fmt: skip
    for k in range(count):
        target[k] = vertex[k]
        # between rays that bend differently, interpolation can be faster than any fibre
        gx, gy = mesh.vertices[vertex[k], 0] - x, mesh.vertices[vertex[k], 1] - y
        gz = mesh.vertices[vertex[k], 2] - z
        least = (gx * gx + gy * gy + gz * gz) * mesh.slowness * mesh.slowness
        time[k] = max(time[k], least)
    for k in range(count):
        time[k] = math.sqrt(time[k])
    return used + count


@kernel(inline="always")
def _weight(i, a, b, c):
    """Weight of the i-th of the six points in the interpolation at the point (a, b, c)."""
    return (
        BASIS[0, i] * a * a + BASIS[1, i] * b * b + BASIS[2, i] * c * c
        + BASIS[3, i] * a * b + BASIS[4, i] * a * c + BASIS[5, i] * b * c
    )  # fmt: skip


@kernel()
def _traced(site, t, reach, longest, mesh, rays, used):
    """Append every vertex that a ray reaches; returns how many there are now."""
    medium = mesh.cells, mesh.neighbours, mesh.slowness
    x, y, z = site
    for v in range(len(mesh.vertices)):
        gx, gy, gz = _row(mesh.vertices, v)
        if (gx - x) ** 2 + (gy - y) ** 2 + (gz - z) ** 2 > reach**2:
            continue
        time = ray_time(site, t, (gx, gy, gz), longest, *medium)
        if time <= longest and time < np.inf:
            rays.target[used], rays.time[used] = v, time
            used += 1
    return used


@kernel()
def rays_to_vertices(sites, rows, opposite, mesh, table, reach, longest, rays):
    """Locate sites in their elements, and find the travel times to the vertices around them.

    Parameters
    ----------
    sites : fascicle.forward.eikonal.myocardium.LocatedPoints
        Where they have an element, their `barycentric` and `to_corner` are overwritten.
    rows, opposite : (j,) arrays
        The row of the table for each, -1 to trace instead, and the corner opposite its triangle.
    mesh, table : EikonalMesh, TravelTimeTable
        The myocardium, and the ray travel times from its endocardia.
    reach, longest : float
        How far (mm) and how long (ms) traced rays are.
    rays : RayTravelTimes
        Overwritten; arrays may have more rows than are used.
    """
    barycentric, cells = sites.barycentric, mesh.cells
    rays.start[0] = used = 0
    for s in range(len(sites.elements)):
        t, row, away = sites.elements[s], rows[s], opposite[s]
        site = _row(sites.positions, s)
        if t >= 0:
            x, y, z = site
            for k in range(CORNERS):
                gx, gy, gz = gradient(cells, t, k)
                barycentric[s, k] = gx * x + gy * y + gz * z + cells[t, Column.AT_ORIGIN + k]
                vx, vy, vz = _row(mesh.vertices, mesh.corners[t, k])
                sites.to_corner[s, k] = travel(cells, t, vx - x, vy - y, vz - z) ** 2
            if row >= 0:
                a, b = barycentric[s, FACES[away, 0]], barycentric[s, FACES[away, 1]]
                c = barycentric[s, FACES[away, 2]]
                used = _from_table(row, (a, b, c), site, table, mesh, rays, used)
            else:
                used = _traced(site, t, reach, longest, mesh, rays, used)
            for corner in range(CORNERS):
                rays.target[used] = mesh.corners[t, corner]
                rays.time[used] = math.sqrt(sites.to_corner[s, corner])
                used += 1
        rays.start[s + 1] = used


@kernel(inline="always")
def _time_inside(site, sites, mesh, time_to):
    """Travel time (ms) to a site, from those to the corners of its tetrahedron; or inf.

    Exact in a uniform medium: the interpolated squares, less the weighted squared travel times
    between the corners. Never less than the triangle inequality allows at any corner.
    """
    t, barycentric = sites.elements[site], sites.barycentric
    square, least, all_reached = 0.0, 0.0, True
    for c in range(CORNERS):
        time = time_to[mesh.corners[t, c]]
        all_reached = all_reached and time < np.inf
        square += barycentric[site, c] * time * time
        least = max(least, time - math.sqrt(sites.to_corner[site, c]))
    pair = SQUARES
    for c in range(CORNERS - 1):
        for d in range(c + 1, CORNERS):
            square -= barycentric[site, c] * barycentric[site, d] * mesh.solver[t, pair]
            pair += 1
    return max(math.sqrt(max(square, 0.0)), least) if all_reached else np.inf


@allocating_kernel()
def rays_to_sites(sites, order, first, mesh, to_vertices, time_to, rays):
    """Ray travel times from each site to the other sites around it.

    Parameters
    ----------
    order, first : (k,) arrays
        The sites that have an element, and its first corner; sorted by that.
    to_vertices : RayTravelTimes
        To the vertices around each site.
    time_to : (n,) array
        Scratch array: inf, and inf again afterwards.
    rays : RayTravelTimes
        Room for the result, which is in longer arrays where that does not suffice.
    """
    rays.start[0] = used = 0
    for s in range(len(sites.elements)):
        target = to_vertices.target[to_vertices.start[s] : to_vertices.start[s + 1]]
        time = to_vertices.time[to_vertices.start[s] : to_vertices.start[s + 1]]
        x, y, z = _row(sites.positions, s)
        lowest, highest = np.int32(len(time_to)), np.int32(-1)
        for k in range(len(target)):
            lowest, highest = min(lowest, target[k]), max(highest, target[k])
        for k in range(len(target)):
            time_to[np.uint32(target[k])] = time[k]
        for f in range(np.searchsorted(first, lowest), np.searchsorted(first, highest + 1)):
            other = order[f]
            if not time_to[first[f]] < np.inf or other == s:
                continue
            to_other = _time_inside(other, sites, mesh, time_to)
            # as in `_from_table`
            gx, gy, gz = _row(sites.positions, other)
            gx, gy, gz = gx - x, gy - y, gz - z
            to_other = max(to_other, mesh.slowness * math.sqrt(gx * gx + gy * gy + gz * gz))
            if to_other < np.inf:
                if used == len(rays.target):
                    longer, more = np.empty(2 * used, np.int32), np.empty(2 * used)
                    longer[:used], more[:used] = rays.target, rays.time
                    rays = RayTravelTimes(rays.start, longer, more)
                rays.target[used], rays.time[used] = other, to_other
                used += 1
        for k in range(len(target)):
            time_to[np.uint32(target[k])] = np.inf
        rays.start[s + 1] = used
    return rays
