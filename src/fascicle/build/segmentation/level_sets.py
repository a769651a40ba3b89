"""Smooth functions whose zero levels are the surfaces of segmented bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates, spline_filter

from fascicle.build.segmentation.base_plane import BasePlane
from fascicle.build.segmentation.image import Bodies
from fascicle.core.arrays import Booleans, Floats

# Standard deviation of the smoothing, in voxels along their finest direction, and in edges of the
# grid: enough to level the staircase, which is one voxel high, and what the grid cannot resolve.
SMOOTHING = 1.5
# Room around the bodies (mm): an added wall has to fit in.
MARGIN = 6.0
PADDING = 5  # voxels, three standard deviations of the smoothing
HALF = 0.5


@dataclass(frozen=True)
class Grid:
    """A grid of cubes whose top layer lies in the base plane.

    Attributes
    ----------
    origin : (3,) array
        Position of the first node (mm).
    axes : (3, 3) array
        Rows are the unit vectors of the three directions; the third is the base plane's normal.
    shape : tuple of int
        Nodes in each direction.
    edge : float
        Distance of neighbouring nodes (mm).
    """

    origin: Floats
    axes: Floats
    shape: tuple[int, int, int]
    edge: float

    def positions(self, index: Floats) -> Floats:
        """Positions (mm) of points given in node indices, shape (n, 3)."""
        return np.asarray(self.origin + self.edge * index @ self.axes)

    def nodes_in(self, affine: Floats) -> Floats:
        """All nodes, in the indices of a voxel grid, shape (3, i, j, k)."""
        back = np.linalg.inv(affine)
        steps = self.edge * back[:3, :3] @ self.axes.T
        first = back[:3, :3] @ self.origin + back[:3, 3]
        i, j, k = (np.arange(n) for n in self.shape)
        return np.asarray(
            first[:, None, None, None]
            + steps[:, 0, None, None, None] * i[:, None, None]
            + steps[:, 1, None, None, None] * j[:, None]
            + steps[:, 2, None, None, None] * k
        )


def grid_below(plane: BasePlane, bodies: Bodies, edge: float) -> Grid:
    """Lay a grid around what lies below the base plane.

    Parameters
    ----------
    plane : BasePlane
        The top layer.
    bodies : Bodies
        What the grid must hold.
    edge : float
        Distance of neighbouring nodes (mm).
    """
    across = np.eye(3)[np.argmin(np.abs(plane.normal))]
    first = np.cross(plane.normal, across)
    first /= np.linalg.norm(first)
    axes = np.array([first, np.cross(plane.normal, first), plane.normal])
    relative = (bodies.positions(bodies.lv | bodies.rv | bodies.tissue) - plane.point) @ axes.T
    low, high = relative.min(axis=0), relative.max(axis=0)
    halves = np.array([bodies.thickness(axis) / 2 for axis in axes])
    low, high = low - halves - MARGIN, high + halves + MARGIN
    shape = np.ceil((high - low) / edge).astype(np.int64) + 1
    layers = int(np.ceil(-low[2] / edge)) + 1
    corner = np.array([low[0], low[1], -(layers - 1) * edge])
    return Grid(plane.point + corner @ axes, axes, (int(shape[0]), int(shape[1]), layers), edge)


def _continued_above(mask: Booleans, bodies: Bodies, plane: BasePlane) -> Booleans:
    """Continue a body above the base plane as it is just below, so that smoothing keeps its edge.

    There are `PADDING` more voxels on each side of the result.
    """
    half = bodies.thickness(plane.normal) / 2
    # room for the smoothing to see above the plane
    mask, back = np.pad(mask, PADDING), np.linalg.inv(bodies.affine)
    index = np.argwhere(np.ones(mask.shape, dtype=bool)) - PADDING
    height = plane.height(index @ bodies.affine[:3, :3].T + bodies.affine[:3, 3])
    above = height > 0
    down = (height[above] + half)[:, None] * (back[:3, :3] @ plane.normal)
    source = np.rint(index[above] - down).astype(np.int64) + PADDING
    inside = ((source >= 0) & (source < mask.shape)).all(axis=1)
    values = np.zeros(len(source), dtype=bool)
    values[inside] = mask[tuple(source[inside].T)]
    mask = mask.copy()
    mask.reshape(-1)[above] = values
    return mask


def level_set(mask: Booleans, bodies: Bodies, plane: BasePlane, grid: Grid) -> Floats:
    """Signed distance to the smoothed surface of a mask, at the nodes of a grid.

    The distance to the mask's voxels is interpolated between them, which between thick slices
    moves contours steadily from one to the next (Raya and Udupa, IEEE Trans Med Imaging 9:32–42,
    1990), and smoothed by 2G − G², G a Gaussian: unlike G alone, this leaves quadratic functions
    as they are, so curved surfaces do not shrink. A constant is added such that the volume below
    the plane is the mask's.

    Parameters
    ----------
    mask : (i, j, k) boolean array
        A body, on the voxel grid of `bodies`.
    bodies : Bodies
        The segmentation.
    plane : BasePlane
        The body counts below it.
    grid : Grid
        Where the function is wanted.

    Returns
    -------
    (i', j', k') array
        Distance (mm), negative inside.
    """
    mask = _continued_above(mask, bodies, plane)
    spacing = np.linalg.norm(bodies.affine[:3, :3], axis=0)
    outside = distance_transform_edt(~mask, sampling=spacing)
    inside = distance_transform_edt(mask, sampling=spacing)
    # the surface lies between two voxel centres
    distance = outside - inside + HALF * spacing.min() * np.where(mask, 1, -1)
    sigma = SMOOTHING * max(spacing.min(), grid.edge) / spacing
    once = gaussian_filter(distance, sigma, mode="nearest")
    smooth = 2 * once - gaussian_filter(once, sigma, mode="nearest")
    nodes = grid.nodes_in(bodies.affine) + PADDING
    values = map_coordinates(
        spline_filter(smooth, mode="nearest"), nodes, mode="nearest", prefilter=False
    )
    nodes_inside = _volume_below(mask, bodies, plane) / grid.edge**3
    # half of the cubes around the top layer's nodes lie below the plane: the others count twice
    below = values[:, :, :-1].ravel()
    twice = np.concatenate([below, below, values[:, :, -1].ravel()])
    wanted = round(2 * nodes_inside)
    level = np.partition(twice, wanted)[wanted]
    return np.asarray(values - level, dtype=np.float64)


def _volume_below(mask: Booleans, bodies: Bodies, plane: BasePlane) -> float:
    """Volume of a padded mask below the plane (mm³); voxels that it cuts count in part."""
    axes = bodies.affine[:3, :3]
    height = plane.height((np.argwhere(mask) - PADDING) @ axes.T + bodies.affine[:3, 3])
    share = np.clip(HALF - height / bodies.thickness(plane.normal), 0, 1)
    return float(share.sum() * abs(np.linalg.det(axes)))


def closed_by(values: Floats, radius: float, edge: float) -> Floats:
    """Morphological closing of a body given by its signed distance, with a ball.

    Parameters
    ----------
    values : array
        Signed distance at the nodes of a grid (mm).
    radius : float
        Of the ball (mm); strands of outside thinner than twice this are filled.
    edge : float
        Distance of neighbouring nodes (mm).

    Returns
    -------
    array
        Signed distance to the filled body (mm), shape of `values`.
    """
    grown = distance_transform_edt(values < radius) * edge
    # one edge less than all, so that nothing but gaps changes for what the grid cannot resolve
    return np.asarray(np.minimum(values, radius + edge - grown))
