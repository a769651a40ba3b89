"""Calibration: intervals of the sampler hold the truth as often as they say, on a model of its own.

The study of the real model is `benchmarks.calibration`, whose measures are used here.
"""

import numpy as np
import pytest

from benchmarks.calibration import LEVELS, coverage, distance, simultaneous
from fascicle.inference.tempered_sampling import temper

TRUTHS, NOISE = 80, 0.3


def observe(points):
    """Three bent functions of three parameters; the last parameter has hardly an effect."""
    a, b, c = points.T
    return np.column_stack([a + b, a * b + 0.1 * c, np.sin(3 * a) + 0.1 * c])


def ranks(believed):
    """Shares of draws below the truth, (truths, 3), when the noise is believed to be so large."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(TRUTHS):
        truth = rng.random(3)
        seen = observe(truth[None]) + NOISE * rng.standard_normal(3)
        run = temper(
            lambda p, y=seen: -0.5 * ((observe(p) - y) ** 2).sum(axis=1) / believed**2, 3, rng, 400
        )
        draws = run.points[rng.permutation(400)[:199]]
        found.append(((draws < truth).sum(axis=0) + rng.random(3)) / 200)
    return np.array(found)


def test_intervals_hold_what_they_say():
    found = ranks(NOISE)
    band = simultaneous(TRUTHS, 3, np.random.default_rng(1))
    assert max(distance(column) for column in found.T) < band
    for level in LEVELS:
        assert coverage(found, level) == pytest.approx(level, abs=0.08)


def test_a_noise_that_is_believed_too_small_is_seen():
    found = ranks(NOISE / 3)
    assert coverage(found[:, :2], 0.9) < 0.75
    assert max(distance(column) for column in found.T) > simultaneous(
        TRUTHS, 3, np.random.default_rng(1)
    )
