"""Fit that learns the conduction state: a classifier, a study of each probable state, a mixture.

Each conduction state is a model of its own, with its blocks and its ranges of the quantities that
are learnt. A classifier of the heart's simulated recordings gives the probability of each state.
The most probable states are fitted as studies of their own, in folders within that of the whole
study, and their posteriors are mixed by these probabilities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.progress import Progress, stage_progress
from fascicle.forward.model import Backend
from fascicle.inference.tempered_sampling import RunAgreement
from fascicle.study.conduction_states import ConductionState
from fascicle.study.ecg_classifier import classified_rows
from fascicle.study.fitted import FittedStudy
from fascicle.study.likelihood import EmulatedLikelihood
from fascicle.study.lock import study_lock
from fascicle.study.pool import Pool
from fascicle.study.population import Posterior, evenly_spread
from fascicle.study.posterior import RUNS
from fascicle.study.state_classifier import (
    classifier_of,
    probabilities,
    simulations_of_states,
    unlike,
)
from fascicle.study.state_fit import (
    HEART_FOLDER,
    Inputs,
    begun,
    completed,
    fit_state,
    place_of_simulations,
    simulated_and_compared,
)
from fascicle.study.study import STATES_FOLDER, Study

COVERED = 0.9  # least total probability of the states that are fitted


def diagnosed(
    inputs: Inputs,
    folder: Path,
    progress: Progress | None = None,
    pool: Pool | None = None,
    backend: Backend | None = None,
) -> FittedStudy:
    """Fit a study that learns the conduction state, from where it stopped; write its results."""
    config, heart = inputs.config, inputs.heart
    simulator, recordings = simulated_and_compared(
        config, heart, inputs.rules, inputs.recordings, pool, progress, backend
    )
    with study_lock(folder):
        study = begun(inputs, folder, progress)
        place, count = place_of_simulations(heart, folder), config.prior_simulations
        simulations = simulations_of_states(simulator.model, config.prior, place, count)
        target = recordings[0].target
        rows = classified_rows(target)
        classifier = classifier_of(simulations, rows, place, count, simulator.pool, progress)
        probable = probabilities(classifier, simulations, config.states, target)
        shares = most_probable(probable)
        counts = _apportioned(np.array([*shares.values()]), -(-config.effective // RUNS))
        parts: list[tuple[Posterior, int]] = []
        emulated: dict[float, list[EmulatedLikelihood]] = {}
        stage = "conduction states"
        for (name, share), draws in zip(shares.items(), counts, strict=True):
            message = f"{name}, probability {probable[name]:.2f}"
            stage_progress(progress, stage, message)(len(parts), len(shares))
            state, state_folder = (
                simulations[name].state,
                folder / STATES_FOLDER / name.replace(" ", "-"),
            )
            state_inputs = _of_state(
                state,
                inputs,
                prior_simulations=simulations[name].count,
                share=share,
                effective=max(RUNS * draws, 20),
            )
            # before the link to the heart, since a folder that is not empty and no study is refused
            Study.create_or_resume(state_folder, state_inputs.config)
            if not (state_folder / HEART_FOLDER).exists():
                (state_folder / HEART_FOLDER).symlink_to(
                    Path("..", "..", HEART_FOLDER), target_is_directory=True
                )
            fitted, emulated[state.number] = fit_state(
                state_inputs, state_folder, progress, pool, backend, simulator.model
            )
            parts.append((_named(state, fitted), draws))
        stage_progress(progress, stage)(len(shares), len(shares))
        population = _mixture(parts, [*shares.values()], config.effective)
        population = replace(population, states=probable, unnamed=unlike(classifier, target))
        prior = replace(config.prior, states=probable)
        simulator = replace(simulator, prior=prior, remembered={})
        fitted = FittedStudy(study, simulator, recordings, population)
        fitted = completed(fitted, emulated, progress)
        return replace(fitted, simulator=replace(simulator, remembered=None))


def most_probable(probable: Mapping[str, float]) -> dict[str, float]:
    """Fewest states whose probabilities add up to `COVERED`, with their shares of the draws."""
    ranked = sorted(probable, key=lambda name: -probable[name])
    before = np.cumsum([0.0, *(probable[name] for name in ranked)])
    kept = [name for name, covered in zip(ranked, before, strict=False) if covered < COVERED]
    total = sum(probable[name] for name in kept)
    return {name: probable[name] / total for name in kept}


def _of_state(state: ConductionState, inputs: Inputs, **numbers: float) -> Inputs:
    """Inputs of the study of one conduction state."""
    prior = inputs.config.prior.narrowed(state)
    changes = {
        "space": prior.space.parameters,
        "fixed": prior.fixed,
        "states": prior.states,
        "mapped": prior.mapped,
    }
    return replace(inputs, config=inputs.config.model_copy(update=changes | numbers))


def _mixture(
    parts_and_draws: Sequence[tuple[Posterior, int]], shares: Sequence[float], effective_wanted: int
) -> Posterior:
    """Mix the posteriors of conduction states, whose probabilities are `shares`.

    Each posterior comes with the number of draws to take from each of its runs. Differences
    between the runs are means over the states, weighted by their probabilities.
    """
    parts = [part for part, _ in parts_and_draws]
    # run by run, since each run is a chain
    chosen = [
        (part, run * (len(part) // RUNS) + np.array(evenly_spread(len(part) // RUNS, draws), int))
        for run in range(RUNS)
        for part, draws in parts_and_draws
    ]

    def joined(of: Callable[[Posterior], Floats]) -> Floats:
        return np.concatenate([of(part)[numbers] for part, numbers in chosen])

    def of_part(name: str, part: Posterior) -> Floats:
        return np.asarray({**part.averaged, **part.values}.get(name, np.full(len(part), np.nan)))

    values = {name: joined(partial(of_part, name)) for name in parts[0].values}
    averaged_names = sorted({name for part in parts for name in part.averaged})
    best = min(parts, key=lambda part: part.best_loss)
    pairs = [*zip(shares, parts, strict=True)]
    effective = 1 / np.sum([share**2 / part.effective for share, part in pairs], axis=0)
    evidences = np.sum([share * part.log_evidences for share, part in pairs], axis=0)
    means_apart = {
        name: sum(share * part.means_apart[name] for share, part in pairs) for name in values
    }
    agree = RunAgreement(float(np.ptp(evidences)), np.array([*means_apart.values()])).within()
    return Posterior(
        values,
        joined(lambda part: part.losses),
        best.best,
        best.best_loss,
        joined(lambda part: part.log_likelihoods),
        evidences,
        effective,
        np.sum([part.evaluations for part in parts], axis=0),
        means_apart,
        agree and bool((effective * RUNS >= effective_wanted).all()),
        {name: joined(partial(of_part, name)) for name in averaged_names},
    )


def _named(state: ConductionState, fitted: FittedStudy) -> Posterior:
    """Posterior of a state, with the state's number as the quantity `conduction`."""
    posterior = fitted.population
    assert isinstance(posterior, Posterior)
    return replace(
        posterior,
        averaged={**posterior.averaged, "conduction": np.full(len(posterior), state.number)},
        best={**posterior.best, "conduction": state.number},
    )


def _apportioned(shares: Floats, count: int) -> list[int]:
    """Whole numbers in proportion to shares, which add up to a count (largest remainders)."""
    exact = count * shares
    counts = np.floor(exact).astype(int)
    counts[np.argsort(counts - exact)[: count - counts.sum()]] += 1
    return [int(n) for n in counts]
