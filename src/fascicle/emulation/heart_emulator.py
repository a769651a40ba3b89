"""Emulator of a heart: from the package, its folder, or trained there; refined for a recording.

An emulator trained on the prior is as inexact near the posterior as elsewhere, and its residuals
are those of networks throughout the prior. To refine it, networks drawn from a first, approximate
posterior are simulated: they train the emulator further, and measure its residuals there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fascicle.core.conduction_states import CONDUCTION_STATES, ConductionState, told_apart
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, ArrayCache
from fascicle.core.progress import Progress
from fascicle.core.quantities import Changes, quantity
from fascicle.core.ranges import check_count
from fascicle.core.threads import one_thread
from fascicle.emulation.ecg_emulator import SOONER, EcgEmulator, learn, refined
from fascicle.emulation.likelihood import RUNS, EmulatedLikelihood, of_all, sampled
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.heart.folder import as_heart, load_heart
from fascicle.heart.heart import Heart
from fascicle.inference.emulator import Singles
from fascicle.inference.tempered_sampling import effective_size
from fascicle.networks.prior import Prior
from fascicle.networks.prior_simulations import PriorSimulations
from fascicle.networks.settings import FitSettings
from fascicle.pools.pool import Pool, Threads, check_pool

REFINING_NETWORKS = 500  # simulated in a round, at most
MOST_ROUNDS = 3  # of sampling, simulation and training

# What a file holds that was learnt from simulations
Kind = Literal["emulator", "classifier", "origin"]


def simulations_for(
    model: ForwardModel, prior: Prior, folder: Path, scenario: Scenario | None = None
) -> PriorSimulations:
    """Prior simulations from which an emulator for a study learns, kept in a heart's folder.

    Simulations of the heart's usual priors serve any study whose quantities lie within their
    ranges. `scenario` is that of a recording.
    """
    blocks = {n: v for n, v in prior.fixed.items() if n == "conduction"}
    matching = [state for state in CONDUCTION_STATES.values() if state.blocks == blocks]
    # The default prior (None) covers every state, but the emulator of one state is more exact.
    states = matching if blocks else [*matching, None]
    candidates = (
        simulations_of(model, usual_prior(model.heart, state), folder, scenario) for state in states
    )
    covering = (candidate for candidate in candidates if candidate.prior.covers(prior))
    return next(covering, None) or simulations_of(model, prior, folder, scenario)


def emulator_of(
    simulations: PriorSimulations, count: int, pool: Pool, progress: Progress | None = None
) -> EcgEmulator:
    """Emulator trained on `count` prior simulations, or a packaged one, on at least as many."""
    stored = packaged("emulator", simulations.content)
    if stored is not None and float(stored["report networks"]) >= count:
        return EcgEmulator.from_arrays(stored)
    return made_emulator(simulations, count, pool, progress)


def packaged(kind: Kind, key: str) -> Mapping[str, Any] | None:
    """Arrays of a kind of file that come with the package; None if there are none."""
    with resources.as_file(resources.files("fascicle") / "data" / "emulators") as folder:
        return ArrayCache(folder, kind).read(key)


def learnt_or_made(
    kind: Kind, key: str, count: int, folder: Path, make: Callable[[], Mapping[str, Any]]
) -> Mapping[str, Any]:
    """Arrays learnt from `count` networks: from the package, from a heart's folder, or made.

    Arrays of the package are also taken if they were learnt from more networks.
    """
    stored: Mapping[str, Any] | None = packaged(kind, key)
    if stored is not None and int(stored["networks"]) >= count:
        return stored
    cache, key = ArrayCache(folder / DISPOSABLE, kind), f"{count} of {key}"
    if (stored := cache.read(key)) is None:
        stored = {**make(), "networks": np.array(count)}
        cache.write(key, stored, compress=True)
    return stored


def made_emulator(
    simulations: PriorSimulations, count: int, pool: Pool, progress: Progress | None = None
) -> EcgEmulator:
    """Emulator learnt from `count` prior simulations; both are made if they are missing."""
    model, prior = simulations.model, simulations.prior
    cache = ArrayCache(simulations.cache.folder, "emulator")
    key = f"{count} of {simulations.content}"
    arrays: Mapping[str, Any] | None = cache.read(key)
    if arrays is None:
        number = simulations.simulate_enough(count, pool, progress)
        ratio = float(np.divide(*model.conduction.speeds))
        fixed_times = {*SOONER} & {*prior.fixed, *model.heart.values}  # which do not scale
        arrays = learn(
            simulations.examples(number), prior, ratio, np.random.default_rng(simulations.seed),
            time_scaling=simulations.scenario is None and not fixed_times, progress=progress,
            atlas=atlas_emulator(prior),
        ).arrays()  # fmt: skip
        cache.write(key, arrays, compress=True)
    # from arrays even if it was just made, so that weights have the stored precision
    emulator = EcgEmulator.from_arrays(arrays)
    if progress is not None:
        progress("emulator", 1, 1, emulator.summary)
    return emulator


@cache
def atlas_model() -> ForwardModel:
    """Forward model of the packaged hearts of the population."""
    return ForwardModel(load_heart("atlas"))


def atlas_emulator(prior: Prior) -> EcgEmulator | None:
    """Packaged emulator of the atlas in the conduction state of a prior, from which others begin.

    Of a prior of another state, or of several, it is that of normal conduction.
    """
    blocks = {n: v for n, v in prior.fixed.items() if n == "conduction"}
    states = [state for state in told_apart() if state.blocks == blocks] or told_apart()
    usual = usual_prior(atlas_model().heart, states[0])
    stored = packaged("emulator", simulations_of(atlas_model(), usual, Path()).content)
    return None if stored is None else EcgEmulator.from_arrays(stored)


def simulations_of(
    model: ForwardModel, prior: Prior, folder: Path, scenario: Scenario | None = None
) -> PriorSimulations:
    """Simulations of a prior, kept in a heart's folder."""
    cache = ArrayCache(folder / DISPOSABLE, "prior")
    mapped = prior.mapped and scenario is None  # intrinsic beats alone
    return PriorSimulations(model, replace(prior, mapped=mapped), cache, scenario)


def usual_prior(heart: Heart, state: ConductionState | None = None) -> Prior:
    """Prior of a study with default parameters, or of one conduction state."""
    if state is None:
        return Prior.of("posterior", {}, heart)
    return Prior.of("posterior", state.blocks, heart).narrowed(state)


def for_simulations(
    heart: Heart | Path | str,
    count: int | None,
    name: str,
    workers: int | None,
    pool: Pool | None,
    default: int = FitSettings.model_fields["prior_simulations"].default,
) -> tuple[Heart, Path, int, Pool]:
    """Check and settle a heart, its folder, the number of networks to simulate, and the pool.

    `name` names the argument `count` in messages; its default is that of `fascicle.fit`.
    """
    check_pool(pool)
    heart = as_heart(heart)
    if count is None:
        count = default
    check_count(count, name)
    if workers is not None:
        check_count(workers, "workers")
    if heart.folder is None or not os.access(heart.folder, os.W_OK):
        raise InputError(f"{heart.folder or heart.name}: cannot be written to; copy the heart")
    return heart, heart.folder, count, pool or Threads(workers or os.cpu_count() or 1)


def refined_emulators(
    emulators: Sequence[EcgEmulator],
    emulated_by: Callable[[Sequence[EcgEmulator]], Sequence[EmulatedLikelihood]],
    scenarios: Sequence[Scenario | None],
    count: int,
    folder: Path,
    rng: np.random.Generator,
    progress: Progress | None = None,
    share: float = 1 / 4,
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
        prior_points, trained = prior.sample(rng, number * len(points)), {}
        for emulator, likelihood, scenario, key in zip(
            emulators, likelihoods, scenarios, keys, strict=True
        ):
            if key in trained:
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
            trained[key] = refined(emulator, *examples, prior_inputs, rng, len(inputs), progress)
        previous, likelihoods = likelihoods, emulated_by([trained[key] for key in keys])
        log_weights = of_all(likelihoods, run_points) - of_all(previous, run_points)
        # where fewer than 2 % of a round's draws are effective, the posterior has moved
        if effective_size(log_weights - log_weights.max()) > 0.02 * len(run_points):
            break
    return [likelihood.emulator for likelihood in likelihoods]
