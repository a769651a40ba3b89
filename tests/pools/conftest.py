"""What tests of pools and comparisons evaluate."""

import numpy as np
import pytest

from fascicle.core.parameters import EXAMPLE_PARAMETERS, NETWORK_SPACE
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import TargetComparison, evaluate
from fascicle.recording.target import Target


@pytest.fixture(scope="module")
def recordings(default_model):
    ecg = default_model.simulate(EXAMPLE_PARAMETERS).leads
    beat = np.pad(ecg, ((0, 0), (40, 40)))
    beats = beat + 0.02 * np.random.default_rng(0).normal(size=(5, *beat.shape))
    time = np.arange(beat.shape[1]) - 60.0
    return (TargetComparison(Target(beats, time, -20.0, 40.0, 60.0)),)


@pytest.fixture(scope="module")
def simulator(default_model):
    return PointSimulator(default_model, Prior(NETWORK_SPACE))


@pytest.fixture(scope="module")
def points():
    """Seven networks, and one that cannot be grown."""
    longest = NETWORK_SPACE.to_unit(EXAMPLE_PARAMETERS | {"lv_initial_length": 300.0})
    return [*np.random.default_rng(1).uniform(0.2, 0.6, (7, len(NETWORK_SPACE))), longest]


@pytest.fixture(scope="module")
def expected(simulator, recordings, points):
    return list(evaluate(simulator, recordings, points))
