"""Fit a population of networks to a target, and read a finished fit back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any

from fascicle.core.errors import InputError
from fascicle.core.files import as_path
from fascicle.core.parameters import FREE
from fascicle.core.progress import Lines, Progress, shown_progress
from fascicle.core.quantities import DELAY
from fascicle.core.ranges import check_kind
from fascicle.forward.likelihood import Likelihood, constants
from fascicle.forward.model import Backend
from fascicle.heart.folder import as_heart, load_heart
from fascicle.heart.heart import Heart
from fascicle.purkinje.growth import GrowthRules
from fascicle.study.conduction_states import ConductionState
from fascicle.study.diagnosis import diagnosed
from fascicle.study.ecg_emulator import TORSO_MODES
from fascicle.study.fitted import FittedStudy
from fascicle.study.lock import refuse_held
from fascicle.study.pool import Pool, check_pool
from fascicle.study.population import RESULT, Posterior, read_checks, read_population
from fascicle.study.prior import Prior, growth_and_conduction
from fascicle.study.recordings import Given, Recorded, digests, given_recordings, read_recordings
from fascicle.study.refined_emulator import MOST_ROUNDS, REFINING_NETWORKS
from fascicle.study.settings import FitSettings, checked_settings
from fascicle.study.state_fit import HEART_FOLDER, Inputs, fit_state, simulated_and_compared
from fascicle.study.study import Study, StudyConfig, check_same, check_study_folder
from fascicle.study.target_comparison import evaluate

GivenStudy = FittedStudy | Path | str  # a study, or the path of its folder


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
    never interrupted. The numbers of steps, samples and workers may be changed in between: stored
    evaluations are used again.

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


def _priors(states: Sequence[ConductionState]) -> dict[str, float]:
    """Prior probabilities of conduction states, scaled to add up to 1.

    Those that add up to 1 already but for rounding are not changed in the last digit.
    """
    total = sum(state.probability for state in states)
    total = 1.0 if math.isclose(total, 1.0) else total
    return {state.name: state.probability / total for state in states}


def fit_inputs(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
) -> FittedStudy:
    """Fit a study in its folder, from where it was interrupted, and write its results."""
    if inputs.config.states:
        return diagnosed(inputs, folder, progress, pool, backend)
    return fit_state(inputs, folder, progress, pool, backend)[0]


def _rules(rules: GrowthRules | None) -> GrowthRules:
    check_kind(rules, (GrowthRules, NoneType), "rules", "fascicle.GrowthRules")
    return rules or GrowthRules()


def _given_likelihoods(
    likelihood: Likelihood | Sequence[Likelihood], count: int, method: str
) -> Sequence[Likelihood]:
    """Check and list a user's likelihoods, which must be as many as the recordings."""
    likelihoods: list[Any] = (
        [*likelihood] if isinstance(likelihood, (list, tuple)) else [likelihood]
    )
    for candidate in likelihoods:
        check_kind(
            candidate, Likelihood, "likelihood", "an object that has the methods of Likelihood"
        )
    if method == "paper" or len(likelihoods) != count:
        raise InputError(
            f"{len(likelihoods)} likelihood(s) for {count} recording(s) by the method '{method}'; "
            "give one for each, to the method 'posterior'"
        )
    return likelihoods


def read_inputs(
    heart: Heart | Path | str,
    target: Given | list[Given],
    parameters: Mapping[str, Any],
    settings: FitSettings,
    rules: GrowthRules | None = None,
    likelihoods: Sequence[Likelihood] | None = None,
) -> Inputs:
    """Read the arguments of `fit`, and settle which quantities are learnt and which are fixed."""
    rules = _rules(rules)
    heart = as_heart(heart)
    recordings = given_recordings(target)
    if settings.method == "paper" and (len(recordings) > 1 or recordings[0][1] is not None):
        raise InputError(
            "the method 'paper' fits one recording of an intrinsic beat; give one without a "
            "scenario, or use the method 'posterior'"
        )
    choices, one_intrinsic_beat = {**parameters}, len(recordings) == 1 and recordings[0][1] is None
    # the conduction state is learnt by default, unless delays are given, which it would change
    learnt = settings.method == "posterior" and one_intrinsic_beat and likelihoods is None
    learnt &= recordings[0][0].earliest_onset is None  # a paced beat shows no conduction state
    conduction = choices.pop("conduction", FREE if learnt and not {*DELAY} & {*choices} else None)
    prior = Prior.of(settings.method, choices, heart)
    states = () if conduction is None else _states(conduction, prior, heart, settings)
    if len(states) > 1 and not one_intrinsic_beat:
        raise InputError(
            "parameter 'conduction': it is learnt from one recording of an intrinsic beat; give "
            "one without a scenario, or fix the state"
        )
    if len(states) == 1:
        prior = prior.narrowed(states[0])
    elif states:
        prior = replace(prior, states=_priors(states))
    if settings.free_gain and "gain" in {*prior.names, *prior.fixed}:
        raise InputError("the gain is a parameter already; leave --free-gain out")
    described: dict[str, float | str] = {}
    if settings.method == "posterior":
        constants_of_emulator = {
            "body_modes": TORSO_MODES,
            "refining_networks": REFINING_NETWORKS,
            "refining_rounds": MOST_ROUNDS,
        }
        names = ", ".join(type(likelihood).__qualname__ for likelihood in likelihoods or ())
        described = {"name": names} if names else constants() | constants_of_emulator
    config = StudyConfig(
        heart=heart.digest,
        **_hashes(recordings),
        space=prior.space.parameters,
        fixed=prior.fixed,
        states=prior.states,
        mapped=prior.mapped,
        averaged=prior.averaged.space.parameters,
        tissues=prior.averaged.tissues,
        likelihood=described,
        **growth_and_conduction(heart, rules),
        **settings.model_dump(),
    )
    return Inputs(heart, recordings, config, rules, likelihoods)


def _states(
    conduction: Any, prior: Prior, heart: Heart, settings: FitSettings
) -> tuple[ConductionState, ...]:
    """Conduction states that the user chose and that the other parameters do not exclude."""
    if settings.method == "paper":
        raise InputError(
            "parameter 'conduction': the method 'paper' knows no conduction states; leave it "
            "out, or use the method 'posterior'"
        )
    return prior.possible_states(conduction, heart)


def _hashes(recordings: Sequence[Recorded]) -> dict[str, Any]:
    """Digests of the recordings, by the field of the study's configuration."""
    targets, scenarios = zip(*map(digests, recordings), strict=True)
    return {"target": targets[0], "other_targets": targets[1:], "scenarios": scenarios}


def as_study(given: GivenStudy, progress: Progress | Lines | None = None) -> FittedStudy:
    """Return a fitted study as it is, or read it from its folder by `load_study`."""
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
        Folder of the study.
    progress : Progress, "lines" or None
        Progress callback, called while a large heart is prepared; by default lines on standard
        error.
    pool : Pool, optional
        Where networks are simulated; by default on as many threads as the fit used.
    rules : GrowthRules, optional
        Growth rules that `fit` was given, if any.

    Raises
    ------
    InputError
        If the folder is not a study, the study is not finished, or it was made with another
        version of the forward model.
    """
    check_pool(pool)
    rules, folder = _rules(rules), as_path(folder, "study")
    study = Study.open(folder)
    result = folder / RESULT[study.config.method]
    population = read_population(result)
    heart = load_heart(folder / HEART_FOLDER)
    recordings = read_recordings(folder, len(study.config.scenarios))
    same = all(getattr(study.config, k) == value for k, value in _hashes(recordings).items())
    for name, unchanged in (
        (HEART_FOLDER, heart.digest == study.config.heart),
        ("target.nc", same),
    ):
        if not unchanged:
            raise InputError(
                f"{folder / name}: not the one that was fitted; put the original back, or fit again"
            )
    if not {*study.config.prior.names} <= {*population.best}:
        raise InputError(
            f"{result}: its parameters are not those of the study; run 'fascicle fit' "
            "again to rewrite it"
        )
    now = study.config.model_copy(update=growth_and_conduction(heart, rules))
    check_same(folder, study.config, now)
    with shown_progress(progress) as shown:
        simulator, compared = simulated_and_compared(
            study.config, heart, rules, recordings, pool, shown
        )
    study.check_objective(partial(evaluate, simulator, compared))
    if isinstance(population, Posterior):  # compared with the prior of its states
        prior = replace(simulator.prior, states=population.states)
        simulator = replace(simulator, prior=prior)
    return FittedStudy(study, simulator, compared, population, *read_checks(result))
