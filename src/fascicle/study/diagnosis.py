"""The conduction state of a patient: a study of each that comes into question, and their mixture.

Each state is a model of its own: what it blocks, and its ranges of what is learnt. Its evidence,
times how probable it was before, is how probable it is given the ECG. The evidence by the emulator
of the prior says which states come into question; each of these is fitted as a study, which is kept
in the folder of the whole, and its evidence is then that of its refined emulator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import logsumexp

from fascicle.core.array_cache import ArrayCache
from fascicle.core.arrays import Floats
from fascicle.core.files import DISPOSABLE
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress
from fascicle.core.threads import one_thread
from fascicle.forward.model import Backend
from fascicle.inference.tempered_sampling import means_apart
from fascicle.study.conduction_states import ConductionState, states_of
from fascicle.study.fitted import FittedStudy
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.lock import study_lock
from fascicle.study.pool import Pool
from fascicle.study.population import Posterior, evenly_spread
from fascicle.study.posterior import RUNS, sampled
from fascicle.study.refined_emulator import PARTICLES
from fascicle.study.simulator import PointSimulator
from fascicle.study.state_fit import (
    HEART,
    Inputs,
    begun,
    completed,
    emulated_by_the_prior,
    fit_state,
    simulated_and_compared,
)
from fascicle.study.study import MAY_CHANGE, STATES, Study
from fascicle.study.target_comparison import TargetComparison

LEAST = 0.005  # probability from which on a state comes into question
NEGLIGIBLE = 0.05  # and up to which its own study need not converge
STATES_APART = 0.2  # of the probabilities of a state by both runs; more, and they do not agree
PILOT = 4  # numbers the random generators


def diagnosed(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
) -> FittedStudy:
    """Do what is left of a study that learns the conduction state, and write its results."""
    config, states = inputs.config, states_of(inputs.config.states)
    simulator, recordings = simulated_and_compared(
        config, inputs.heart, inputs.rules, inputs.recordings, pool, progress, backend
    )
    with study_lock(folder):
        study = begun(inputs, folder, progress)
        own = {state.name: _of_state(state, inputs) for state in states}
        pilots: dict[str, Floats] = {}
        for number, (name, given) in enumerate(own.items(), 1):
            if progress is not None:
                progress("conduction states", number, len(own), name)
            pilots[name] = _pilot(given, folder, simulator, recordings, progress)
        fits: dict[str, FittedStudy] = {}
        emulated: dict[float, list[EmulatedLikelihood]] = {}
        while (state := _in_question(states, pilots, fits)) is not None:
            its = folder / STATES / state.name.replace(" ", "-")
            # before the link, since a folder that holds something and no study is refused
            Study.create_or_resume(its, own[state.name].config)
            if not (its / HEART).exists():
                (its / HEART).symlink_to(Path("..", "..", HEART), target_is_directory=True)
            fits[state.name], emulated[state.number] = fit_state(
                own[state.name], its, progress, pool, backend, simulator.model
            )
        population = _mixture(states, _log_evidences(pilots, fits), fits)
        simulator = replace(simulator, space=config.space_of(population.states), remembered={})
        fitted = FittedStudy(study, simulator, recordings, population)
        fitted = completed(fitted, emulated, progress)
        return replace(fitted, simulator=replace(simulator, remembered=None))


def probabilities(
    states: Sequence[ConductionState], log_evidences: Mapping[str, Floats]
) -> dict[str, float]:
    """How probable each state is, given the evidences of its runs."""
    logs = np.array([_log_weight(each, log_evidences[each.name]) for each in states])
    found = np.exp(logs - logsumexp(logs))
    return {state.name: float(p) for state, p in zip(states, found, strict=True)}


def _log_weight(state: ConductionState, log_evidences: Floats) -> float:
    """Logarithm of prior times mean evidence, of a state."""
    mean = logsumexp(log_evidences) - np.log(len(log_evidences))
    return float(np.log(state.probability) + mean)


def _log_evidences(
    pilots: Mapping[str, Floats], fits: Mapping[str, FittedStudy]
) -> dict[str, Floats]:
    """Log-evidences (runs,) of all states, by name.

    A refined emulator has another evidence than that of the prior, by several units, and mostly a
    larger one. States that are not fitted are taken to change by as much as those that are.
    """
    found = {name: _posterior(fit).log_evidences for name, fit in fits.items()}
    changes = [logs.mean() - pilots[name].mean() for name, logs in found.items()]
    change = float(np.mean(changes)) if changes else 0.0
    return {name: found.get(name, pilot + change) for name, pilot in pilots.items()}


def _in_question(
    states: Sequence[ConductionState], pilots: Mapping[str, Floats], fits: Mapping[str, FittedStudy]
) -> ConductionState | None:
    """The most probable state that is to be fitted yet."""
    found = probabilities(states, _log_evidences(pilots, fits))
    left = [each for each in states if each.name not in fits and found[each.name] > LEAST]
    return max(left, key=lambda state: found[state.name], default=None)


def _of_state(state: ConductionState, inputs: Inputs) -> Inputs:
    """What the study of a state is of."""
    config = inputs.config
    space = state.narrowed(ParameterSpace(config.space), config.fixed)
    assert space is not None
    changes = {"space": space.parameters, "fixed": config.fixed | state.blocks, "states": {}}
    return replace(inputs, config=config.model_copy(update=changes))


def _pilot(
    inputs: Inputs,
    folder: Path,
    simulator: PointSimulator,
    recordings: Sequence[TargetComparison],
    progress: Progress | None,
) -> Floats:
    """Log-evidences of a state by the emulators of the prior, kept in the folder of the whole."""
    config, cache = inputs.config, ArrayCache(folder / DISPOSABLE, "pilot")
    key = config.model_dump_json(exclude={*MAY_CHANGE})
    if (kept := cache.read(key)) is not None:
        return np.asarray(kept["log_evidences"])
    simulator = replace(simulator, space=config.parameter_space, fixed=config.fixed)
    emulated = emulated_by_the_prior(inputs, folder, simulator, recordings, progress)
    rngs = np.random.default_rng([config.seed, PILOT]).spawn(RUNS)
    said = f"{RUNS} runs of {PARTICLES}, to see which states come into question"
    sample = one_thread(sampled)
    runs = sample(emulated, simulator.dimension, rngs, PARTICLES, said, progress)
    found = np.array([run.log_evidence for run in runs])
    cache.write(key, {"log_evidences": found})
    return found


def _posterior(fitted: FittedStudy) -> Posterior:
    assert isinstance(fitted.population, Posterior)
    return fitted.population


def _mixture(
    states: Sequence[ConductionState],
    log_evidences: Mapping[str, Floats],
    fits: Mapping[str, FittedStudy],
) -> Posterior:
    """Draws of all states, of each as many as it is probable."""
    probable = probabilities(states, log_evidences)
    fitted = [state for state in states if state.name in fits]
    parts = [_named(state, fits[state.name]) for state in fitted]
    shares = np.array([probable[state.name] for state in fitted])
    shares /= shares.sum()
    each = len(parts[0]) // RUNS
    spread = [evenly_spread(each, count) for count in _apportioned(shares, each)]
    # run by run, since each is a chain
    chosen = [
        (part, run * each + np.array(numbers, int))
        for run in range(RUNS)
        for part, numbers in zip(parts, spread, strict=True)
    ]

    def joined(of: Callable[[Posterior], Floats]) -> Floats:
        return np.concatenate([of(part)[numbers] for part, numbers in chosen])

    def of_part(name: str, part: Posterior) -> Floats:
        return np.asarray({**part.averaged, **part.values}.get(name, np.full(len(part), np.nan)))

    values = {name: joined(partial(of_part, name)) for name in parts[0].values}
    others = sorted({name for part in parts for name in part.averaged})
    best = min(parts, key=lambda part: part.best_loss)
    runs = [{name: logs[k : k + 1] for name, logs in log_evidences.items()} for k in range(RUNS)]
    by_run = [np.array([*probabilities(states, logs).values()]) for logs in runs]
    matter = [part for part, share in zip(parts, shares, strict=True) if share > NEGLIGIBLE]
    agree = float(np.abs(by_run[0] - by_run[1]).max()) <= STATES_APART
    return Posterior(
        values,
        joined(lambda part: part.losses),
        best.best,
        best.best_loss,
        joined(lambda part: part.log_likelihoods),
        np.array([logsumexp([_log_weight(s, logs[s.name]) for s in states]) for logs in runs]),
        1 / sum(share**2 / part.effective for share, part in zip(shares, parts, strict=True)),
        np.sum([part.evaluations for part in parts], axis=0),
        {name: float(means_apart(*np.split(column, RUNS))) for name, column in values.items()},
        agree and all(part.converged for part in matter),
        {name: joined(partial(of_part, name)) for name in others},
        states=probable,
    )


def _named(state: ConductionState, fitted: FittedStudy) -> Posterior:
    """The posterior of a state, whose networks say that they are of it."""
    found = _posterior(fitted)
    return replace(
        found,
        averaged={**found.averaged, "conduction": np.full(len(found), state.number)},
        best={**found.best, "conduction": state.number},
    )


def _apportioned(shares: Floats, count: int) -> list[int]:
    """Whole numbers in proportion to shares, which add up to a count (largest remainders)."""
    exact = count * shares
    whole = np.floor(exact).astype(int)
    whole[np.argsort(whole - exact)[: count - whole.sum()]] += 1
    return [int(n) for n in whole]
