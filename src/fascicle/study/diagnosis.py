"""Conduction states of a recording: their probabilities, and the mixture of their posteriors.

A classifier of the heart's simulated recordings gives the probability of each state. The most
probable ones are fitted, and their posteriors are mixed by these probabilities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.progress import Progress
from fascicle.emulation.ecg_classifier import classified_rows
from fascicle.emulation.likelihood import RUNS
from fascicle.emulation.recalibration import as_simulated, recalibration_of
from fascicle.emulation.state_classifier import (
    StateSimulations,
    classifier_of,
    probabilities,
    simulations_of_states,
    unlike,
)
from fascicle.inference.tempered_sampling import RunAgreement
from fascicle.study.inputs import InverseProblem
from fascicle.study.population import Posterior, evenly_spread


@dataclass(frozen=True)
class Diagnosis:
    """Probabilities of the conduction states of a recording.

    Attributes
    ----------
    probable : mapping of str to float
        Probability of each state that is named; networks of a fascicular block are those of normal.
    unnamed : str
        Reason why no state is named despite these probabilities; else empty.
    simulations : mapping of str to StateSimulations
        Prior simulations of each state.
    """

    probable: Mapping[str, float]
    unnamed: str
    simulations: Mapping[str, StateSimulations]

    @cached_property
    def shares(self) -> dict[str, float]:
        """Fewest states whose probabilities add up to 0.9, with their shares of the draws."""
        probable = as_simulated(self.probable)
        ranked = sorted(probable, key=lambda name: -probable[name])
        before = np.cumsum([0.0, *(probable[name] for name in ranked)])
        fitted = [name for name, covered in zip(ranked, before, strict=False) if covered < 0.9]
        total = sum(probable[name] for name in fitted)
        return {name: probable[name] / total for name in fitted}

    def apportioned(self, count: int) -> list[int]:
        """Draws of each state, by its share; they add up to `count` (largest remainder method)."""
        exact = count * np.array([*self.shares.values()])
        counts = np.floor(exact).astype(int)
        counts[np.argsort(counts - exact)[: count - counts.sum()]] += 1
        return [int(n) for n in counts]


def classified(problem: InverseProblem, place: Path, progress: Progress | None) -> Diagnosis:
    """Classify the recording of a study; simulations are kept in the folder `place`."""
    simulator, count = problem.simulator, problem.config.prior_simulations
    target = problem.recordings[0].target
    simulations = simulations_of_states(simulator.model, problem.config.prior, place, count)
    rows = classified_rows(target)
    classifier = classifier_of(simulations, rows, place, count, simulator.pool, progress)
    recalibration = recalibration_of(simulator.model.heart, target, simulations)
    probable = probabilities(classifier, simulations, problem.config.states, target, recalibration)
    return Diagnosis(probable, unlike(classifier, target, recalibration), simulations)


def mixture(
    parts_and_draws: Sequence[tuple[Posterior, int]], diagnosis: Diagnosis, effective_wanted: int
) -> Posterior:
    """Mix the posteriors of conduction states by their shares.

    Each posterior comes with the number of draws to take from each of its runs. Log evidences and
    differences between the runs are averaged over the states, weighted by their shares.
    """
    parts = [part for part, _ in parts_and_draws]
    # run by run: a posterior holds the draws of its first run, then those of its second
    chosen = [
        (part, run * (len(part) // RUNS) + np.array(evenly_spread(len(part) // RUNS, draws), int))
        for run in range(RUNS)
        for part, draws in parts_and_draws
    ]

    def joined(values_of: Callable[[Posterior], Floats]) -> Floats:
        return np.concatenate([values_of(part)[draws] for part, draws in chosen])

    def quantity(name: str, part: Posterior) -> Floats:  # NaN in states without it
        return np.asarray({**part.averaged, **part.values}.get(name, np.full(len(part), np.nan)))

    values = {name: joined(partial(quantity, name)) for name in parts[0].values}
    averaged_names = sorted({name for part in parts for name in part.averaged})
    best = min(parts, key=lambda part: part.best_loss)
    pairs = [*zip(diagnosis.shares.values(), parts, strict=True)]
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
        {name: joined(partial(quantity, name)) for name in averaged_names},
        states=diagnosis.probable,
        unnamed=diagnosis.unnamed,
    )
