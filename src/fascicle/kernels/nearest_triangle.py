"""Search for nearest points of a surface, among candidate triangles."""

import math

import numpy as np

from fascicle.kernels.jit import kernel


@kernel(inline="always")
def _weights(ab, ac, ap):
    """Weights of b and c in the nearest point of the triangle a, b, c.

    C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
    """
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    bp = ap[0] - ab[0], ap[1] - ab[1], ap[2] - ab[2]
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    cp = ap[0] - ac[0], ap[1] - ac[1], ap[2] - ac[2]
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        along = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - along, along
    return vb / (va + vb + vc), vc / (va + vb + vc)


@kernel(inline="always")
def _dot(p, q):
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@kernel()
def nearest_of(points, rows, candidates, vertices, surface, positions, triangles, squares):
    """Find nearest points of a surface, given the triangles that may hold them.

    Returns False, with invalid output, if a point lies outside its row's ball.

    Parameters
    ----------
    points, rows : (n, 3) and (n,) arrays
        Points (mm), and the row of the candidates of each.
    candidates : fascicle.forward.eikonal.myocardium.Candidates
        Triangles that can be nearest to any point of a row's ball.
    vertices, surface : (v, 3) and (b, 3) arrays
        The surface (mm).
    positions, triangles, squares : (n, 3), (n,) and (n,) arrays
        Written: nearest points (mm), their triangles, and squared distances (mm²).
    """
    start, triangle, least, centre, square = candidates
    for n in range(len(points)):
        row = rows[n]
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not 0 <= row < len(square):
            return False
        off = (x - centre[row, 0]) ** 2 + (y - centre[row, 1]) ** 2 + (z - centre[row, 2]) ** 2
        if off > square[row]:
            return False
        off = math.sqrt(off)
        best = np.inf
        for k in range(start[row], start[row + 1]):
            if least[k] - off > math.sqrt(best):
                break
            t = triangle[k]
            a, b, c = surface[t, 0], surface[t, 1], surface[t, 2]
            ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
            ab = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
            ac = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
            v, w = _weights(ab, ac, (x - ax, y - ay, z - az))
            px = ax + v * ab[0] + w * ac[0]
            py = ay + v * ab[1] + w * ac[1]
            pz = az + v * ab[2] + w * ac[2]
            distance = (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2
            if distance < best:
                best = distance
                triangles[n] = t
                positions[n, 0], positions[n, 1], positions[n, 2] = px, py, pz
                if best <= 1e-20:  # mm²: it lies on the triangle, and none is nearer
                    break
        if best == np.inf:
            return False
        squares[n] = best
    return True
