"""What tests of pools evaluate."""

from __future__ import annotations

import numpy as np
import pytest

from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.recording.target import Target
from fascicle.study.problem import Problem


@pytest.fixture(scope="module")
def problem(default_model):
    ecg = default_model.simulate(EXAMPLE_PARAMETERS).leads
    beat = np.pad(ecg, ((0, 0), (40, 40)))
    beats = beat + 0.02 * np.random.default_rng(0).normal(size=(5, *beat.shape))
    time = np.arange(beat.shape[1]) - 60.0
    return Problem(default_model, Target(beats, time, -20.0, 40.0, 60.0), NETWORK_SPACE)


@pytest.fixture(scope="module")
def expected(problem, points):
    return list(problem(points))
