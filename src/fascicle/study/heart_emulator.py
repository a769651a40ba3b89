"""The emulator of a heart: found, or made of prior simulations, and kept with the heart."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.array_cache import ArrayCache
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE
from fascicle.core.progress import Progress
from fascicle.core.ranges import check_count
from fascicle.forward.model import ForwardModel
from fascicle.forward.scenario import Scenario
from fascicle.heart.folder import as_heart
from fascicle.heart.heart import Heart
from fascicle.study.conduction_states import KNOWN_STATES, ConductionState
from fascicle.study.ecg_emulator import SOONER, EcgEmulator, learn
from fascicle.study.pool import Pool, Threads, check_pool
from fascicle.study.prior_simulations import SEED, PriorSimulations
from fascicle.study.settings import FitSettings
from fascicle.study.simulator import PointSimulator
from fascicle.study.space import AveragedOver, study_space

EMULATOR = "emulator"  # kind of file


def emulator_of(
    simulator: PointSimulator,
    count: int,
    folder: Path,
    progress: Progress | None = None,
    scenario: tuple[Scenario, str] | None = None,
) -> EcgEmulator:
    """Find an emulator for a study, or make one of so many prior simulations.

    Those of the heart's usual priors serve wherever a study learns and fixes what they have seen.

    Parameters
    ----------
    folder : Path
        Of a heart, in which simulations and emulator are kept.
    scenario : (Scenario, str), optional
        In which the heart was recorded, and its digest.
    """
    blocks = {n: v for n, v in simulator.fixed.items() if n == "conduction"}
    alike = [state for state in KNOWN_STATES if state.blocks == blocks]
    # The prior of all delays, None, covers every state; a narrower emulator is the better one.
    states = alike if blocks else [*alike, None]
    every = (usual_prior(simulator.model, folder, scenario, state) for state in states)
    asked = simulator.space, simulator.averaged, simulator.fixed
    usual = (prior for prior in every if prior.covers(*asked, simulator.mapped))
    prior = next(usual, None) or prior_of(simulator, folder, scenario)
    stored = packaged(EMULATOR, prior.content)
    if stored is not None and float(stored["report networks"]) >= count:
        return EcgEmulator.from_arrays(stored)
    return made_emulator(prior, count, simulator.pool, progress)


def packaged(kind: str, key: str) -> Mapping[str, Any] | None:
    """What comes with the package, of a kind of file; None if nothing does."""
    with resources.as_file(resources.files("fascicle") / "data" / "emulators") as folder:
        return ArrayCache(folder, kind).read(key)


def learnt_or_made(
    kind: str, key: str, count: int, folder: Path, make: Callable[[], Mapping[str, Any]]
) -> Mapping[str, Any]:
    """Arrays that were learnt from so many networks: of the package, of a heart's folder, or made.

    Those of the package also where fewer are asked for.
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
    prior: PriorSimulations, count: int, pool: Pool, progress: Progress | None = None
) -> EcgEmulator:
    """The emulator that was learnt from so many prior simulations, which are made if need be."""
    cache, key = ArrayCache(prior.cache.folder, EMULATOR), f"{count} of {prior.content}"
    arrays: Mapping[str, Any] | None = cache.read(key)
    if arrays is None:
        prior.simulate(count, pool, progress)
        ratio = float(np.divide(*prior.model.conduction.speeds))
        times = {*SOONER} & {*prior.fixed, *prior.model.heart.values}  # which no speed changes
        arrays = learn(
            prior.examples(count), prior.space, prior.averaged, ratio, np.random.default_rng(SEED),
            same_on_any_clock=prior.scenario is None and not times, progress=progress,
        ).arrays()  # fmt: skip
        cache.write(key, arrays, compress=True)
    emulator = EcgEmulator.from_arrays(arrays)  # with weights as they are stored
    if progress is not None:
        progress("emulator", 1, 1, emulator.said)
    return emulator


def prior_of(
    simulator: PointSimulator, folder: Path, scenario: tuple[Scenario, str] | None = None
) -> PriorSimulations:
    """Prior simulations of what a simulator varies, kept in the folder of a heart."""
    cache = ArrayCache(folder / DISPOSABLE, "prior")
    mapped = simulator.mapped and scenario is None  # of intrinsic beats
    return PriorSimulations(
        simulator.model, simulator.space, simulator.averaged, simulator.fixed, cache, scenario,
        mapped=mapped,
    )  # fmt: skip


def usual_prior(
    model: ForwardModel,
    folder: Path,
    scenario: tuple[Scenario, str] | None = None,
    state: ConductionState | None = None,
) -> PriorSimulations:
    """Those of what a study varies if nothing is said, or if nothing but its conduction state."""
    space, fixed = study_space("posterior", {} if state is None else state.blocks, model.heart)
    mapped = False
    if state is not None:
        space = state.narrowed(space, {**model.heart.values, **fixed}) or space
        mapped = state.is_mapped(space.names)
    averaged = AveragedOver.of(space, fixed, model.heart)
    simulator = PointSimulator(model, space, fixed, averaged=averaged, mapped=mapped)
    return prior_of(simulator, folder, scenario)


def for_simulations(
    heart: Heart | Path | str, count: int | None, name: str, workers: int | None, pool: Pool | None
) -> tuple[Heart, Path, int, Pool]:
    """Check and settle a heart, its folder, how many networks are simulated, and where.

    `name` is that of the argument `count`, which is by default as many as a fit wants.
    """
    check_pool(pool)
    heart = as_heart(heart)
    if count is None:
        count = int(FitSettings.model_fields["prior_simulations"].default)
    check_count(count, name)
    if workers is not None:
        check_count(workers, "workers")
    if heart.folder is None or not os.access(heart.folder, os.W_OK):
        raise InputError(f"{heart.folder or heart.name}: cannot be written to; copy the heart")
    return heart, heart.folder, count, pool or Threads(workers or os.cpu_count() or 1)
