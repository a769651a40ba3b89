"""Hearts of an atlas as what a prior averages over: their weights, and what is fixed."""

import numpy as np
import pytest

from fascicle.networks.prior import AveragedOver, Prior

WEIGHTS = (0.2, 0.0, 0.7, 0.1)
HEARTS = tuple({"atlas_heart": float(k)} for k in range(4))


def test_points_draw_hearts_as_often_as_they_are_probable():
    averaged = AveragedOver(tissues=HEARTS, weights=WEIGHTS)
    points = np.random.default_rng(0).random((20_000, len(averaged)))
    counts = np.bincount(averaged.tissue(points), minlength=4)
    assert counts / len(points) == pytest.approx(WEIGHTS, abs=0.015)
    assert averaged.edges == pytest.approx([0.0, 0.2, 0.2, 0.9, 1.0])
    assert averaged.values(np.array([0.95])) == {"atlas_heart": 3.0}


def test_without_weights_all_are_as_probable():
    averaged = AveragedOver(tissues=HEARTS)
    points = (np.arange(40) + 0.5)[:, None] / 40
    assert np.bincount(averaged.tissue(points)).tolist() == [10, 10, 10, 10]


def test_weights_are_no_part_of_what_was_simulated():
    assert repr(AveragedOver(tissues=HEARTS, weights=WEIGHTS)) == repr(AveragedOver(tissues=HEARTS))
    assert AveragedOver(tissues=HEARTS, weights=WEIGHTS) != AveragedOver(tissues=HEARTS)


def test_a_heart_that_is_fixed_is_not_averaged_over():
    of_atlas = Prior.of("posterior", {}, _Heart())
    assert len(of_atlas.averaged.tissues) == 2
    fixed = Prior.of("posterior", {"atlas_heart": 1}, _Heart())
    assert fixed.fixed == {"atlas_heart": 1.0}
    assert all("atlas_heart" not in tissue for tissue in fixed.averaged.tissues)


class _Atlas:
    weights = np.array([0.4, 0.6])

    def __len__(self):
        return 2


class _Heart:
    """What a prior asks of a heart."""

    values: dict = {}  # noqa: RUF012 - never changed
    atlas = _Atlas()
