"""Travel times along straight lines through the tissue."""

import math

import numpy as np

from fascicle.kernels.jit import kernel

ACROSS = 44  # column of the first neighbour in `Mesh.across`
MAX_CROSSINGS = 2000  # elements a straight path may cross before it is given up
MAX_SLIDES = 100  # and elements it may pass once it follows the boundary
PARALLEL = 1e-12  # a coordinate that changes less along a line is taken not to reach 0
ARRIVED = 1.0 - 1e-9  # share of the way at which rounding decides what is crossed next


@kernel(inline="always")
def travel(cells, t, x, y, z):
    """√(dᵀD⁻¹d) for d = (x, y, z) in tetrahedron t (ms)."""
    return math.sqrt(
        cells[t, 16] * x * x + cells[t, 17] * y * y + cells[t, 18] * z * z
        + 2.0 * (cells[t, 19] * x * y + cells[t, 20] * x * z + cells[t, 21] * y * z)
    )  # fmt: skip


@kernel(inline="always", error_model="numpy")
def _crossing(t, k, x, y, z, dx, dy, dz, cells):
    """Where the line p + s·d leaves through face k of tetrahedron t: s, or inf."""
    ax, ay, az = cells[t, k], cells[t, 4 + k], cells[t, 8 + k]
    rate = ax * dx + ay * dy + az * dz
    s = -(ax * x + ay * y + az * z + cells[t, 12 + k]) / rate
    return s if rate < -PARALLEL else np.inf


@kernel(inline="always", error_model="numpy")
def _exit(t, x, y, z, dx, dy, dz, cells):
    """Where the line leaves tetrahedron t: s, and through which face.

    Without branches: which face it is, no processor could guess.
    """
    s0 = _crossing(t, 0, x, y, z, dx, dy, dz, cells)
    s1 = _crossing(t, 1, x, y, z, dx, dy, dz, cells)
    s2 = _crossing(t, 2, x, y, z, dx, dy, dz, cells)
    s3 = _crossing(t, 3, x, y, z, dx, dy, dz, cells)
    near, nearer = (1 if s1 < s0 else 0), (3 if s3 < s2 else 2)
    sa, sb = min(s0, s1), min(s2, s3)
    return min(sa, sb), (nearer if sb < sa else near)


@kernel(error_model="numpy")
def ray_time(x, y, z, tetrahedron, gx, gy, gz, limit, slowness, cells, across):
    """Time (ms) along the straight line from (x, y, z) to (gx, gy, gz), or inf if it leaves.

    Where the line meets the boundary the path follows the boundary face towards the goal and
    takes the straight line again as soon as it can. Any path inside the tissue takes at least
    the geodesic's time, so the result is never early. The line starts in `tetrahedron`; the
    arrays are those of `fascicle.kernels.arrays.Mesh`.

    Gives up, and returns inf, as soon as it is certain that the time is above `limit` (ms).
    """
    dx, dy, dz = gx - x, gy - y, gz - z
    least = slowness * math.sqrt(dx * dx + dy * dy + dz * dz)
    t, total, done = tetrahedron, 0.0, 0.0
    for _ in range(MAX_CROSSINGS):
        leave, face = _exit(t, x, y, z, dx, dy, dz, cells)
        way = travel(cells, t, dx, dy, dz)
        if leave >= ARRIVED:
            return total + (1.0 - done) * way
        leave = max(leave, done)
        total += (leave - done) * way
        done = leave
        if across[t, ACROSS + face] < 0:
            x, y, z = x + done * dx, y + done * dy, z + done * dz
            return _slide(x, y, z, t, gx, gy, gz, total, limit, slowness, cells, across)
        t = across[t, ACROSS + face]
        if total + (1.0 - done) * least > limit:
            return np.inf
    return np.inf


@kernel(error_model="numpy")
def _slide(x, y, z, t, gx, gy, gz, total, limit, slowness, cells, across):
    """Go on from a point of the boundary, in tetrahedron t, after `total` ms; see `ray_time`."""
    for _ in range(MAX_SLIDES):
        dx, dy, dz = gx - x, gy - y, gz - z
        least = total + slowness * math.sqrt(dx * dx + dy * dy + dz * dz)
        if least > limit:
            return np.inf
        straight = True
        for _ in range(3):  # an element has at most three boundary faces to slide along
            leave, face = _exit(t, x, y, z, dx, dy, dz, cells)
            leave = min(max(leave, 0.0), 1.0)
            if leave > 1.0 - ARRIVED or across[t, ACROSS + face] >= 0:
                break
            # on a boundary face and heading out: slide along it
            ax, ay, az = cells[t, face], cells[t, 4 + face], cells[t, 8 + face]
            inwards = (ax * dx + ay * dy + az * dz) / (ax * ax + ay * ay + az * az)
            dx, dy, dz = dx - inwards * ax, dy - inwards * ay, dz - inwards * az
            straight = False
        total += leave * travel(cells, t, dx, dy, dz)
        x, y, z = x + leave * dx, y + leave * dy, z + leave * dz
        if leave == 1.0:
            if straight:
                return total
        elif across[t, ACROSS + face] >= 0:
            t = across[t, ACROSS + face]
        elif leave <= 1.0 - ARRIVED:
            return np.inf
    return np.inf
