"""The conduction state of a patient: how probable each is, a study of each that is, their mixture.

Each state is a model of its own: what it blocks, and its ranges of what is learnt. A classifier of
the heart's simulated recordings says how probable each is. The most probable ones are fitted as
studies, which are kept in the folder of the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress
from fascicle.forward.model import Backend
from fascicle.inference.tempered_sampling import means_apart
from fascicle.study.conduction_states import ConductionState, states_of
from fascicle.study.ecg_classifier import classified_rows
from fascicle.study.fitted import FittedStudy
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.lock import study_lock
from fascicle.study.pool import Pool
from fascicle.study.population import Posterior, evenly_spread
from fascicle.study.posterior import RUNS
from fascicle.study.state_classifier import (
    StateSimulations,
    classifier_of,
    probabilities,
    simulations_of_states,
)
from fascicle.study.state_fit import (
    HEART,
    Inputs,
    begun,
    completed,
    fit_state,
    place_of_simulations,
    simulated_and_compared,
)
from fascicle.study.study import STATES, Study

COVERED = 0.9  # probability of the states that are fitted, together at least


def diagnosed(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
) -> FittedStudy:
    """Do what is left of a study that learns the conduction state, and write its results."""
    config, heart = inputs.config, inputs.heart
    states = states_of(config.states)
    simulator, recordings = simulated_and_compared(
        config, heart, inputs.rules, inputs.recordings, pool, progress, backend
    )
    with study_lock(folder):
        study = begun(inputs, folder, progress)
        place, count = place_of_simulations(heart, folder), config.prior_simulations
        of_all = replace(simulator, space=ParameterSpace(config.space))
        simulations, target = simulations_of_states(of_all, place, count), recordings[0].target
        rows = classified_rows(target)
        classifier = classifier_of(simulations, rows, place, count, simulator.pool, progress)
        probable = probabilities(classifier, simulations, config.states, target)
        fits: dict[str, FittedStudy] = {}
        emulated: dict[float, list[EmulatedLikelihood]] = {}
        for name in most_probable(probable):
            each = simulations[name]
            own, its = _of_state(each, inputs), folder / STATES / name.replace(" ", "-")
            # before the link, since a folder that holds something and no study is refused
            Study.create_or_resume(its, own.config)
            if not (its / HEART).exists():
                (its / HEART).symlink_to(Path("..", "..", HEART), target_is_directory=True)
            fits[name], emulated[each.state.number] = fit_state(
                own, its, progress, pool, backend, simulator.model
            )
        population = _mixture(states, probable, fits)
        simulator = replace(simulator, space=config.space_of(population.states), remembered={})
        fitted = FittedStudy(study, simulator, recordings, population)
        fitted = completed(fitted, emulated, progress)
        return replace(fitted, simulator=replace(simulator, remembered=None))


def most_probable(probable: Mapping[str, float]) -> list[str]:
    """The fewest states that are so probable together as `COVERED`."""
    ranked = sorted(probable, key=lambda name: -probable[name])
    before = np.cumsum([0.0, *(probable[name] for name in ranked)])
    return [name for name, others in zip(ranked, before, strict=False) if others < COVERED]


def _of_state(simulations: StateSimulations, inputs: Inputs) -> Inputs:
    """What the study of a state is of."""
    config = inputs.config
    changes = {
        "space": simulations.space.parameters,
        "fixed": config.fixed | simulations.state.blocks,
        "states": {},
        "prior_simulations": simulations.count,
    }
    return replace(inputs, config=config.model_copy(update=changes))


def _posterior(fitted: FittedStudy) -> Posterior:
    assert isinstance(fitted.population, Posterior)
    return fitted.population


def _mixture(
    states: Sequence[ConductionState],
    probable: Mapping[str, float],
    fits: Mapping[str, FittedStudy],
) -> Posterior:
    """Draws of the states that were fitted, of each as many as it is probable."""
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
    return Posterior(
        values,
        joined(lambda part: part.losses),
        best.best,
        best.best_loss,
        joined(lambda part: part.log_likelihoods),
        parts[int(shares.argmax())].log_evidences,
        1 / sum(share**2 / part.effective for share, part in zip(shares, parts, strict=True)),
        np.sum([part.evaluations for part in parts], axis=0),
        {name: float(means_apart(*np.split(column, RUNS))) for name, column in values.items()},
        all(part.converged for part in parts),
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
