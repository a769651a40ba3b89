"""Emulators refined with simulations of networks drawn from the posterior of the recordings.

An emulator trained on the prior is as inexact near the posterior as elsewhere, and its residuals
are those of networks throughout the prior. Networks drawn from a first, approximate posterior are
simulated to train the emulator further, and to measure its residuals there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fascicle.core.array_cache import ArrayCache
from fascicle.core.files import DISPOSABLE
from fascicle.core.progress import Progress
from fascicle.core.quantities import Changes, quantity
from fascicle.core.threads import one_thread
from fascicle.emulation.ecg_emulator import EcgEmulator
from fascicle.emulation.ecg_emulator import refined as refined_by
from fascicle.emulation.likelihood import RUNS, EmulatedLikelihood, of_all, sampled
from fascicle.forward.scenario import Scenario
from fascicle.inference.emulator import Singles
from fascicle.inference.tempered_sampling import effective_size
from fascicle.networks.prior_simulations import PriorSimulations

REFINING_NETWORKS = 500  # simulated in a round, at most
MOST_ROUNDS = 3  # of sampling, simulation and training


def refined_emulators(
    emulators: Sequence[EcgEmulator],
    emulated_by: Callable[[Sequence[EcgEmulator]], Sequence[EmulatedLikelihood]],
    scenarios: Sequence[Scenario | None],
    count: int,
    folder: Path,
    rng: np.random.Generator,
    progress: Progress | None = None,
    share: float = 1 / 32,
    particles: int = 300,
) -> list[EcgEmulator]:
    """Train emulators further, on networks of the posterior that they give together.

    One round is enough, unless the posterior moves away from the networks that were simulated.

    Emulators are not refined if a quantity of the tissue is learnt: each network would have a
    tissue of its own, whose preparation takes seconds.

    Parameters
    ----------
    emulators, scenarios : sequences
        Emulator of each recording, and its scenario.
    emulated_by : callable
        Function from emulators to the likelihoods of the recordings.
    count : int
        Number of prior simulations that the emulators have learnt from.
    folder : Path
        Folder of the study, in which the simulations are kept.
    share : float
        Networks simulated in a round, as a fraction of `count`; `REFINING_NETWORKS` at most.
    particles : int
        Particles of each run of a round; some of them are simulated.

    Returns
    -------
    list of EcgEmulator
        Emulator of each recording; recordings of one scenario share an emulator.
    """
    likelihoods = emulated_by(emulators)
    simulator = likelihoods[0].simulator
    network_count = round(min(REFINING_NETWORKS, share * count))
    if any(quantity(name).changes is Changes.TISSUE for name in simulator.prior.names):
        return [*emulators]
    prior = simulator.prior
    sample = one_thread(sampled)  # around both runs: the end of one would lift the other's limit
    cache = ArrayCache(folder / DISPOSABLE, "posterior")
    keys = [repr(scenario) for scenario in scenarios]
    training_sets: dict[str, list[tuple[Singles, Singles]]] = {key: [] for key in keys}
    for number in range(1, MOST_ROUNDS + 1):
        message = f"{RUNS} runs of {particles}, to refine the emulator"
        message += f", round {number}" if number > 1 else ""
        runs = sample(likelihoods, prior.dimension, rng.spawn(RUNS), particles, message, progress)
        run_points = np.concatenate([run.points for run in runs])
        points = rng.permutation(run_points)[:network_count]
        prior_points, refined = prior.sample(rng, number * len(points)), {}
        for emulator, likelihood, scenario, key in zip(
            emulators, likelihoods, scenarios, keys, strict=True
        ):
            if key in refined:
                continue
            simulations = PriorSimulations(
                simulator.model, replace(prior, mapped=False), cache, scenario, points
            )  # fmt: skip
            simulations.simulate(len(points), simulator.pool, progress)
            new_examples = simulations.examples(len(points), emulator.length)
            inputs, prior_inputs = (
                likelihood.inputs(p)[0] for p in (points[new_examples.feasible], prior_points)
            )
            training_sets[key].append((inputs, new_examples.ecgs))
            examples = map(np.concatenate, zip(*training_sets[key], strict=True))
            refined[key] = refined_by(emulator, *examples, prior_inputs, rng, latest=len(inputs))
        previous, likelihoods = likelihoods, emulated_by([refined[key] for key in keys])
        log_weights = of_all(likelihoods, run_points) - of_all(previous, run_points)
        # where fewer than 2 % of a round's draws are effective, the posterior has moved
        if effective_size(log_weights - log_weights.max()) > 0.02 * len(run_points):
            break
    return [likelihood.emulator for likelihood in likelihoods]
