"""The stages of a study, one after the other: design, optimisation, refinement, population."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress, stage_progress
from fascicle.inference.abc.informed_prior import InformedPrior, draw_candidates
from fascicle.inference.abc.random_walks import propose, walk
from fascicle.inference.abc.rejection import Sampling, sample
from fascicle.inference.evaluation import best_of
from fascicle.inference.optimisation import step as bayesian
from fascicle.inference.optimisation.refine import refine
from fascicle.inference.surrogate.surrogates import Observations
from fascicle.study.evaluations import Journal, Record, Stage
from fascicle.study.population import Population
from fascicle.study.settings import FitSettings


@dataclass(frozen=True)
class Run:
    """One pass through the stages.

    Attributes
    ----------
    settings : FitSettings
        Sizes of the stages, and the rules of acceptance.
    space : ParameterSpace
        The d parameters that are learnt.
    journal : Journal
        Gives points and evaluations, stored ones where there are any.
    progress : Progress, optional
        Called after every batch of evaluations.
    """

    settings: FitSettings
    space: ParameterSpace
    journal: Journal
    progress: Progress | None = None

    def population(self) -> Population:
        """Do all that is left, and give the result."""
        self._initial()
        self._optimise()
        self._refine()
        return Population.of(self.space, self._sample(), best_of(self.journal.evaluations))

    def _initial(self) -> None:
        count, size, dimension = self.settings.initial, self.settings.workers, len(self.space)
        design = self.journal.propose(
            Stage.INITIAL, 0, lambda rng, _: (None, bayesian.latin_hypercube(rng, count, dimension))
        )
        for start in range(0, count, size):
            self.journal.evaluate(Stage.INITIAL, list(design[start : start + size]))
            self._report(Stage.INITIAL, len(self.journal.records), count)
        if not any(evaluation.feasible for evaluation in self.journal.evaluations):
            raise InputError(
                f"none of the {count} initial points gives a tree (the first: "
                f"{self.journal.evaluations[0].reason}); check the heart, or narrow the ranges of "
                "the lengths"
            )

    def _optimise(self) -> None:
        total, done, step = self.settings.steps, 0, 0
        while done < total:
            size = min(self.settings.workers, total - done)
            proposed = self.journal.propose(
                Stage.OPTIMISATION, step, partial(self._step, size=size)
            )
            points = proposed[: total - done]  # a stored step is as large as the workers then
            self.journal.evaluate(Stage.OPTIMISATION, list(points))
            done, step = done + len(points), step + 1
            self._report(Stage.OPTIMISATION, done, total)

    def _step(
        self, rng: np.random.Generator, hyperparameters: str | None, size: int
    ) -> tuple[str, Floats]:
        state = bayesian.State.from_json(surrogate_data(self.journal.records), hyperparameters)
        fitted, points = bayesian.step(rng, state, size)
        return fitted.hyperparameters_to_json(), points

    def _refine(self) -> None:
        refine(
            self.journal.rng(Stage.REFINEMENT, 0),
            self.journal.evaluations,
            lambda points: self.journal.evaluate(Stage.REFINEMENT, points),
            self.settings.refine,
            lambda done, total: self._report(Stage.REFINEMENT, done, total),
        )

    def _sample(self) -> Sampling:
        """Draw the population: by rejection, and where that falls short by random walks."""
        found = sample(
            self.journal.evaluations,
            lambda number: self.journal.propose(
                Stage.POSTERIOR, number, partial(self._candidates, number=number)
            ),
            lambda points: self.journal.evaluate(Stage.POSTERIOR, points),
            self.settings,
            self._report_round,
        )
        if len(found.accepted) >= self.settings.samples or not self.settings.walk_steps:
            return found
        return walk(
            found,
            lambda step, positions: self.journal.propose(
                Stage.WALK, step, lambda rng, _: (None, propose(rng, positions))
            ),
            lambda points: self.journal.evaluate(Stage.WALK, points),
            self.settings,
            lambda done, total: self._report(Stage.WALK, done, total),
        )

    def _candidates(
        self, rng: np.random.Generator, hyperparameters: str | None, number: int
    ) -> tuple[str, Floats]:
        """Candidates of a round, no more than it can use."""
        state = bayesian.State.from_json(surrogate_data(self.journal.records), hyperparameters)
        fitted, loss, feasibility = bayesian.refit(state)
        points, _ = draw_candidates(
            rng,
            InformedPrior.at(loss, feasibility, best_of(self.journal.evaluations).point),
            self.settings.draws,
            self.settings.candidate_order,
            limit=self.settings.samples * self.settings.refit_after,
            progress=stage_progress(self.progress, "prior", f"round {number + 1}"),
        )
        return fitted.hyperparameters_to_json(), points

    def _report(self, stage: Stage, done: int, total: int) -> None:
        if self.progress is None:
            return
        losses = [e.loss for e in self.journal.evaluations if e.feasible]
        best = f"best loss {min(losses):.4g} mV²" if losses else "no tree yet"
        self.progress(stage, done, total, best)

    def _report_round(self, accepted: int, evaluated: int, number: int) -> None:
        if self.progress is not None:
            message = f"{evaluated} evaluated, round {number}"
            self.progress(Stage.POSTERIOR, accepted, self.settings.samples, message)


def surrogate_data(records: Iterable[Record]) -> Observations:
    """What the surrogates learn from: the logarithm of every loss but the refinement's.

    That crowds about a few points, which would make the surrogate slow, and sure of itself only
    there; its best point is enough.
    """
    records = list(records)
    refined = [r for r in records if r.stage is Stage.REFINEMENT and r.evaluation.feasible]
    best = min(refined, key=lambda record: record.evaluation.loss, default=None)
    return Observations.of(
        r.evaluation for r in records if r.stage is not Stage.REFINEMENT or r is best
    ).logarithmic()
