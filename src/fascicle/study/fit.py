"""Fit of a study, in the steps of simulation-based inference.

Networks of the prior are simulated, and an emulator of their ECGs is trained on them, and refined
near the posterior. The posterior is sampled by means of the emulator. Networks drawn from it are
simulated, and the ECGs that they predict are compared with the recording. The paper's method is
`fascicle.study.methods`.
"""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, ArrayCache, as_path
from fascicle.core.progress import Lines, Progress, WholeRun, shown_progress
from fascicle.core.ranges import check_kind
from fascicle.emulation.ecg_emulator import EcgEmulator
from fascicle.emulation.heart_emulator import emulator_of, refined_emulators, simulations_for
from fascicle.emulation.likelihood import RUNS, EmulatedLikelihood, checked
from fascicle.emulation.predictive import Checks, Prediction, predict_recording
from fascicle.emulation.recalibration import as_simulated
from fascicle.forward.activation_sequence import SequenceSummary
from fascicle.forward.likelihood import Likelihood
from fascicle.forward.model import Backend
from fascicle.forward.preparation import share_prepared
from fascicle.heart.folder import load_heart, write_heart
from fascicle.heart.heart import Heart
from fascicle.networks.agreement import Agreement, agreement
from fascicle.networks.prior import state_label
from fascicle.networks.settings import checked_settings
from fascicle.networks.simulator import BeatMemory
from fascicle.networks.target_comparison import Given, Network, write_recordings
from fascicle.pools.pool import Pool, check_pool
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.diagnosis import classified, mixture
from fascicle.study.fitted import FittedStudy, load_study
from fascicle.study.inputs import Inputs, InverseProblem, checked_likelihoods, read_inputs
from fascicle.study.population import Posterior
from fascicle.study.results import write_results
from fascicle.study.study import (
    Study,
    StudyConfig,
    StudyFile,
    check_study_folder,
    is_finished,
    study_lock,
)

# Stages of a posterior fit, with usual durations (s) on two cores: of all states, and of each
SHARED_STAGES = (
    ("lead fields in torsos", 45.0), ("preparation", 35.0), ("prior simulations", 180.0),
    ("training", 20.0),
)  # fmt: skip
STATE_STAGES = (
    ("training", 10.0), ("sampling", 10.0), ("posterior simulations", 15.0), ("training", 8.0),
    ("sampling", 8.0), ("networks", 6.0),
)  # fmt: skip
RESULTS = 8.0  # s, after the last stage

# Likelihoods of the recordings, in their order, by the number of the conduction state
Emulated = Mapping[float, Sequence[EmulatedLikelihood]]


def fit(
    heart: Heart | Path | str,
    target: Given | list[Given],
    out: Path | str,
    *,
    parameters: Mapping[str, Any] | None = None,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
    backend: Backend | None = None,
    likelihood: Likelihood | Sequence[Likelihood] | None = None,
    rules: GrowthRules | None = None,
    **settings: Any,
) -> FittedStudy:
    """Learn the Purkinje networks that explain a target, or several targets of one heart.

    Started again on the same folder, a fit resumes and gives exactly the result of a run that was
    never interrupted; a finished one is read. The numbers of steps, samples and workers may be
    changed in between: stored evaluations are used again.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    target : Target or path, or list
        The target, or its netCDF file. If the recorded beat is not intrinsic, a tuple of the
        target and its scenario, given as an object, by its name in the library, or by its file:
        ``("rv.nc", "rv-apical-pacing")``. A list holds several recordings.
    out : path
        Folder of the study.
    parameters : mapping of name to value, optional
        Quantities of `fascicle.core.quantities.QUANTITIES` to learn or to fix in another way than
        `method` does. A number fixes a quantity, ``"free"`` frees it with its usual prior,
        and a mapping such as ``{"prior": "log-normal", "median": 0.07, "sd": 0.2}`` frees it with
        that prior; keys are `prior`, `lower`, `upper`, `median`, `sd`
        (`fascicle.core.parameters.Parameter`).
    progress : Progress, "lines" or None
        Progress callback, called with the stage and how far it is; by default lines on standard
        error.
    pool : Pool, optional
        Where networks are simulated: by default on `workers` threads; `fascicle.ExecutorPool`
        takes any executor, `fascicle.Cluster` a Dask scheduler. The result does not depend on it.
    backend : Backend, optional
        Simulates intrinsic beats in place of the pool, as on a graphics card
        (`fascicle.GpuBackend`), which changes the last digits of the result.
    likelihood : Likelihood, or sequence of them, optional
        Your own likelihood of a network given the recording, one for each recording; by the method
        ``"posterior"`` alone. The page "Extending fascicle" shows how to write one.
    rules : GrowthRules, optional
        Rules by which trees grow, perhaps with a term of your own. Resuming or reading the study
        needs the same rules.
    **settings
        Fields of `fascicle.FitSettings`, which describes them: `method`, `seed`, `workers`,
        `fewest_junctions`; for a posterior `effective`, `prior_simulations`, `gain_sd`; for the
        paper's method `initial`, `steps`, `refit_every`, `samples`, `leads`, `free_gain`,
        `tolerance`, `draws`, `refit_after`, `rounds`.

    Returns
    -------
    FittedStudy

    Raises
    ------
    InputError
        If an input or a setting cannot be used, the folder holds another study, or another process
        works on it.

    Examples
    --------
    >>> import fascicle
    >>> fitted = fascicle.fit("HEART", "target.nc", "STUDY", effective=100)  # doctest: +SKIP
    >>> fitted.population.values["cv"].mean()  # doctest: +SKIP
    """
    check_pool(pool)
    check_kind(backend, (Backend, NoneType), "backend", "one such as fascicle.GpuBackend()")
    check_kind(parameters, (Mapping, NoneType), "parameters", "a dict of names to values")
    fit_settings = checked_settings(settings)
    likelihoods = None
    if likelihood is not None:
        count = len(target) if isinstance(target, list) else 1
        likelihoods = checked_likelihoods(likelihood, count, fit_settings.method)
    folder = as_path(out, "out")
    check_study_folder(folder)
    if (folder / StudyFile.LOCK).exists():
        with study_lock(folder):
            pass  # refused, before the inputs are read, if another process works on it
    with shown_progress(progress) as shown:
        inputs = read_inputs(heart, target, parameters or {}, fit_settings, rules, likelihoods)
        # a likelihood of the user's own may have changed
        if likelihoods is None and is_finished(folder, inputs.config):
            with study_lock(folder):
                begin(inputs, folder, shown)  # restores damaged copies of its inputs
            return load_study(folder, shown, pool, rules)
        return fit_inputs(inputs, folder, shown, pool, backend)


def fit_inputs(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
) -> FittedStudy:
    """Fit a study in its folder, from where it was interrupted, and write its results."""
    gc.collect()  # an earlier study and its statements hold each other, and gigabytes
    problem = InverseProblem.of(inputs, pool, progress, backend)
    run = None if progress is None else WholeRun(progress)
    if run is not None and (folder / StudyFile.CONFIGURATION).exists():
        run("resuming", 1, 1, "what is stored is not simulated again")
    if run is not None and inputs.config.method == "posterior":
        run.expect((*SHARED_STAGES, *STATE_STAGES), RESULTS)
    if inputs.config.states:
        fitted = fit_states(problem, folder, run)
    else:
        fitted, _ = fit_state(problem, folder, run)
    if run is not None:
        run.end()
    return fitted


def fit_state(
    problem: InverseProblem, folder: Path, progress: Progress | None
) -> tuple[FittedStudy, Sequence[EmulatedLikelihood]]:
    """Fit the networks of one conduction state, by the method ``"posterior"`` or ``"paper"``.

    Also returns the likelihoods of the recordings, which are empty for the paper's method.
    """
    problem.check_scenarios()
    with study_lock(folder):
        study = begin(problem.inputs, folder, progress)
        emulated: Sequence[EmulatedLikelihood] = ()
        if study.config.method == "posterior":
            emulators = simulate_and_train(problem, folder, progress)
            emulated = refine(problem, emulators, folder, progress)
            problem = problem.with_likelihoods(emulated).with_memory()
        population = study.run(problem.evaluate, progress, emulated)  # samples, simulates draws
        share_prepared(problem.inputs.heart, folder / StudyFile.HEART)
        fitted = FittedStudy(study, problem.simulator, problem.recordings, population)
        state_number = problem.simulator.prior.fixed.get("conduction", 0.0)  # 0: the default
        return check_and_write(fitted, {state_number: emulated}, progress), emulated


def fit_states(problem: InverseProblem, folder: Path, run: WholeRun | None) -> FittedStudy:
    """Fit a mixture of the probable conduction states.

    A classifier, trained on simulated recordings of the heart, gives the probability of each state.
    The most probable states are fitted one by one, each with its blocks and its ranges of the
    learnt quantities, as studies in subfolders of the study's folder.
    """
    with study_lock(folder):
        study = begin(problem.inputs, folder, run)
        diagnosis = classified(problem, _simulations_folder(problem, folder), run)
        problem = problem.with_memory()  # of all states
        shares = diagnosis.shares
        draws_per_run = -(-problem.config.effective // RUNS)  # rounded up
        counts = diagnosis.apportioned(draws_per_run)
        posteriors: list[tuple[Posterior, int]] = []
        emulated: dict[float, Sequence[EmulatedLikelihood]] = {}
        for (name, share), draws in zip(shares.items(), counts, strict=True):
            if run is not None:
                others = len(shares) - len(posteriors) - 1
                afterwards = others * sum(seconds for _, seconds in STATE_STAGES) + RESULTS
                probability = as_simulated(diagnosis.probable)[name]
                message = f"{state_label(name, ())}, probability {probability:.2f}"
                run.expect(STATE_STAGES, afterwards, message)
            state, count = diagnosis.simulations[name].state, diagnosis.simulations[name].count
            # 20: the least effective sample size that a study may have
            state_problem = problem.narrowed(
                state, prior_simulations=count, share=share, effective=max(RUNS * draws, 20)
            )
            state_folder = folder / StudyFile.STATES / name.replace(" ", "-")
            # before the link to the heart: a folder with a link, but no study, would be refused
            Study.create_or_resume(state_folder, state_problem.config)
            if not (state_folder / StudyFile.HEART).exists():  # shared by all states
                heart = Path("..", "..", StudyFile.HEART)
                (state_folder / StudyFile.HEART).symlink_to(heart, target_is_directory=True)
            fitted, emulated[state.number] = fit_state(state_problem, state_folder, run)
            assert isinstance(fitted.population, Posterior)
            posteriors.append((fitted.population.in_state(state.number), draws))
        population = mixture(posteriors, diagnosis, problem.config.effective)
        problem = problem.with_states(diagnosis.probable)
        fitted = FittedStudy(study, problem.simulator, problem.recordings, population)
        return check_and_write(fitted, emulated, run)


def begin(inputs: Inputs, folder: Path, progress: Progress | None) -> Study:
    """Create or resume a study in its folder, with copies of the heart and the recordings."""
    study = Study.create_or_resume(folder, inputs.config, progress)
    heart_folder = folder / StudyFile.HEART
    try:
        stored = load_heart(heart_folder).digest
    except InputError:  # the copy is missing or damaged
        stored = ""
    if stored != inputs.heart.digest:
        write_heart(inputs.heart, heart_folder)
    write_recordings(folder, inputs.recordings)
    return study


def simulate_and_train(
    problem: InverseProblem, folder: Path, progress: Progress | None
) -> list[EcgEmulator]:
    """Emulators of the ECGs of the prior's networks, one for each recording.

    Emulators of the package or in the heart's folder are used again. To train another, networks of
    the prior are simulated in the scenario of the recording, unless they are stored.
    """
    cache_folder, count = _simulations_folder(problem, folder), problem.config.prior_simulations
    simulator = problem.simulator
    trained: dict[str, EcgEmulator] = {}
    for scenario in problem.scenarios:
        if repr(scenario) not in trained:
            simulations = simulations_for(simulator.model, simulator.prior, cache_folder, scenario)
            trained[repr(scenario)] = emulator_of(simulations, count, simulator.pool, progress)
    return [trained[repr(scenario)] for scenario in problem.scenarios]


def refine(
    problem: InverseProblem,
    emulators: Sequence[EcgEmulator],
    folder: Path,
    progress: Progress | None,
) -> list[EmulatedLikelihood]:
    """Likelihoods of the recordings by emulators that are refined near the posterior.

    Refined emulators are kept in the study's folder. Emulators are not refined if the user gives
    the likelihood, or the heart is an atlas: simulations would be too few for each of its hearts.
    """
    if problem.inputs.likelihoods is not None or problem.inputs.heart.atlas is not None:
        return problem.likelihoods(emulators)
    config, cache = problem.config, ArrayCache(folder / DISPOSABLE, "refined")
    configuration = config.model_dump_json(exclude={*StudyConfig.may_change})
    keys = [f"{number} of {configuration}" for number in range(len(config.scenarios))]
    if any(cache.read(key) is None for key in keys):
        refined = refined_emulators(
            emulators,
            problem.likelihoods,
            problem.scenarios,
            config.prior_simulations,
            folder,
            np.random.default_rng([config.seed, 3]),  # 3: random numbers of the refinement
            progress,
        )
        for key, emulator in zip(keys, refined, strict=True):
            cache.write(key, emulator.arrays())
    return problem.likelihoods([EcgEmulator.from_arrays(cache.read(key) or {}) for key in keys])


def check_and_write(
    fitted: FittedStudy, emulated: Emulated, progress: Progress | None
) -> FittedStudy:
    """Simulate the networks, compare them with the recordings, and write the results.

    The beats that the fit has kept in memory are released.
    """
    networks = fitted.networks(progress)
    agreements: list[Agreement] = []
    predictions: list[Prediction] = []
    rng = np.random.default_rng([fitted.study.config.seed, 2])  # 2: numbers of the predictions
    for number, recording in enumerate(fitted.recordings):
        simulated = networks if number == 0 else fitted.networks(progress, number)
        if fitted.of_the_paper:
            agreements.append(agreement(recording.target, simulated))
        else:
            predictions.append(_predict(fitted, number, simulated, emulated, rng))
            agreements.append(predictions[-1].agreement)
    if predictions:
        fitted = replace(
            fitted,
            checks=Checks.joined([prediction.checks for prediction in predictions]),
            gains=predictions[0].gains,
            torsos=predictions[0].torsos,
            ecgs=tuple(prediction.ecg for prediction in predictions),
        )
    states = Counter(network.parameters.get("conduction", 0.0) for network in networks)
    (most_probable, _), *_ = states.most_common()
    reports = [dict(likelihood.emulator.report) for likelihood in emulated.get(most_probable, ())]
    write_results(fitted, networks, agreements, predictions, reports)
    return replace(fitted, simulator=replace(fitted.simulator, memory=BeatMemory()))


def _predict(
    fitted: FittedStudy,
    number: int,
    networks: Sequence[Network],
    emulated: Emulated,
    rng: np.random.Generator,
) -> Prediction:
    """Recordings predicted by the networks, compared with a recording by checks of the fit."""
    recording = fitted.recordings[number]
    likelihoods = [emulated[n.parameters.get("conduction", 0.0)][number] for n in networks]
    prediction = predict_recording(
        recording.target, [e.likelihood for e in likelihoods], networks, rng
    )
    checks = checked(prediction.checks, likelihoods, networks)
    if recording.scenario is None:
        surfaces = fitted.simulator.model.surfaces
        sequences = [surfaces.sequence(network.beat.activation) for network in networks]
        checks = replace(checks, sequence=SequenceSummary.of(sequences))
    return replace(prediction, checks=checks)


def _simulations_folder(problem: InverseProblem, folder: Path) -> Path:
    """Folder for prior simulations: the heart's if it is writable, else its copy in the study."""
    original = problem.inputs.heart.folder
    if original is not None and os.access(original, os.W_OK):
        return original
    return folder / StudyFile.HEART
