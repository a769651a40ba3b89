"""Time that scenarios over a population take.

    python -m benchmarks.predictions --heart HEART [--networks 30] [--workers 2]

Networks of the prior stand for a population. Printed are the seconds that six scenarios of the
library take in all of them (activation, ECG and indices), and what was found once for the heart
before: its segments, and sites. Run from the root of the repository.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

import fascicle
from fascicle.emulation.heart_emulator import usual_prior
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario_files import read_scenarios
from fascicle.networks.prior import AveragedOver
from fascicle.networks.simulator import PointSimulator
from fascicle.networks.target_comparison import Network, TargetComparison
from fascicle.pools.pool import Threads
from fascicle.prediction.scenarios import simulate_scenarios
from fascicle.recording.target import Target, smooth_noise

SCENARIOS = (
    "intrinsic", "his-pacing", "left-bundle-branch-pacing",
    "left-bundle-branch-pacing-nonselective",
    "rv-apical-pacing", "biventricular-pacing",
)  # fmt: skip


def population(model: ForwardModel, count: int, rng: np.random.Generator) -> list[Network]:
    """`count` networks of the prior."""
    prior = replace(usual_prior(model.heart), averaged=AveragedOver())
    networks: list[Network] = []
    while len(networks) < count:
        values = prior.from_unit(prior.sample(rng, 1)[0])
        simulation = model.simulate(values)
        if isinstance(simulation, fascicle.Beat):
            networks.append(Network(values, simulation, simulation.leads, 1.0, 1.0))
    return networks


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--heart", required=True)
    parser.add_argument("--networks", type=int, default=30)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    model = ForwardModel(fascicle.load_heart(arguments.heart))
    networks = population(model, arguments.networks, rng)
    time_axis = np.arange(-60.0, 140.0)
    beats = smooth_noise(rng, (2, 12, len(time_axis)), 0.1)  # of any recording; its filters count
    target = Target(beats, time_axis, -40.0, 40.0, 60.0, {}, 4.0, 5.0)
    simulator = PointSimulator(model, usual_prior(model.heart), Threads(arguments.workers))
    recording = TargetComparison(target)
    scenarios = read_scenarios(SCENARIOS)
    begin = time.perf_counter()
    simulate_scenarios(simulator, recording, networks[:1], scenarios)
    once = time.perf_counter() - begin
    begin = time.perf_counter()
    simulate_scenarios(simulator, recording, networks, scenarios)
    seconds = time.perf_counter() - begin
    print(f"{len(networks)} networks, {len(scenarios)} scenarios: {seconds:.1f} s")
    print(f"once for the heart, with the first network: {once:.1f} s")


if __name__ == "__main__":
    main()
