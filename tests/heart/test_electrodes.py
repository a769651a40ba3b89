"""Electrodes of a file."""

import pytest

from fascicle.heart.electrodes import read_electrodes
from tests.anatomies import PLACES, write_electrodes


@pytest.mark.parametrize("name", ["RL", "rl"])
def test_the_grounded_electrode_is_left_out(tmp_path, name):
    file = write_electrodes(tmp_path / "e.csv", {**PLACES, name: (1, 2, 3), "E1": (4, 5, 6)})
    nine, more = read_electrodes(file)
    assert nine.shape == (9, 3)
    assert {key: at.tolist() for key, at in more.items()} == {"E1": [4, 5, 6]}
