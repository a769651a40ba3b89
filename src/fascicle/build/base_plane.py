"""The plane at which a segmented heart is cut: the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.build.segmentation import Masks
from fascicle.core.arrays import Booleans, Floats, Integers

LEVEL = 1.0  # mm, resolution of the search along the axis


@dataclass(frozen=True)
class BasePlane:
    """A plane by a point (mm) and the unit vector from apex to base, and how it was found."""

    point: Floats
    normal: Floats
    how: str

    def height(self, points: Floats) -> Floats:
        """Distance above the plane (mm), negative in the ventricles."""
        return np.asarray((points - self.point) @ self.normal)


@dataclass(frozen=True)
class Faces:
    """Faces between a voxel of a ventricle's blood and one of something else.

    Centres (n, 3) of the voxels of blood and of the faces, vectors with the face's area as length
    that leave the blood (n, 3), and whether nothing is on the other side: neither tissue nor the
    other ventricle's blood (n,).
    """

    voxels: Floats
    centres: Floats
    areas: Floats
    free: Booleans


def find_base_plane(masks: Masks) -> BasePlane:
    """Find the base: the flat end of the map, or the highest complete ring of tissue.

    Where the LV blood ends in a flat opening that tissue surrounds, the map was cut there.
    Otherwise the plane is perpendicular to the LV's long axis, the principal axis of its blood, at
    the level above which tissue does not surround the blood any more; where tissue closes over the
    base, at the level at which the LV begins to close.
    """
    blood = masks.positions(masks.lv)
    centre = blood.mean(axis=0)
    faces = blood_faces(masks, masks.lv, masks.rv)
    size = np.linalg.norm(faces.areas, axis=1)
    axis = np.linalg.eigh(np.cov((blood - centre).T))[1][:, 2]
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


def blood_faces(masks: Masks, blood: Booleans, other: Booleans) -> Faces:
    """Faces of one ventricle's blood, given that of the other."""
    axes = masks.affine[:3, :3]
    voxels, centres, areas, free = [], [], [], []
    for k in range(3):
        across = np.cross(axes[:, (k + 1) % 3], axes[:, (k + 2) % 3])
        across *= np.sign(across @ axes[:, k])
        for step in (-1, 1):
            index = np.argwhere(blood & ~np.roll(blood, -step, axis=k))
            neighbour = index.copy()
            neighbour[:, k] += step
            voxels.append(index @ axes.T + masks.affine[:3, 3])
            centres.append((index + neighbour) / 2 @ axes.T + masks.affine[:3, 3])
            areas.append(np.tile(step * across, (len(index), 1)))
            free.append(~(masks.tissue | other)[tuple(neighbour.T)])
    return Faces(
        np.concatenate(voxels), np.concatenate(centres), np.concatenate(areas), np.concatenate(free)
    )


def _sections(masks: Masks, along: Floats, axis: Floats) -> tuple[Integers, float]:
    """Voxels of blood in each slice from the lowest up, and how thick slices are (mm)."""
    width = max(masks.thickness(axis), LEVEL)
    return np.bincount(np.floor((along - along.min()) / width).astype(np.int64)), width


def _flat_opening(masks: Masks, faces: Faces, centre: Floats) -> BasePlane | None:
    """The plane with most of the opening within half a voxel, by random samples; None if < 60 %."""
    points, areas = faces.centres[faces.free], faces.areas[faces.free]
    size = np.linalg.norm(areas, axis=1)
    rng = np.random.default_rng(0)
    best, inliers = 0.0, np.zeros(len(points), dtype=bool)
    for corners in rng.choice(len(points), size=(300, 3), p=size / size.sum()):
        a, b, c = points[corners]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length == 0:
            continue
        normal /= length
        near = np.abs((points - a) @ normal) <= masks.thickness(normal) / 2
        # what a slanted step has of its faces counts as it is seen along the normal
        seen = abs(float((areas[near] @ normal).sum()))
        if seen > best:
            best, inliers = seen, near
    if best < 0.6 * float(np.linalg.norm(areas.sum(axis=0))):
        return None
    points, areas = points[inliers], areas[inliers]
    normal = areas.sum(axis=0)
    for _ in range(5):
        weight = np.abs(areas @ normal)  # the sides of gaps in the ring do not count
        middle = np.average(points, axis=0, weights=weight)
        _, _, rows = np.linalg.svd(
            (points - middle) * np.sqrt(weight)[:, None], full_matrices=False
        )
        normal = rows[2]
    normal = normal * np.sign(normal @ (middle - centre))
    return BasePlane(middle, normal, "the flat end of the label map")


def _level(masks: Masks, faces: Faces, centre: Floats, axis: Floats) -> tuple[float, str]:
    """Height of the plane above the centre of the LV blood (mm), and how it was found."""
    along = (faces.centres - centre) @ axis
    # only the part of a face that looks sideways belongs to the ring
    sideways = np.linalg.norm(faces.areas - np.outer(faces.areas @ axis, axis), axis=1)
    start = np.floor(along.min() / LEVEL)
    level = np.floor(along / LEVEL - start).astype(np.int64)
    whole = np.bincount(level, weights=sideways)
    ring = np.bincount(level, weights=sideways * ~faces.free)
    heights = (start + np.arange(len(whole)) + 0.5) * LEVEL
    used = (whole > 0) & (heights > 0)
    closed = ring[used] >= 0.9 * whole[used]  # the ring borders on so much of the circumference
    heights = heights[used]
    if not closed.all():
        first = int(np.argmin(closed))
        below = heights[first - 1] if first else 0.0
        return float(below + heights[first]) / 2, "the highest complete ring of tissue"
    blood = (masks.positions(masks.lv) - centre) @ axis
    counts, width = _sections(masks, blood, axis)
    last = np.flatnonzero(counts >= 0.5 * counts.max())[-1]
    return float(blood.min() + last * width), "the end of the LV blood, which tissue closes over"
