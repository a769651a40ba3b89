"""What tests of predictions simulate with."""

from types import SimpleNamespace

import pytest

from fascicle.pools.pool import Threads


@pytest.fixture(scope="session")
def simulated_by(default_model):
    """Simulator, and the recording of networks: an intrinsic beat by a recorder without filters."""
    recording = SimpleNamespace(target=SimpleNamespace(response=None), scenario=None)
    return SimpleNamespace(model=default_model, pool=Threads(2)), recording
