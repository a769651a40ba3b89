"""Travel times along straight lines through the tissue."""

import math

import numpy as np

from fascicle.kernels.arrays import (
    AT_ORIGIN,
    GRADIENT_X,
    GRADIENT_Y,
    GRADIENT_Z,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
)
from fascicle.kernels.jit import kernel

ARRIVED = 1.0 - 1e-9  # share of the path at which rounding decides what is crossed next


@kernel(inline="always")
def travel(cells, t, x, y, z):
    """√(dᵀD⁻¹d) for d = (x, y, z), in mm, in tetrahedron t (ms); `cells` of `EikonalMesh`."""
    return math.sqrt(
        cells[t, XX] * x * x + cells[t, YY] * y * y + cells[t, ZZ] * z * z
        + 2.0 * (cells[t, XY] * x * y + cells[t, XZ] * x * z + cells[t, YZ] * y * z)
    )  # fmt: skip


@kernel(inline="always")
def gradient(cells, t, corner):
    """Gradient of a corner's barycentric coordinate (1/mm); it points away from its face."""
    x, y, z = GRADIENT_X + corner, GRADIENT_Y + corner, GRADIENT_Z + corner
    return cells[t, x], cells[t, y], cells[t, z]


@kernel(inline="always", error_model="numpy")
def _crossing(t, face, point, direction, cells):
    """Parameter s at which the line p + s·d leaves tetrahedron t through a face, or inf."""
    ax, ay, az = gradient(cells, t, face)
    rate = ax * direction[0] + ay * direction[1] + az * direction[2]
    s = -(ax * point[0] + ay * point[1] + az * point[2] + cells[t, AT_ORIGIN + face]) / rate
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
        whole = travel(cells, t, dx, dy, dz)  # if all of the line had this element's D
        if leave >= ARRIVED:
            return total + (1.0 - done) * whole
        leave = max(leave, done)
        total += (leave - done) * whole
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
    """Go on from a point of the boundary, in tetrahedron t, after `total` ms; see `ray_time`."""
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
