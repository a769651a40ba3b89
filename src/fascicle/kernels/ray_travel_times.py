"""Straight ways from a site to the vertices and other sites around it.

From a point of a boundary triangle, the squared travel time to a vertex is a quadratic function of
where in the triangle the point lies: exactly, in a uniform medium. A table holds it at six points
of each triangle of the endocardia; in between it is interpolated. From any other site ways are
traced.
"""

import math

import numpy as np

from fascicle.kernels.arrays import FACES
from fascicle.kernels.jit import kernel
from fascicle.kernels.ray import ray_time, travel

# The six points, as barycentric coordinates. Inside the triangle, so that the ways start in its
# element: its corners and the middles of its sides, moved a little towards the centre.
INSET = 0.002
POINTS = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0],
     [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]]
) * (1.0 - 3.0 * INSET) + INSET  # fmt: skip


def _monomials(weights):
    """The products of two barycentric coordinates: a², b², c², ab, ac, bc."""
    a, b, c = weights.T
    return np.stack([a * a, b * b, c * c, a * b, a * c, b * c], axis=1)


# Row i: what monomial i of a point contributes to the weight of each of the six
BASIS = np.linalg.inv(_monomials(POINTS))


@kernel()
def trace_ways(points, elements, start, vertex, longest, mesh, square):
    """Squared travel times (ms²) from a few points each to the vertices around them.

    Parameters
    ----------
    points : (r, k, 3) array
        Where the ways start (mm).
    elements : (r,) array
        The tetrahedron in which the points of a row lie.
    start, vertex : (r + 1,) and (p,) arrays
        The vertices that the points of a row are traced to.
    longest : float
        Ways that take longer (ms) are given up.
    mesh : Mesh
        The myocardium.
    square : (p, k) array
        inf; overwritten by the squared times, as far as none was given up.
    """
    for r in range(len(elements)):
        for k in range(start[r], start[r + 1]):
            goal = mesh.vertices[vertex[k]]
            for i in range(points.shape[1]):
                way = ray_time(
                    points[r, i, 0], points[r, i, 1], points[r, i, 2], elements[r],
                    goal[0], goal[1], goal[2], longest, mesh.slowness,
                    mesh.cells, mesh.across,
                )  # fmt: skip
                square[k, i] = way * way if way <= longest else np.inf
                if square[k, i] == np.inf:  # of no use without all of them
                    break


@kernel()
def locate(positions, elements, mesh, barycentric, to_corner):
    """Barycentric coordinates of each site, and squared times (ms²) to its element's corners.

    Parameters
    ----------
    positions, elements : (j, 3) and (j,) arrays
        Where the sites lie (mm), and the tetrahedron of each; -1 where there is none.
    mesh : Mesh
        The myocardium.
    barycentric, to_corner : (j, 4) arrays
        Overwritten, but for sites without an element.
    """
    cells = mesh.cells
    for s in range(len(elements)):
        t, x, y, z = elements[s], positions[s, 0], positions[s, 1], positions[s, 2]
        for c in range(4 if t >= 0 else 0):
            barycentric[s, c] = cells[t, c] * x + cells[t, 4 + c] * y + cells[t, 8 + c] * z
            barycentric[s, c] += cells[t, 12 + c]
            v = mesh.corners[t, c]
            to_corner[s, c] = travel(
                cells, t, mesh.vertices[v, 0] - x, mesh.vertices[v, 1] - y, mesh.vertices[v, 2] - z
            ) ** 2  # fmt: skip


@kernel(inline="always")
def _from_table(row, a, b, c, x, y, z, table, mesh, ways, used):
    """Append the vertices of a row of the table; returns how many there are now.

    a, b, c are the site's barycentric coordinates in the row's triangle, x, y, z its position.
    """
    w0, w1, w2 = _weight(0, a, b, c), _weight(1, a, b, c), _weight(2, a, b, c)
    w3, w4, w5 = _weight(3, a, b, c), _weight(4, a, b, c), _weight(5, a, b, c)
    square = table.square
    for k in range(table.start[row], table.start[row + 1]):
        between = (
            w0 * square[k, 0] + w1 * square[k, 1] + w2 * square[k, 2]
            + w3 * square[k, 3] + w4 * square[k, 4] + w5 * square[k, 5]
        )  # fmt: skip
        vertex = table.vertex[k]
        # between ways that bend differently, interpolation can be faster than any fibre
        gx, gy = mesh.vertices[vertex, 0] - x, mesh.vertices[vertex, 1] - y
        gz = mesh.vertices[vertex, 2] - z
        least = (gx * gx + gy * gy + gz * gz) * mesh.slowness * mesh.slowness
        ways.target[used], ways.time[used] = vertex, math.sqrt(max(between, least))
        used += 1
    return used


@kernel(inline="always")
def _weight(i, a, b, c):
    """What point i of the six counts for the point (a, b, c)."""
    return (
        BASIS[0, i] * a * a + BASIS[1, i] * b * b + BASIS[2, i] * c * c
        + BASIS[3, i] * a * b + BASIS[4, i] * a * c + BASIS[5, i] * b * c
    )  # fmt: skip


@kernel()
def _traced(x, y, z, t, reach, longest, mesh, ways, used):
    """Append every vertex that a ray comes to; returns how many there are now."""
    for v in range(len(mesh.vertices)):
        gx, gy, gz = mesh.vertices[v, 0], mesh.vertices[v, 1], mesh.vertices[v, 2]
        if (gx - x) ** 2 + (gy - y) ** 2 + (gz - z) ** 2 > reach**2:
            continue
        time = ray_time(x, y, z, t, gx, gy, gz, longest, mesh.slowness, mesh.cells, mesh.across)
        if time <= longest and time < np.inf:
            ways.target[used], ways.time[used] = v, time
            used += 1
    return used


@kernel()
def to_vertices(
    positions, elements, rows, opposite, barycentric, to_corner, mesh, table, reach, longest, ways
):
    """The straight ways from each site to the vertices around it.

    Parameters
    ----------
    positions, elements, mesh, barycentric, to_corner
        See `locate`.
    rows, opposite : (j,) arrays
        The row of the table for each, -1 to trace instead, and the corner opposite its triangle.
    table : Table
        See `fascicle.kernels.arrays`.
    reach, longest : float
        How far (mm) and how long (ms) traced ways are.
    ways : Ways
        Overwritten, as far as there is need.
    """
    ways.start[0] = used = 0
    for s in range(len(elements)):
        t, row, away = elements[s], rows[s], opposite[s]
        x, y, z = positions[s, 0], positions[s, 1], positions[s, 2]
        if t >= 0 and row >= 0:
            a, b = barycentric[s, FACES[away, 0]], barycentric[s, FACES[away, 1]]
            c = barycentric[s, FACES[away, 2]]
            used = _from_table(row, a, b, c, x, y, z, table, mesh, ways, used)
        elif t >= 0:
            used = _traced(x, y, z, t, reach, longest, mesh, ways, used)
        for c in range(4 if t >= 0 else 0):
            ways.target[used], ways.time[used] = mesh.corners[t, c], math.sqrt(to_corner[s, c])
            used += 1
        ways.start[s + 1] = used


@kernel(inline="always")
def _way_inside(site, t, barycentric, to_corner, mesh, way_to):
    """Travel time (ms) to a site in tetrahedron t, from those to its corners; or inf.

    Exact in a uniform medium: the interpolation of the squares, less what the site is nearer to
    the corners than they to each other. Never less than by any corner.
    """
    square, least, known = 0.0, 0.0, True
    for c in range(4):
        way = way_to[mesh.corners[t, c]]
        known = known and way < np.inf
        square += barycentric[site, c] * way * way
        least = max(least, way - math.sqrt(to_corner[site, c]))
    pair = 6
    for c in range(3):
        for d in range(c + 1, 4):
            square -= barycentric[site, c] * barycentric[site, d] * mesh.solver[t, pair]
            pair += 1
    return max(math.sqrt(max(square, 0.0)), least) if known else np.inf


@kernel()
def to_sites(
    positions, elements, barycentric, to_corner, first_start, first, mesh, near, way_to, ways
):
    """The straight ways from each site to the other sites around it.

    Parameters
    ----------
    positions, elements, mesh, barycentric, to_corner
        See `locate`.
    first_start, first : (n + 1,) and (j,) arrays
        The sites whose element has each vertex as its first corner.
    near : Ways
        To the vertices around each site.
    way_to : (n,) array
        inf, and inf again afterwards.
    ways : Ways
        Overwritten, as far as there is need.
    """
    ways.start[0] = used = 0
    for s in range(len(elements)):
        begin, end = near.start[s], near.start[s + 1]
        for k in range(begin, end):
            way_to[near.target[k]] = near.time[k]
        for k in range(begin, end):
            vertex = near.target[k]
            for f in range(first_start[vertex], first_start[vertex + 1]):
                other = first[f]
                time = _way_inside(other, elements[other], barycentric, to_corner, mesh, way_to)
                # as in `_from_table`
                x, y, z = positions[other, 0], positions[other, 1], positions[other, 2]
                x, y, z = x - positions[s, 0], y - positions[s, 1], z - positions[s, 2]
                time = max(time, mesh.slowness * math.sqrt(x * x + y * y + z * z))
                if time < np.inf and other != s:
                    ways.target[used], ways.time[used] = other, time
                    used += 1
        for k in range(begin, end):
            way_to[near.target[k]] = np.inf
        ways.start[s + 1] = used
