"""Emulator of a heart: read from the package or the heart's folder, or made and kept there."""

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
    """Find an emulator for a study, or make one from `count` prior simulations.

    Emulators of the heart's usual priors serve any study whose quantities lie within their ranges.

    Parameters
    ----------
    folder : Path
        Folder of the heart, in which simulations and emulator are kept.
    scenario : (Scenario, str), optional
        Scenario in which the heart was recorded, and its digest.
    """
    blocks = {n: v for n, v in simulator.fixed.items() if n == "conduction"}
    alike = [state for state in KNOWN_STATES if state.blocks == blocks]
    # The prior of all delays, None, covers every state, but a narrower emulator is more exact.
    states = alike if blocks else [*alike, None]
    candidates = (usual_prior(simulator.model, folder, scenario, state) for state in states)
    study = simulator.space, simulator.averaged, simulator.fixed
    usual = (prior for prior in candidates if prior.covers(*study, simulator.mapped))
    prior = next(usual, None) or prior_of(simulator, folder, scenario)
    stored = packaged(EMULATOR, prior.content)
    if stored is not None and float(stored["report networks"]) >= count:
        return EcgEmulator.from_arrays(stored)
    return made_emulator(prior, count, simulator.pool, progress)


def packaged(kind: str, key: str) -> Mapping[str, Any] | None:
    """Arrays of a kind of file that come with the package; None if there are none."""
    with resources.as_file(resources.files("fascicle") / "data" / "emulators") as folder:
        return ArrayCache(folder, kind).read(key)


def learnt_or_made(
    kind: str, key: str, count: int, folder: Path, make: Callable[[], Mapping[str, Any]]
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
    prior: PriorSimulations, count: int, pool: Pool, progress: Progress | None = None
) -> EcgEmulator:
    """Emulator learnt from `count` prior simulations; both are made if they are missing."""
    cache, key = ArrayCache(prior.cache.folder, EMULATOR), f"{count} of {prior.content}"
    arrays: Mapping[str, Any] | None = cache.read(key)
    if arrays is None:
        prior.simulate(count, pool, progress)
        ratio = float(np.divide(*prior.model.conduction.speeds))
        fixed_times = {*SOONER} & {*prior.fixed, *prior.model.heart.values}  # which do not scale
        arrays = learn(
            prior.examples(count), prior.space, prior.averaged, ratio, np.random.default_rng(SEED),
            same_on_any_clock=prior.scenario is None and not fixed_times, progress=progress,
        ).arrays()  # fmt: skip
        cache.write(key, arrays, compress=True)
    # from arrays even if it was just made, so that weights have the stored precision
    emulator = EcgEmulator.from_arrays(arrays)
    if progress is not None:
        progress("emulator", 1, 1, emulator.said)
    return emulator


def prior_of(
    simulator: PointSimulator, folder: Path, scenario: tuple[Scenario, str] | None = None
) -> PriorSimulations:
    """Prior simulations of the quantities that a simulator varies, kept in a heart's folder."""
    cache = ArrayCache(folder / DISPOSABLE, "prior")
    mapped = simulator.mapped and scenario is None  # intrinsic beats alone
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
    """Prior simulations of a study with default parameters, or of one conduction state."""
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
    """Check and settle a heart, its folder, the number of networks to simulate, and the pool.

    `name` names the argument `count` in messages; its default is that of `fascicle.fit`.
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
