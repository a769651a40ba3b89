"""Smooth functions whose zero levels are the surfaces of segmented tissue and blood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates, spline_filter

from fascicle.build.base_plane import BasePlane
from fascicle.build.segmentation import Masks
from fascicle.core.arrays import Booleans, Floats

PADDING = 5  # voxels around a mask, three standard deviations of the smoothing


@dataclass(frozen=True)
class Grid:
    """A grid of cubes (edge in mm) whose top layer lies in the base plane.

    The rows of `axes` (3, 3) are its directions, the third the base plane's normal.
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


def grid_below(plane: BasePlane, masks: Masks, edge: float) -> Grid:
    """Lay a grid with this edge (mm) around what lies below the base plane."""
    across = np.eye(3)[np.argmin(np.abs(plane.normal))]
    first = np.cross(plane.normal, across)
    first /= np.linalg.norm(first)
    axes = np.array([first, np.cross(plane.normal, first), plane.normal])
    relative = (masks.positions(masks.lv | masks.rv | masks.tissue) - plane.point) @ axes.T
    low, high = relative.min(axis=0), relative.max(axis=0)
    halves = np.array([masks.thickness(axis) / 2 for axis in axes])
    low, high = low - halves - 6.0, high + halves + 6.0  # mm; an added wall has to fit in
    shape = np.ceil((high - low) / edge).astype(np.int64) + 1
    layers = int(np.ceil(-low[2] / edge)) + 1
    corner = np.array([low[0], low[1], -(layers - 1) * edge])
    return Grid(plane.point + corner @ axes, axes, (int(shape[0]), int(shape[1]), layers), edge)


def _continued_above(mask: Booleans, masks: Masks, plane: BasePlane) -> Booleans:
    """Continue a padded mask above the base plane by what is just below, to keep its edge sharp."""
    half = masks.thickness(plane.normal) / 2
    mask, back = np.pad(mask, PADDING), np.linalg.inv(masks.affine)
    index = np.argwhere(np.ones(mask.shape, dtype=bool)) - PADDING
    height = plane.height(index @ masks.affine[:3, :3].T + masks.affine[:3, 3])
    above = height > 0
    down = (height[above] + half)[:, None] * (back[:3, :3] @ plane.normal)
    source = np.rint(index[above] - down).astype(np.int64) + PADDING
    inside = ((source >= 0) & (source < mask.shape)).all(axis=1)
    values = np.zeros(len(source), dtype=bool)
    values[inside] = mask[tuple(source[inside].T)]
    mask = mask.copy()
    mask.reshape(-1)[above] = values
    return mask


def level_set(mask: Booleans, masks: Masks, plane: BasePlane, grid: Grid) -> Floats:
    """Signed distance (mm, negative inside) to the smoothed surface of a mask, at a grid's nodes.

    The distance to the mask's voxels is interpolated between them, which between thick slices
    moves contours steadily from one to the next (Raya and Udupa, IEEE Trans Med Imaging 9:32–42,
    1990), and smoothed by 2G − G², G a Gaussian: unlike G alone, this does not change quadratic
    functions, so curved surfaces do not shrink. A constant is added such that the volume below
    the plane is the mask's.

    The mask (i, j, k) is on the voxel grid of `masks`, and counts below the plane.
    """
    mask = _continued_above(mask, masks, plane)
    spacing = np.linalg.norm(masks.affine[:3, :3], axis=0)
    outside = distance_transform_edt(~mask, sampling=spacing)
    inside = distance_transform_edt(mask, sampling=spacing)
    # the surface lies between two voxel centres
    distance = outside - inside + 0.5 * spacing.min() * np.where(mask, 1, -1)
    # enough to level the staircase, which is one voxel high, and what the grid cannot resolve
    sigma = 1.5 * max(spacing.min(), grid.edge) / spacing
    once = gaussian_filter(distance, sigma, mode="nearest")
    smooth = 2 * once - gaussian_filter(once, sigma, mode="nearest")
    nodes = grid.nodes_in(masks.affine) + PADDING
    values = map_coordinates(
        spline_filter(smooth, mode="nearest"), nodes, mode="nearest", prefilter=False
    )
    nodes_inside = _volume_below(mask, masks, plane) / grid.edge**3
    # half of the cubes around the top layer's nodes lie below the plane: the others count twice
    below = values[:, :, :-1].ravel()
    twice = np.concatenate([below, below, values[:, :, -1].ravel()])
    wanted = round(2 * nodes_inside)
    level = np.partition(twice, wanted)[wanted]
    return np.asarray(values - level, dtype=np.float64)


def _volume_below(mask: Booleans, masks: Masks, plane: BasePlane) -> float:
    """Volume of a padded mask below the plane (mm³); voxels that it cuts count in part."""
    axes = masks.affine[:3, :3]
    height = plane.height((np.argwhere(mask) - PADDING) @ axes.T + masks.affine[:3, 3])
    share = np.clip(0.5 - height / masks.thickness(plane.normal), 0, 1)
    return float(share.sum() * abs(np.linalg.det(axes)))


def closed_by(values: Floats, radius: float, edge: float) -> Floats:
    """Morphological closing, with a ball (mm), of what a signed distance (mm) on a grid describes.

    Strands of outside thinner than twice the radius are filled.
    """
    grown = distance_transform_edt(values < radius) * edge
    # one edge less than all, so that nothing but gaps changes for what the grid cannot resolve
    return np.asarray(np.minimum(values, radius + edge - grown))
