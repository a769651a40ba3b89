"""Base plane of a segmented heart, and smooth level-set functions of its surfaces below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates, spline_filter

from fascicle.build.segmentation import Faces, Masks, blood_faces
from fascicle.core.arrays import Booleans, Floats, Integers
from fascicle.mesh.measures import best_plane


@dataclass(frozen=True)
class BasePlane:
    """Plane of a point (mm) and the unit vector from apex to base, and how it was found."""

    resolution: ClassVar[float] = 1.0  # mm, of the search along the axis
    # least share of its largest cross-section that a cavity has at the base
    least_open: ClassVar[float] = 0.3
    # largest share of the circumference of its blood that may be without tissue there
    most_bare: ClassVar[float] = 0.1

    point: Floats
    normal: Floats
    how: str

    def height(self, points: Floats) -> Floats:
        """Distance above the plane (mm), negative in the ventricles."""
        return np.asarray((points - self.point) @ self.normal)


def find_base_plane(masks: Masks) -> BasePlane:
    """Find the base: the flat end of the map, or the highest complete ring of tissue.

    In a stack of thick slices across the LV, it is the end of the most basal slice that opens both
    ventricles. Where the LV blood ends in a flat opening that tissue surrounds, the map was cut
    there. Otherwise the plane is perpendicular to the LV's long axis, the principal axis of its
    blood, at the level above which tissue does not surround the blood any more; where tissue closes
    over the base, at the level at which the LV begins to close.
    """
    blood = masks.positions(masks.lv)
    centre = blood.mean(axis=0)
    faces = blood_faces(masks, masks.lv, masks.rv)
    size = np.linalg.norm(faces.areas, axis=1)
    axis = np.linalg.eigh(np.cov((blood - centre).T))[1][:, 2]
    if (index := _slice_axis(masks, axis)) is not None:
        axis = masks.affine[:3, index] / np.linalg.norm(masks.affine[:3, index])
    along = (blood - centre) @ axis
    counts, width = _sections(masks, along, axis)
    largest = float(counts.max() * abs(np.linalg.det(masks.affine[:3, :3])) / width)
    # less than a quarter of the largest cross-section is a hole in the label map
    is_open = float(size[faces.free].sum()) > 0.25 * largest
    if is_open:
        towards = float((size * ((faces.centres - centre) @ axis))[faces.free].sum())
    else:
        towards = -float((along**3).sum())  # the longer tail is the apex
    axis = axis if towards > 0 else -axis
    if index is not None and (end := _end_of_slices(masks, faces, axis, index)) is not None:
        return end
    level, how = _level(masks, faces, centre, axis)
    across = BasePlane(centre + level * axis, axis, how)
    flat = _flat_opening(masks, faces, centre) if is_open else None
    if flat is None:
        return across
    ring, _ = _level(masks, faces, centre, flat.normal)
    below_ring = (blood - centre) @ flat.normal < ring
    kept = int(((flat.height(blood) < 0) & below_ring).sum())
    # a mitral valve may be flat as well, but tissue ends below it
    return flat if kept >= 0.97 * int((across.height(blood) < 0).sum()) else across


def _slice_axis(masks: Masks, long_axis: Floats) -> int | None:
    """Axis of the map across thick short-axis slices; None if slices are thin or oblique."""
    spacing = np.linalg.norm(masks.affine[:3, :3], axis=0)
    thickest = int(spacing.argmax())
    normal = masks.affine[:3, thickest] / spacing[thickest]
    is_thick = spacing[thickest] >= 2 * np.median(spacing)
    return thickest if is_thick and abs(normal @ long_axis) > 0.8 else None  # cos 37°


def _end_of_slices(masks: Masks, faces: Faces, axis: Floats, index: int) -> BasePlane | None:
    """Basal end of the most basal slice that opens both ventricles, in a ring of LV tissue."""
    back = np.linalg.inv(masks.affine)[index]
    side = np.rint(faces.voxels @ back[:3] + back[3]).astype(np.int64)
    size = np.linalg.norm(faces.areas - np.outer(faces.areas @ axis, axis), axis=1)
    count = masks.lv.shape[index]
    areas, bare_areas = (np.bincount(side, weights, count) for weights in (size, size * faces.free))
    is_open = bare_areas <= BasePlane.most_bare * areas
    for blood in (masks.lv, masks.rv):
        area = np.moveaxis(blood, index, 0).sum(axis=(1, 2))
        is_open &= area >= BasePlane.least_open * area.max()
    if not is_open.any():
        return None
    upwards = 1 if axis @ masks.affine[:3, index] > 0 else -1
    top = np.flatnonzero(is_open)[::upwards][-1] + upwards / 2
    point = masks.affine[:3, 3] + top * masks.affine[:3, index]
    return BasePlane(point, axis, "the end of the most basal slice that opens both ventricles")


def _sections(masks: Masks, along: Floats, axis: Floats) -> tuple[Integers, float]:
    """Number of blood voxels in each slice, from the lowest up, and thickness of slices (mm)."""
    width = max(masks.thickness(axis), BasePlane.resolution)
    return np.bincount(np.floor((along - along.min()) / width).astype(np.int64)), width


def _flat_opening(masks: Masks, faces: Faces, centre: Floats) -> BasePlane | None:
    """Plane with most of the opening within half a voxel, fitted to it; None if < 60 %."""
    points, areas = faces.centres[faces.free], faces.areas[faces.free]
    # the areas of a closed surface without its opening add up to that of the opening
    normal, opening = areas.sum(axis=0), float(np.linalg.norm(areas.sum(axis=0)))
    for _ in range(8):
        normal = normal / np.linalg.norm(normal)
        weight = np.abs(areas @ normal)  # the sides of gaps in the ring do not count
        height = points @ normal
        order = np.argsort(height)
        median = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
        near = np.abs(height - height[order[median]]) <= masks.thickness(normal) / 2
        middle, axes = best_plane(points[near], weight[near])
        normal = axes[2]
    if abs(float((areas[near] @ normal).sum())) < 0.6 * opening:
        return None
    normal = normal * np.sign(normal @ (middle - centre))
    return BasePlane(middle, normal, "the flat end of the label map")


def _level(masks: Masks, faces: Faces, centre: Floats, axis: Floats) -> tuple[float, str]:
    """Height of the plane above the centre of the LV blood (mm), and how it was found."""
    along = (faces.centres - centre) @ axis
    # only the sideways component of a face belongs to the ring
    sideways = np.linalg.norm(faces.areas - np.outer(faces.areas @ axis, axis), axis=1)
    step = BasePlane.resolution
    start = np.floor(along.min() / step)
    level = np.floor(along / step - start).astype(np.int64)
    lateral_area = np.bincount(level, weights=sideways)
    ring = np.bincount(level, weights=sideways * ~faces.free)
    heights = (start + np.arange(len(lateral_area)) + 0.5) * step
    used = (lateral_area > 0) & (heights > 0)
    closed = ring[used] >= (1 - BasePlane.most_bare) * lateral_area[used]
    heights = heights[used]
    if not closed.all():
        first = int(np.argmin(closed))
        below = heights[first - 1] if first else 0.0
        return float(below + heights[first]) / 2, "the highest complete ring of tissue"
    blood = (masks.positions(masks.lv) - centre) @ axis
    counts, width = _sections(masks, blood, axis)
    last = float(np.flatnonzero(counts >= 0.5 * counts.max())[-1])
    end = float(blood.min()) + (last + 0.5) * width
    return end, "the end of the LV blood, which tissue closes over"


@dataclass(frozen=True)
class Grid:
    """Grid of cubes (edge in mm) whose top layer lies in the base plane.

    The rows of `axes` (3, 3) are its directions, the third the base plane's normal.
    """

    origin: Floats
    axes: Floats
    shape: tuple[int, int, int]
    edge: ClassVar[float] = 1.0

    def positions(self, index: Floats) -> Floats:
        """Positions (mm) of points given in node indices, shape (n, 3)."""
        return np.asarray(self.origin + self.edge * index @ self.axes)

    def nodes_in(self, affine: Floats) -> Floats:
        """Voxel indices of all nodes, for a voxel grid of this affine, shape (3, i, j, k)."""
        back = np.linalg.inv(affine)
        steps = (self.edge * back[:3, :3] @ self.axes.T)[..., None, None, None]
        first = (back[:3, :3] @ self.origin + back[:3, 3])[:, None, None, None]
        i, j, k = np.ogrid[tuple(slice(n) for n in self.shape)]
        return np.asarray(first + steps[:, 0] * i + steps[:, 1] * j + steps[:, 2] * k)


def grid_below(plane: BasePlane, masks: Masks) -> Grid:
    """Lay a grid around the parts of the masks below the base plane."""
    first = np.cross(plane.normal, np.eye(3)[np.argmin(np.abs(plane.normal))])
    first /= np.linalg.norm(first)
    axes = np.array([first, np.cross(plane.normal, first), plane.normal])
    relative = (masks.positions(masks.lv | masks.rv | masks.tissue) - plane.point) @ axes.T
    halves = np.array([masks.thickness(axis) / 2 for axis in axes])
    # mm; leaves room for an added wall
    low, high = relative.min(axis=0) - halves - 6.0, relative.max(axis=0) + halves + 6.0
    shape = np.ceil((high - low) / Grid.edge).astype(np.int64) + 1
    layers = int(np.ceil(-low[2] / Grid.edge)) + 1
    corner = np.array([low[0], low[1], -(layers - 1) * Grid.edge])
    return Grid(plane.point + corner @ axes, axes, (int(shape[0]), int(shape[1]), layers))


def _continued_above(mask: Booleans, masks: Masks, plane: BasePlane, padding: int) -> Booleans:
    """Extend a padded mask above the base plane by its values just below: its edge stays sharp."""
    half = masks.thickness(plane.normal) / 2
    mask, back = np.pad(mask, padding), np.linalg.inv(masks.affine)
    index = np.indices(mask.shape).reshape(3, -1).T - padding
    height = plane.height(index @ masks.affine[:3, :3].T + masks.affine[:3, 3])
    above = height > 0
    down = (height[above] + half)[:, None] * (back[:3, :3] @ plane.normal)
    source = np.rint(index[above] - down).astype(np.int64) + padding
    inside = ((source >= 0) & (source < mask.shape)).all(axis=1)
    values = np.zeros(len(source), dtype=bool)
    values[inside] = mask[tuple(source[inside].T)]
    mask.reshape(-1)[above] = values
    return mask


def level_set(mask: Booleans, masks: Masks, plane: BasePlane, grid: Grid) -> Floats:
    """Signed distance (mm, negative inside) to the smoothed surface of a mask, at a grid's nodes.

    The distance to the mask's voxels is interpolated between them, which between thick slices
    moves contours steadily from one to the next (Raya and Udupa, IEEE Trans Med Imaging 9:32–42,
    1990), and smoothed by 2G − G², G a Gaussian: unlike G alone, this does not change quadratic
    functions, so curved surfaces do not shrink. A constant is added such that the volume below
    the plane is the mask's.

    The mask (i, j, k) is on the voxel grid of `masks`; only its part below the plane counts.
    """
    padding = 5  # voxels, three standard deviations of the smoothing
    mask = _continued_above(mask, masks, plane, padding)
    spacing = np.linalg.norm(masks.affine[:3, :3], axis=0)
    outside = distance_transform_edt(~mask, sampling=spacing)
    inside = distance_transform_edt(mask, sampling=spacing)
    # the surface lies between two voxel centres
    distance = outside - inside + 0.5 * spacing.min() * np.where(mask, 1, -1)
    # smooths the staircase, which is one voxel high, and what the grid cannot resolve
    sigma = 1.5 * max(spacing.min(), grid.edge) / spacing
    once = gaussian_filter(distance, sigma, mode="nearest")
    smooth = 2 * once - gaussian_filter(once, sigma, mode="nearest")
    nodes = grid.nodes_in(masks.affine) + padding
    values = map_coordinates(
        spline_filter(smooth, mode="nearest"), nodes, mode="nearest", prefilter=False
    )
    axes = masks.affine[:3, :3]
    height = plane.height((np.argwhere(mask) - padding) @ axes.T + masks.affine[:3, 3])
    # voxels that the plane cuts count in part
    share = np.clip(0.5 - height / masks.thickness(plane.normal), 0, 1)
    nodes_inside = float(share.sum() * abs(np.linalg.det(axes))) / grid.edge**3
    # half of a cube around a node of the top layer lies below the plane: other nodes count twice
    below = values[:, :, :-1].ravel()
    twice = np.concatenate([below, below, values[:, :, -1].ravel()])
    rank = round(2 * nodes_inside)
    level = np.partition(twice, rank)[rank]
    return np.asarray(values - level, dtype=np.float64)


def closed_by(values: Floats, radius: float, edge: float) -> Floats:
    """Close the shape of a signed distance (mm) on a grid morphologically, with a ball (mm).

    Gaps narrower than twice the radius are filled.
    """
    grown = distance_transform_edt(values < radius) * edge
    # one edge less, so that only gaps change, not details that the grid cannot resolve
    return np.asarray(np.minimum(values, radius + edge - grown))
