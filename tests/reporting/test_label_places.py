"""Names of electrodes hide neither one another nor the electrodes."""

import numpy as np

from fascicle.reporting.check import NAME_SIZE, label_places


def test_names_near_one_another_are_apart():
    points = np.array([[0, 0], [0, 0], [3, -4], [7, -9], [30, -8], [60, 0], [-90.0, 40]])
    middles = points + label_places(points)
    for k, middle in enumerate(middles):
        others = np.abs(np.delete(middles, k, axis=0) - middle) / NAME_SIZE
        assert (others >= 1).any(axis=1).all()
        assert ((np.abs(points - middle) / NAME_SIZE) >= 0.5).any(axis=1).all()
        assert np.hypot(*(middle - points[k])) < 40


def test_a_name_alone_stands_where_one_expects_it():
    (away,) = label_places(np.zeros((1, 2)))
    assert (away > 0).all()
