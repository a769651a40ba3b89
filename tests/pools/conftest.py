"""What tests of pools and comparisons evaluate."""

import numpy as np
import pytest
from anatomies import NETWORK
from builders import recorded

from fascicle.core.parameters import ParameterSpace, free
from fascicle.forward.model import ForwardModel
from fascicle.heart.folder import load_heart
from fascicle.networks.prior import Prior
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import TargetComparison, evaluate

WIDTHS = {"root_time": 20.0} | {name: abs(value) for name, value in NETWORK.items() if value}
SPACE = ParameterSpace(
    tuple(
        free(name, lower=NETWORK[name] - width / 4, upper=NETWORK[name] + width / 4)
        for name, width in WIDTHS.items()
    )
)


@pytest.fixture(scope="session")
def model(ventricles):
    """Of a small heart in a folder."""
    return ForwardModel(load_heart(ventricles))


@pytest.fixture(scope="module")
def recordings(model):
    return (TargetComparison(recorded(model.simulate(NETWORK))),)


@pytest.fixture(scope="module")
def simulator(model):
    return PointSimulator(model, Prior(SPACE))


@pytest.fixture(scope="module")
def points():
    """Seven networks, and one that cannot be grown."""
    longest = SPACE.to_unit(NETWORK | {"lv_initial_length": 300.0})
    return [*np.random.default_rng(1).uniform(size=(7, len(SPACE))), longest]


@pytest.fixture(scope="module")
def expected(simulator, recordings, points):
    return list(evaluate(simulator, recordings, points))
