"""Damaged files of every kind end in an answer or one line, within 10 s and 2 GB.

`python -m benchmarks.fuzzing` does the same with 20,000 files of each kind.
"""

import pytest

from benchmarks.fuzzing.attempts import outcomes
from benchmarks.fuzzing.kinds import KINDS

NUMBER = 100
FEWER = {"hearts": 25, "studies": 25}  # a tenth of a second each


# among 20,000 of each kind, those that had ended otherwise once
FOUND = {
    "meshes": (10134, 14186, 17744),
    "trees": (1776, 2430, 2700),
    "recordings": (10020, 12619, 18136),
    "settings": (917, 1767, 1913),
    "hearts": (856, 1423, 1653, 2345, 2381, 4043, 4171, 4419),
    "segmentations": (1583, 7800, 8226, 19776),
    "electrodes": (900, 3839, 12260),
}


@pytest.mark.parametrize("name", FOUND)
def test_damage_that_was_found(name, tmp_path):
    for number in FOUND[name]:
        (outcome,) = outcomes(name, range(number, number + 1), tmp_path)
        assert not outcome.failure


@pytest.mark.parametrize("name", KINDS)
def test_damaged_files(name, tmp_path):
    failures, refused, number = [], 0, FEWER.get(name, NUMBER)
    for outcome in outcomes(name, range(number), tmp_path):
        refused += bool(outcome.message)
        if outcome.failure:
            failures.append(f"{outcome.number}: {outcome.failure}")
    assert failures == []
    assert 0 < refused < number  # so that neither readers nor damage are trivial
