"""Fit a population of networks to a target, and read a finished fit back."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from fascicle.core.array_cache import ArrayCache
from fascicle.core.errors import InputError
from fascicle.core.files import DISPOSABLE, as_path
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.quantities import torso_values
from fascicle.core.ranges import check_kind
from fascicle.forward.compile_kernels import compile_kernels
from fascicle.forward.likelihood import Likelihood, constants
from fascicle.forward.model import Backend, ForwardModel, usable
from fascicle.forward.preparation import share_prepared
from fascicle.forward.scenario import Scenario
from fascicle.forward.simulation import Simulation
from fascicle.heart.folder import as_heart, load_heart, write_heart
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.agreement import agreement
from fascicle.study.ecg_emulator import MODES, EcgEmulator
from fascicle.study.fitted import FittedStudy
from fascicle.study.heart_emulator import emulator_of
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.lock import refuse_held, study_lock
from fascicle.study.pool import Pool, Threads, check_pool
from fascicle.study.population import RESULT, read_checks, read_population
from fascicle.study.predictive import Checks, predict_recording
from fascicle.study.recordings import (
    Given,
    Recorded,
    digests,
    given_recordings,
    read_recordings,
    write_recordings,
)
from fascicle.study.refined_emulator import MOST, MOST_ROUNDS, refined_emulators
from fascicle.study.results import write_results
from fascicle.study.settings import FitSettings, checked_settings
from fascicle.study.simulator import PointSimulator
from fascicle.study.space import AveragedOver, growth_and_conduction, study_space
from fascicle.study.study import MAY_CHANGE, Study, StudyConfig, check_same, check_study_folder
from fascicle.study.target_comparison import TargetComparison, evaluate

GivenStudy = FittedStudy | Path | str  # a study, or its folder

HEART = "heart"  # in the study's folder
PREDICTION, REFINEMENT = 2, 3  # number the random generators


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
    """Learn the Purkinje networks that explain a target, or several of one heart.

    Started again on the same folder it resumes, and gives exactly the result of a run that was
    never interrupted. The numbers of steps and samples may then be others: what is stored is used
    again. So may that of workers.

    Parameters
    ----------
    heart : Heart or path
        The heart, its folder, or ``"default"``.
    target : Target or path, or list
        The target, or its netCDF file. If it was not recorded in an intrinsic beat, a tuple with
        the scenario, or its file: ``("rv.nc", "rv.toml")``. A list is of several recordings.
    out : path
        Folder of the study.
    parameters : mapping of name to value, optional
        Quantities of `fascicle.core.quantities.QUANTITIES` to learn or to fix otherwise than
        `method` says: a number fixes one, ``"free"`` frees it with its usual prior, a mapping with
        another one: ``{"prior": "log-normal", "median": 0.07, "sd": 0.2}``; keys are `prior`,
        `lower`, `upper`, `median`, `sd` (`fascicle.core.parameters.Parameter`).
    progress : Progress, "lines" or None
        Called with the stage, and how far it is; by default lines on standard error say so.
    pool : Pool, optional
        Where networks are simulated: on `workers` threads, if nothing else is given;
        `fascicle.ExecutorPool` takes any executor, `fascicle.Cluster` a Dask scheduler. The result
        is the same wherever.
    backend : Backend, optional
        What simulates intrinsic beats in place of the pool: a graphics card (`fascicle.GpuBackend`)
        changes the last digits of the result.
    likelihood : Likelihood, or sequence of them, optional
        Of a posterior: what the recording says of a network, one for each recording; the page
        "Extending fascicle" shows how to write one.
    rules : GrowthRules, optional
        By which trees grow, perhaps with a term of your own; to resume or read the study needs the
        same.
    **settings
        The fields of `fascicle.FitSettings`, where they are described. `method`, `seed`, `workers`,
        `fewest_junctions`; of the posterior `effective`, `prior_simulations`, `gain_sd`; of the
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
    checked = checked_settings(settings)
    check_pool(pool)
    check_kind(backend, (Backend, NoneType), "backend", "one such as fascicle.GpuBackend()")
    check_kind(parameters, (Mapping, NoneType), "parameters", "a dict of names to values")
    likelihoods = None
    if likelihood is not None:
        count = len(target) if isinstance(target, list) else 1
        likelihoods = _given_likelihoods(likelihood, count, checked.method)
    folder = as_path(out, "out")
    check_study_folder(folder)
    refuse_held(folder)
    with shown_progress(progress) as shown:
        inputs = read_inputs(heart, target, parameters or {}, checked, rules, likelihoods)
        return fit_inputs(inputs, folder, shown, pool, backend)


def _rules(given: GrowthRules | None) -> GrowthRules:
    check_kind(given, (GrowthRules, NoneType), "rules", "fascicle.GrowthRules")
    return given or GrowthRules()


def _given_likelihoods(
    given: Likelihood | Sequence[Likelihood], recordings: int, method: str
) -> Sequence[Likelihood]:
    """One likelihood for each recording."""
    each: list[Any] = [*given] if isinstance(given, (list, tuple)) else [given]
    for one in each:
        check_kind(one, Likelihood, "likelihood", "an object that has the methods of Likelihood")
    if method == "paper" or len(each) != recordings:
        raise InputError(
            f"{len(each)} likelihood(s) for {recordings} recording(s) by the method '{method}'; "
            "give one for each, to the method 'posterior'"
        )
    return each


@dataclass(frozen=True)
class Inputs:
    """What a study is of."""

    heart: Heart
    recordings: Sequence[Recorded]
    config: StudyConfig  # all that decides the outcome, with hashes of the others
    rules: GrowthRules
    likelihoods: Sequence[Likelihood] | None = None  # in place of those made of the prior


def read_inputs(
    heart: Heart | Path | str,
    target: Given | list[Given],
    parameters: Mapping[str, Any],
    settings: FitSettings,
    rules: GrowthRules | None = None,
    likelihoods: Sequence[Likelihood] | None = None,
) -> Inputs:
    """Read what `fit` is given, and settle what is learnt; it says what is what."""
    rules = _rules(rules)
    heart = as_heart(heart)
    recordings = given_recordings(target)
    if settings.method == "paper" and (len(recordings) > 1 or recordings[0][1] is not None):
        raise InputError(
            "the method 'paper' fits one recording of an intrinsic beat; give one without a "
            "scenario, or use the method 'posterior'"
        )
    space, fixed = study_space(settings.method, parameters, heart)
    if settings.free_gain and ("gain" in space.names or "gain" in fixed):
        raise InputError("the gain is a parameter already; leave --free-gain out")
    of_posterior: dict[str, Any] = {}
    if settings.method == "posterior":
        averaged = AveragedOver.of(space, fixed, heart)
        more = {"body_modes": MODES, "refining_networks": MOST, "refining_rounds": MOST_ROUNDS}
        named = {"name": ", ".join(type(one).__qualname__ for one in likelihoods or ())}
        of_posterior = {
            "likelihood": constants() | more if likelihoods is None else named,
            "averaged": averaged.space.parameters,
            "tissues": averaged.tissues,
        }
    config = StudyConfig(
        heart=heart.digest,
        **_hashes(recordings),
        space=space.parameters,
        fixed=fixed,
        **growth_and_conduction(heart, rules),
        **of_posterior,
        **settings.model_dump(),
    )
    return Inputs(heart, recordings, config, rules, likelihoods)


def fit_inputs(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
) -> FittedStudy:
    """Do what is left of a study in its folder, and write its results."""
    heart, config = inputs.heart, inputs.config
    simulator, recordings = _simulated_and_compared(
        config, heart, inputs.rules, inputs.recordings, pool, progress, backend
    )
    _check_scenarios(simulator, recordings)
    with study_lock(folder):
        study = Study.create_or_resume(folder, config, progress)
        if not _holds(folder / HEART, heart):
            write_heart(heart, folder / HEART)
        write_recordings(folder, inputs.recordings)
        emulated: list[EmulatedLikelihood] = []
        if config.method == "posterior":
            recordings, emulated = _emulated(simulator, recordings, inputs, folder, progress)
            simulator = replace(simulator, remembered={})
        objective = partial(evaluate, simulator, recordings)
        population = study.run(objective, progress, emulated)
        share_prepared(heart, folder / HEART)
        fitted = FittedStudy(study, simulator, recordings, population)
        fitted = _completed(fitted, emulated, progress)
        return replace(fitted, simulator=replace(simulator, remembered=None))


def _completed(
    fitted: FittedStudy, emulated: Sequence[EmulatedLikelihood], progress: Progress | None
) -> FittedStudy:
    """Simulate the networks, compare a posterior with the recording, and write the results."""
    networks, agreements, predictions = fitted.networks(progress), [], []
    rng = np.random.default_rng([fitted.study.config.seed, PREDICTION])
    for number, each in enumerate(fitted.recordings):
        its = networks if number == 0 else fitted.networks(progress, number)
        if each.likelihood is None:
            agreements.append(agreement(each.target, its))
        else:
            found = predict_recording(each.target, each.likelihood, its, rng)
            error = [emulated[number].error(its), emulated[number].emulator.expected_error]
            predictions.append(replace(found, checks=replace(found.checks, emulator=error)))
            agreements.append(found.agreement)
    if predictions:
        checks = Checks.joined([each.checks for each in predictions])
        ecgs = tuple(each.ecg for each in predictions)
        fitted = replace(fitted, checks=checks, gains=predictions[0].gains, ecgs=ecgs)
    reports = [dict(each.emulator.report) for each in emulated]
    write_results(fitted, networks, agreements, predictions, reports)
    return fitted


def _check_scenarios(simulator: PointSimulator, recordings: Sequence[TargetComparison]) -> None:
    """Refuse a scenario that does not fit the heart, with the first network of the prior."""
    for each in recordings:
        if each.scenario is None:
            continue
        for point in np.random.default_rng(0).random((10, simulator.dimension)):
            if isinstance(next(simulator.simulate([point], each.scenario)), Simulation):
                break


def _holds(folder: Path, heart: Heart) -> bool:
    """Whether a folder holds a heart, undamaged."""
    try:
        return load_heart(folder).digest == heart.digest
    except InputError:
        return False


def _hashes(recordings: Sequence[Recorded]) -> dict[str, Any]:
    """What a configuration says of the recordings."""
    targets, scenarios = zip(*map(digests, recordings), strict=True)
    return {"target": targets[0], "other_targets": targets[1:], "scenarios": scenarios}


def _emulated(
    simulator: PointSimulator,
    recordings: Sequence[TargetComparison],
    inputs: Inputs,
    folder: Path,
    progress: Progress | None,
) -> tuple[tuple[TargetComparison, ...], list[EmulatedLikelihood]]:
    """The recordings with their likelihoods, and these by emulators of the heart."""
    config = inputs.config
    scenarios = [
        None if each.scenario is None else (each.scenario, digest)
        for each, digest in zip(recordings, config.scenarios, strict=True)
    ]
    emulators = _emulators(simulator, scenarios, inputs, folder, progress)
    if inputs.likelihoods is not None:
        given = zip(emulators, inputs.likelihoods, strict=True)
        emulated = [EmulatedLikelihood(simulator, *each) for each in given]
    else:
        by = partial(
            EmulatedLikelihood.each,
            simulator=simulator,
            targets=[each.target for each in recordings],
            gain_sd=_gain_sd(config),
        )
        count, rng = config.prior_simulations, np.random.default_rng([config.seed, REFINEMENT])
        refine = partial(refined_emulators, emulators, by, scenarios, count, folder, rng, progress)
        emulated = by(_kept(folder, config, refine))
    pairs = zip(recordings, emulated, strict=True)
    return tuple(replace(one, likelihood=its.likelihood) for one, its in pairs), emulated


def _emulators(
    simulator: PointSimulator,
    scenarios: Sequence[tuple[Scenario, str] | None],
    inputs: Inputs,
    folder: Path,
    progress: Progress | None,
) -> list[EcgEmulator]:
    """Emulators of the prior for each recording, kept with the heart if its folder allows that."""
    given, count = inputs.heart.folder, inputs.config.prior_simulations
    place = given if given is not None and os.access(given, os.W_OK) else folder / HEART
    made: dict[str, EcgEmulator] = {}
    for scenario, digest in zip(scenarios, inputs.config.scenarios, strict=True):
        if digest not in made:
            made[digest] = emulator_of(simulator, count, place, progress, scenario)
    return [made[digest] for digest in inputs.config.scenarios]


def _kept(
    folder: Path, config: StudyConfig, refine: Callable[[], list[EcgEmulator]]
) -> list[EcgEmulator]:
    """Refined emulators of each recording, as they are kept in the folder of a study."""
    cache = ArrayCache(folder / DISPOSABLE, "refined")
    same = config.model_dump_json(exclude={*MAY_CHANGE})
    keys = [f"{number} of {same}" for number in range(len(config.scenarios))]
    if any(cache.read(key) is None for key in keys):
        for key, emulator in zip(keys, refine(), strict=True):
            cache.write(key, emulator.arrays())
    return [EcgEmulator.from_arrays(cache.read(key) or {}) for key in keys]


def _gain_sd(config: StudyConfig) -> float:
    """Prior SD of the gain about 1; 0 if the gain is itself a parameter."""
    is_parameter = "gain" in config.fixed or "gain" in config.parameter_space.names
    return 0.0 if is_parameter else config.gain_sd


def as_study(given: GivenStudy, progress: Progress | Lines | None = None) -> FittedStudy:
    """A study as it was given, or read from its folder by `load_study`."""
    if isinstance(given, FittedStudy):
        return given
    folder = as_path(given, "study", "a fitted study, or the path of its folder")
    return load_study(folder, progress)


def load_study(
    folder: Path | str,
    progress: Progress | Lines | None = "lines",
    pool: Pool | None = None,
    rules: GrowthRules | None = None,
) -> FittedStudy:
    """Read a finished study.

    Parameters
    ----------
    folder : path
        The study.
    progress : Progress, "lines" or None
        Called while a large heart is prepared; by default lines on standard error say so.
    pool : Pool, optional
        Where networks are simulated; by default as when it was fitted, on threads.
    rules : GrowthRules, optional
        Those of `fit`, if it was given any.

    Raises
    ------
    InputError
        If the folder is not a study, the study is not finished, or its forward model is not the
        present one.
    """
    check_pool(pool)
    rules, folder = _rules(rules), as_path(folder, "study")
    study = Study.open(folder)
    result = folder / RESULT[study.config.method]
    population = read_population(result)
    heart = load_heart(folder / HEART)
    recordings = read_recordings(folder, len(study.config.scenarios))
    same = all(getattr(study.config, k) == value for k, value in _hashes(recordings).items())
    for name, unchanged in ((HEART, heart.digest == study.config.heart), ("target.nc", same)):
        if not unchanged:
            raise InputError(
                f"{folder / name}: not the one that was fitted; put the original back, or fit again"
            )
    if not {*study.config.parameter_space.names} <= {*population.best}:
        raise InputError(
            f"{result}: its parameters are not those of the study; run 'fascicle fit' "
            "again to rewrite it"
        )
    now = study.config.model_copy(update=growth_and_conduction(heart, rules))
    check_same(folder, study.config, now)
    with shown_progress(progress) as shown:
        simulator, compared = _simulated_and_compared(
            study.config, heart, rules, recordings, pool, shown
        )
    study.check_objective(partial(evaluate, simulator, compared))
    return FittedStudy(study, simulator, compared, population, *read_checks(result))


def _simulated_and_compared(
    config: StudyConfig,
    heart: Heart,
    rules: GrowthRules,
    recordings: Sequence[Recorded],
    pool: Pool | None,
    progress: Progress | None,
    backend: Backend | None = None,
) -> tuple[PointSimulator, tuple[TargetComparison, ...]]:
    """A study's simulator and comparisons; takes a while on a new machine or with a new heart."""
    if progress is not None:
        compile_kernels(progress)
    space, fixed = config.parameter_space, config.fixed
    model = ForwardModel(heart, rules=rules, progress=progress)
    backend = usable(backend, model, [*space.names, *fixed], recordings[0][1])
    if torso := torso_values(dict.fromkeys((*space.names, *fixed), 0.0)):
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
    return PointSimulator(model, space, fixed, pool, config.averaged_over, backend), compared
