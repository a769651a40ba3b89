"""Accepted networks, simulated: what reports and predictions are made of."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fascicle.forward.simulation import Simulation
from fascicle.study.population import Accepted
from fascicle.study.problem import Problem, simulate_valid


@dataclass(frozen=True)
class Network:
    """One network of the population: its parameters and what it does.

    Attributes
    ----------
    parameters : dict of name to float
        In their units.
    simulation : Simulation
        What the forward model makes of them.
    predicted : (12, n_time) array
        Its ECG under the recorded mean beat (mV).
    """

    parameters: dict[str, float]
    simulation: Simulation
    predicted: NDArray[np.float64]


def simulate_best(problem: Problem, accepted: Accepted) -> Network:
    """The network with the least mismatch."""
    return _simulate(problem, dict(accepted.best))


def simulate_all(
    problem: Problem, accepted: Accepted, progress: Callable[[int, int], None] | None = None
) -> list[Network]:
    """All accepted networks, in order; `progress` hears (done, total)."""
    networks = []
    with ThreadPoolExecutor(problem.workers) as pool:
        parameters = [accepted.parameters(k) for k in range(len(accepted))]
        for network in pool.map(lambda values: _simulate(problem, values), parameters):
            networks.append(network)
            if progress is not None:
                progress(len(networks), len(accepted))
    return networks


def _simulate(problem: Problem, parameters: dict[str, float]) -> Network:
    simulation = simulate_valid(problem.model, parameters)
    return Network(parameters, simulation, problem.predicted(simulation, problem.align(simulation)))
