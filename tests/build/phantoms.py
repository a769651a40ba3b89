"""Segmentations of truncated ellipsoids, whose surfaces and volumes are known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from shapes import ellipsoid

from fascicle.build.segmentation import Segmentation, SegmentationLabels

# In the heart's frame (mm): z up from the LV's centre to the base, x from the LV to the RV.
LV_INNER, LV_OUTER = np.array([22.0, 22.0, 55.0]), np.array([32.0, 32.0, 64.0])
RV_INNER, RV_OUTER = np.array([38.0, 28.0, 47.0]), np.array([42.0, 32.0, 51.0])
RV_CENTRE = np.array([20.0, 0.0, 0.0])
BASE = 12.0
SCAR_CENTRE, SCAR_RADIUS = np.array([-27.0, 0.0, -10.0]), 9.0
LABELS = SegmentationLabels(lv=1, rv=2, myocardium=3, scar=4)
# columns are the heart's axes in the world, turned about all three
TURN = np.linalg.qr(np.array([[0.8, -0.4, 0.45], [0.5, 0.85, -0.15], [-0.3, 0.35, 0.9]]))[0]
TURN = TURN * np.sign(np.diag(TURN))
CENTRE = np.array([-35.0, 18.0, 240.0])
ALIGNED = np.eye(3)
# Turned voxel axes (columns), in the heart's frame
OBLIQUE = np.linalg.qr(np.array([[0.9, 0.3, 0.2], [-0.3, 0.8, 0.4], [0.1, -0.5, 0.85]]))[0]
OBLIQUE = OBLIQUE * np.sign(np.diag(OBLIQUE))


def labels_at(points, base=BASE):
    """Exact label of points in the heart's frame."""
    lv, lv_wall = ellipsoid(points, LV_INNER) < 0, ellipsoid(points, LV_OUTER) < 0
    rv = (ellipsoid(points, RV_INNER, RV_CENTRE) < 0) & ~lv_wall
    wall = (ellipsoid(points, RV_OUTER, RV_CENTRE) < 0) | lv_wall
    scar = np.linalg.norm(points - SCAR_CENTRE, axis=-1) < SCAR_RADIUS
    labels = np.where(wall, 3, 0)
    labels[wall & scar] = 4
    labels[rv] = 2
    labels[lv] = 1
    labels[points[..., 2] > base] = 0
    return labels


def exact_distance(points, kind):
    """Distance of points (heart's frame) to the exact surface of a kind ("lv", "epi"), in mm."""
    lv_outer = ellipsoid(points, LV_OUTER)
    if kind == "lv":
        return ellipsoid(points, LV_INNER)
    if kind == "rv":
        return np.maximum(ellipsoid(points, RV_INNER, RV_CENTRE), -lv_outer)
    return np.minimum(lv_outer, ellipsoid(points, RV_OUTER, RV_CENTRE))


@cache
def exact_volumes(edge=0.75):
    """Volumes (ml) of the exact bodies, by a fine midpoint rule."""
    low, high = np.array([-33.0, -33.0, -65.0]), np.array([63.0, 33.0, BASE])
    axes = [np.arange(a + edge / 2, b, edge) for a, b in zip(low, high, strict=True)]
    return counted(labels_at(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)), edge**3)


def counted(labels, voxel_volume):
    """Volumes (ml) by the number of voxels (mm³)."""
    masks = {"lv": labels == 1, "rv": labels == 2, "myocardium": labels >= 3, "scar": labels == 4}
    return {part: mask.sum() * voxel_volume / 1000 for part, mask in masks.items()}


@dataclass(frozen=True)
class Phantom:
    """A segmentation and where its heart lies in the world."""

    segmentation: Segmentation
    turn: np.ndarray
    centre: np.ndarray

    def to_heart(self, points):
        """From the world to the heart's frame."""
        return (points - self.centre) @ self.turn


def ellipsoid_segmentation(
    spacing=(1.5, 1.5, 1.5), turn=TURN, centre=CENTRE, slices=ALIGNED, labels=labels_at, name="map"
) -> Phantom:
    """Voxelise the phantom.

    `turn` places the heart in the world; `slices` (columns) gives the voxel axes in the heart's
    frame: the identity for a short-axis stack, whose top slice ends at the base.
    """
    spacing, slices = np.asarray(spacing, dtype=float), np.asarray(slices, dtype=float)
    corners = np.array(np.meshgrid([-36, 66], [-36, 36], [-68, 16])).reshape(3, -1).T @ slices
    low = corners.min(axis=0)
    # a slice of a short-axis stack ends at the base, none is cut through
    low[2] = BASE - spacing[2] * np.ceil((BASE - low[2]) / spacing[2]) + spacing[2] / 2
    shape = np.ceil((corners.max(axis=0) - low) / spacing).astype(int) + 1
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    points = (low + index * spacing) @ slices.T
    affine = np.eye(4)
    affine[:3, :3] = turn @ slices * spacing
    affine[:3, 3] = turn @ slices @ low + centre
    return Phantom(Segmentation(labels(points), affine, name), turn, np.asarray(centre))
