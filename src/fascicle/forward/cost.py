"""What a forward run costs on a heart."""

from __future__ import annotations

import time

import numpy as np

from fascicle.core.parameters import NETWORK_SPACE
from fascicle.forward.model import ForwardModel
from fascicle.purkinje.tree import InvalidTree

RUNS = 5  # that are timed, after one that is not
DRAWS = 100  # of networks, few of which fit a small heart


def forward_run_time(model: ForwardModel) -> float | None:
    """Median wall time (ms) of a forward run with a network that the model has not seen.

    Networks are drawn from the paper's ranges, the same for every heart with the same endocardia;
    None if hardly any fits them.
    """
    rng, elapsed = np.random.default_rng(0), []
    for _ in range(DRAWS):
        parameters = NETWORK_SPACE.from_unit(rng.uniform(size=len(NETWORK_SPACE)))
        begin = time.perf_counter()
        simulation = model.simulate(parameters)
        if not isinstance(simulation, InvalidTree):
            elapsed.append(1e3 * (time.perf_counter() - begin))
        if len(elapsed) > RUNS:
            return float(np.median(elapsed[1:]))
    return None
