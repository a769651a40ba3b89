"""Damaged files of every kind end in an answer or one line, within 10 s and 2 GB.

`python -m benchmarks.fuzzing` does the same with 20,000 files of each kind.
"""

from __future__ import annotations

import pytest

from benchmarks.fuzzing.attempts import outcomes
from benchmarks.fuzzing.kinds import KINDS

NUMBER = 500


@pytest.mark.parametrize("name", KINDS)
def test_damaged_files(name, tmp_path):
    failures, refused = [], 0
    for outcome in outcomes(name, range(NUMBER), tmp_path):
        refused += bool(outcome.message)
        if outcome.failure:
            failures.append(f"{outcome.number}: {outcome.failure}")
    assert failures == []
    assert 0 < refused < NUMBER  # so that neither readers nor damage are trivial
