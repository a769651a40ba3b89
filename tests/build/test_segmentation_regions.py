"""Scar at points, and the label map's own checks."""

from __future__ import annotations

import numpy as np
import pytest
from phantoms import (
    ALIGNED,
    LABELS,
    OBLIQUE,
    SCAR_CENTRE,
    ellipsoid_segmentation,
    labels_at,
    segmentation_volumes,
)

from fascicle.build.segmentation import SegmentationLabels, regions_at
from fascicle.core.errors import InputError


@pytest.mark.parametrize("slices", [ALIGNED, OBLIQUE])
def test_scar_is_where_it_was_segmented(slices):
    """Points spread evenly over the tissue, as centroids of tetrahedra are."""
    phantom = ellipsoid_segmentation((1.5, 1.5, 1.5), slices=slices)
    low, high = np.array([-40.0, -15.0, -25.0]), np.array([-15.0, 15.0, 5.0])
    points = np.random.default_rng(0).uniform(low, high, (100_000, 3))
    ml = np.prod(high - low) / 1000 / len(points)
    points = points[np.isin(labels_at(points), (3, 4))]
    tagged = regions_at(phantom.segmentation, LABELS, points @ phantom.turn.T + phantom.centre)
    exact = labels_at(points) == 4
    counted = segmentation_volumes(phantom.segmentation, LABELS)["scar"]
    assert tagged.sum() * ml == pytest.approx(counted, rel=0.03)
    assert tagged.sum() == pytest.approx(exact.sum(), rel=0.05)
    off = points[tagged == 1].mean(axis=0) - points[exact].mean(axis=0)
    assert np.abs(off).max() < 0.3


def test_outside_the_map_and_without_scar_there_is_none():
    phantom = ellipsoid_segmentation((3.0, 3.0, 3.0))
    scar = SCAR_CENTRE @ phantom.turn.T + phantom.centre
    points = np.array([scar, scar + 500, scar - 500])
    assert regions_at(phantom.segmentation, LABELS, points).tolist() == [1, 0, 0]
    without = SegmentationLabels(1, 2, (3, 4))
    assert regions_at(phantom.segmentation, without, points).tolist() == [0, 0, 0]


@pytest.mark.parametrize("labels", [(1, 1, 3, None), (1, 2, (3, 2), None), (0, 2, 3, None)])
def test_labels_that_mean_two_things_are_refused(labels):
    with pytest.raises(InputError, match="give each part its own numbers"):
        SegmentationLabels(*labels)
