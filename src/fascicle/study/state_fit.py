"""Fit a posterior, or the paper's population, of one conduction state."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from fascicle.core.array_cache import ArrayCache
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE
from fascicle.core.progress import Progress
from fascicle.core.quantities import torso_values
from fascicle.forward.activation_sequence import SequenceSummary
from fascicle.forward.beat import Beat
from fascicle.forward.compile_kernels import compile_kernels
from fascicle.forward.likelihood import Likelihood
from fascicle.forward.model import Backend, ForwardModel, usable
from fascicle.forward.preparation import share_prepared
from fascicle.forward.scenario import Scenario
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.agreement import agreement
from fascicle.study.ecg_emulator import EcgEmulator
from fascicle.study.fitted import FittedStudy
from fascicle.study.heart_emulator import emulator_of
from fascicle.study.likelihood import EmulatedLikelihood, checked
from fascicle.study.lock import study_lock
from fascicle.study.pool import Pool, Threads
from fascicle.study.predictive import Checks, predict_recording
from fascicle.study.recordings import Recorded, write_recordings
from fascicle.study.refined_emulator import refined_emulators
from fascicle.study.results import write_results
from fascicle.study.simulator import PointSimulator
from fascicle.study.study import MAY_CHANGE, Study, StudyConfig
from fascicle.study.target_comparison import TargetComparison, evaluate

HEART_FOLDER = "heart"  # in the study's folder
PREDICTION, REFINEMENT = 2, 3  # numbers of the random generators


@dataclass(frozen=True)
class Inputs:
    """Inputs of a study: heart, recordings, configuration, growth rules and likelihoods."""

    heart: Heart
    recordings: Sequence[Recorded]
    config: StudyConfig  # all that decides the outcome, with digests of the other inputs
    rules: GrowthRules
    likelihoods: Sequence[Likelihood] | None = None  # the user's, in place of those by emulators


# Likelihood of each recording, by the number of the conduction state
Emulated = Mapping[float, Sequence[EmulatedLikelihood]]


def fit_state(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
    model: ForwardModel | None = None,
) -> tuple[FittedStudy, list[EmulatedLikelihood]]:
    """Fit a study in its folder, from where it was interrupted, and write its results.

    `model` is the forward model of the heart and the rules, made here if it is None. A posterior
    comes with the likelihoods of its recordings; for the paper's method the list is empty.
    """
    heart, config = inputs.heart, inputs.config
    simulator, recordings = simulated_and_compared(
        config, heart, inputs.rules, inputs.recordings, pool, progress, backend, model
    )
    _check_scenarios(simulator, recordings)
    with study_lock(folder):
        study = begun(inputs, folder, progress)
        emulated: list[EmulatedLikelihood] = []
        if config.method == "posterior":
            recordings, emulated = _emulated(simulator, recordings, inputs, folder, progress)
            simulator = replace(simulator, remembered={})
        objective = partial(evaluate, simulator, recordings)
        population = study.run(objective, progress, emulated)
        share_prepared(heart, folder / HEART_FOLDER)
        fitted = FittedStudy(study, simulator, recordings, population)
        number = simulator.prior.fixed.get("conduction", 0.0)
        fitted = completed(fitted, {number: emulated}, progress)
        return replace(fitted, simulator=replace(simulator, remembered=None)), emulated


def begun(inputs: Inputs, folder: Path, progress: Progress | None) -> Study:
    """Create or resume a study in its folder, with copies of the heart and the recordings."""
    study = Study.create_or_resume(folder, inputs.config, progress)
    if not _holds(folder / HEART_FOLDER, inputs.heart):
        write_heart(inputs.heart, folder / HEART_FOLDER)
    write_recordings(folder, inputs.recordings)
    return study


def completed(fitted: FittedStudy, emulated: Emulated, progress: Progress | None) -> FittedStudy:
    """Simulate the networks, compare them with the recordings, and write the results."""
    networks, agreements, predictions = fitted.networks(progress), [], []
    network_states = [network.parameters.get("conduction", 0.0) for network in networks]
    rng = np.random.default_rng([fitted.study.config.seed, PREDICTION])
    for number, recording in enumerate(fitted.recordings):
        recorded_networks = networks if number == 0 else fitted.networks(progress, number)
        if fitted.of_the_paper:
            agreements.append(agreement(recording.target, recorded_networks))
        else:
            likelihoods = [emulated[state][number] for state in network_states]
            prediction = predict_recording(
                recording.target, [e.likelihood for e in likelihoods], recorded_networks, rng
            )
            checks = checked(prediction.checks, likelihoods, recorded_networks)
            if recording.scenario is None:
                surfaces = fitted.simulator.model.surfaces
                sequences = [surfaces.sequence(n.beat.activation) for n in recorded_networks]
                checks = replace(checks, sequence=SequenceSummary.of(sequences))
            predictions.append(replace(prediction, checks=checks))
            agreements.append(prediction.agreement)
    if predictions:
        checks = Checks.joined([prediction.checks for prediction in predictions])
        ecgs = tuple(prediction.ecg for prediction in predictions)
        gains, torsos = predictions[0].gains, predictions[0].torsos
        fitted = replace(fitted, checks=checks, gains=gains, torsos=torsos, ecgs=ecgs)
    (most_probable, _), *_ = Counter(network_states).most_common()
    reports = [dict(likelihood.emulator.report) for likelihood in emulated.get(most_probable, ())]
    write_results(fitted, networks, agreements, predictions, reports)
    return fitted


def _check_scenarios(simulator: PointSimulator, recordings: Sequence[TargetComparison]) -> None:
    """Refuse a scenario that does not fit the heart, by simulating one network of the prior."""
    for recording in recordings:
        if recording.scenario is None:
            continue
        for point in simulator.prior.sample(np.random.default_rng(0), 10):
            if isinstance(next(simulator.simulate([point], recording.scenario)), Beat):
                break


def _holds(folder: Path, heart: Heart) -> bool:
    """Whether a folder holds this heart, undamaged."""
    try:
        return load_heart(folder).digest == heart.digest
    except InputError:
        return False


def _emulated(
    simulator: PointSimulator,
    recordings: Sequence[TargetComparison],
    inputs: Inputs,
    folder: Path,
    progress: Progress | None,
) -> tuple[tuple[TargetComparison, ...], list[EmulatedLikelihood]]:
    """Return the recordings with their likelihoods, and the likelihoods by refined emulators."""
    config, scenarios = inputs.config, _scenarios(inputs.config, recordings)
    emulators = _emulators(simulator, scenarios, inputs, folder, progress)
    likelihoods_by = _likelihoods(simulator, recordings, inputs)
    if inputs.likelihoods is None:
        count, rng = config.prior_simulations, np.random.default_rng([config.seed, REFINEMENT])
        refine = partial(
            refined_emulators, emulators, likelihoods_by, scenarios, count, folder, rng, progress
        )
        emulators = _kept(folder, config, refine)
    emulated = likelihoods_by(emulators)
    pairs = zip(recordings, emulated, strict=True)
    return tuple(
        replace(recording, likelihood=emulated_likelihood.likelihood)
        for recording, emulated_likelihood in pairs
    ), emulated


def _scenarios(
    config: StudyConfig, recordings: Sequence[TargetComparison]
) -> list[tuple[Scenario, str] | None]:
    return [
        None if recording.scenario is None else (recording.scenario, digest)
        for recording, digest in zip(recordings, config.scenarios, strict=True)
    ]


def _likelihoods(
    simulator: PointSimulator, recordings: Sequence[TargetComparison], inputs: Inputs
) -> Callable[[Sequence[EcgEmulator]], list[EmulatedLikelihood]]:
    """Function that makes the likelihoods of the recordings from their emulators."""
    if inputs.likelihoods is None:
        return partial(
            EmulatedLikelihood.each,
            simulator=simulator,
            targets=[recording.target for recording in recordings],
            gain_sd=_gain_sd(inputs.config),
        )
    likelihoods = inputs.likelihoods
    return lambda emulators: [
        EmulatedLikelihood(simulator, *emulator_and_likelihood)
        for emulator_and_likelihood in zip(emulators, likelihoods, strict=True)
    ]


def place_of_simulations(heart: Heart, folder: Path) -> Path:
    """Folder to keep simulations in: the heart's if it is writable, else its copy's in a study."""
    writable = heart.folder is not None and os.access(heart.folder, os.W_OK)
    return heart.folder if writable and heart.folder is not None else folder / HEART_FOLDER


def _emulators(
    simulator: PointSimulator,
    scenarios: Sequence[tuple[Scenario, str] | None],
    inputs: Inputs,
    folder: Path,
    progress: Progress | None,
) -> list[EcgEmulator]:
    """Emulator of the prior for each recording, kept with the heart if its folder is writable."""
    count, place = inputs.config.prior_simulations, place_of_simulations(inputs.heart, folder)
    made: dict[str, EcgEmulator] = {}
    for scenario, digest in zip(scenarios, inputs.config.scenarios, strict=True):
        if digest not in made:
            made[digest] = emulator_of(simulator, count, place, progress, scenario)
    return [made[digest] for digest in inputs.config.scenarios]


def _kept(
    folder: Path, config: StudyConfig, refine: Callable[[], list[EcgEmulator]]
) -> list[EcgEmulator]:
    """Refined emulator of each recording, read from the folder of a study, or made and kept."""
    cache = ArrayCache(folder / DISPOSABLE, "refined")
    same = config.model_dump_json(exclude={*MAY_CHANGE})
    keys = [f"{number} of {same}" for number in range(len(config.scenarios))]
    if any(cache.read(key) is None for key in keys):
        for key, emulator in zip(keys, refine(), strict=True):
            cache.write(key, emulator.arrays())
    return [EcgEmulator.from_arrays(cache.read(key) or {}) for key in keys]


def _gain_sd(config: StudyConfig) -> float:
    """Prior SD of the gain about 1; 0 if the gain is itself a parameter."""
    is_parameter = "gain" in {*config.prior.names, *config.fixed}
    return 0.0 if is_parameter else config.gain_sd


def simulated_and_compared(
    config: StudyConfig,
    heart: Heart,
    rules: GrowthRules,
    recordings: Sequence[Recorded],
    pool: Pool | None,
    progress: Progress | None,
    backend: Backend | None = None,
    model: ForwardModel | None = None,
) -> tuple[PointSimulator, tuple[TargetComparison, ...]]:
    """Make a study's simulator and comparisons, slowly on a new machine or with a new heart.

    `model` is the forward model of the heart and the rules, made here if it is None.
    """
    if progress is not None:
        compile_kernels(progress)
    prior = config.prior
    model = model or ForwardModel(heart, rules=rules, progress=progress)
    names = [*prior.names, *prior.fixed]
    backend = usable(backend, model, [*names, *prior.averaged.space.names], recordings[0][1])
    if torso := torso_values(dict.fromkeys(names, 0.0)):
        model.torso([*torso])  # built here, not by every worker
    compared = tuple(
        TargetComparison(
            target.in_leads(heart.leads),
            scenario,
            free_gain=config.free_gain if config.method == "paper" else _gain_sd(config) > 0,
            independent_leads=config.leads == "8",
            fewest_junctions=config.fewest_junctions,
        )
        for target, scenario in recordings
    )
    pool = pool or Threads(config.workers)
    return PointSimulator(model, prior, pool, backend), compared
