"""The paper's method, unchanged: Latin hypercube, Bayesian optimisation, rejection sampling.

The result is a population of networks, not a posterior. Candidates are drawn from a density that is
informed by the losses, the first that pass are kept, and they pass by comparison with the best
network, not with the recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress, stage_progress
from fascicle.inference.abc import Accepted, InformedPrior, draw_candidates, sample
from fascicle.inference.evaluation import Evaluation, best_of
from fascicle.inference.gaussian_process import Hyperparameters
from fascicle.inference.optimisation import Surrogates, iterations, latin_hypercube, step
from fascicle.inference.surrogates import LossGP, Observations
from fascicle.networks.settings import FitSettings
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import PaperPopulation


@dataclass(frozen=True)
class PaperFit:
    """Fit by the stages of the paper's method."""

    settings: FitSettings
    space: ParameterSpace
    journal: Journal
    progress: Progress | None = None

    def run(self) -> PaperPopulation:
        """Run all stages, using stored evaluations, and return the population."""
        self.explore()
        self.optimise()
        return PaperPopulation.of(self.space, self.sample(best_of(self.journal.evaluations)))

    def explore(self) -> None:
        """Evaluate the points of the Latin hypercube."""
        count, size, dimension = self.settings.initial, self.settings.workers, len(self.space)
        design = self.journal.propose(
            Stage.INITIAL, 0, lambda rng, _: (None, latin_hypercube(rng, count, dimension))
        )
        for start in range(0, count, size):
            self.journal.evaluate(Stage.INITIAL, list(design[start : start + size]))
            self.report(Stage.INITIAL, len(self.journal.records), count)
        if not any(evaluation.feasible for evaluation in self.journal.evaluations):
            raise InputError(
                f"none of the {count} initial points gives a tree (the first: "
                f"{self.journal.evaluations[0].reason}); check the heart, or narrow the ranges of "
                "the lengths"
            )

    def optimise(self) -> None:
        """Take the steps of the Bayesian optimisation."""
        surrogates: Surrogates | None = None

        def propose(rng: np.random.Generator, stored: str | None) -> tuple[str, Floats]:
            nonlocal surrogates
            observations = Observations.of(self.journal.evaluations)
            if surrogates is None and stored is not None:  # resumed
                surrogates = Surrogates.from_json(stored, observations)
            if surrogates is None:
                surrogates = Surrogates.learn(observations)
            else:
                surrogates = surrogates.updated(observations, self.settings.refit_every)
            return surrogates.to_json(), step(rng, surrogates)[None, :]

        for number in range(self.settings.steps):
            points = self.journal.propose(Stage.OPTIMISATION, number, propose)
            self.journal.evaluate(Stage.OPTIMISATION, list(points))
            self.report(Stage.OPTIMISATION, number + 1, self.settings.steps)

    def sample(self, best: Evaluation) -> Accepted:
        """Try candidates until enough are accepted, or the rounds are over; `best` is θ_min."""
        return sample(
            best,
            lambda number: self.journal.propose(
                Stage.REJECTION, number, partial(self._candidates, number=number, best=best)
            ),
            lambda points: self.journal.evaluate(Stage.REJECTION, points),
            samples=self.settings.samples,
            tolerance=self.settings.tolerance,
            refit_after=self.settings.refit_after,
            rounds=self.settings.rounds,
            workers=self.settings.workers,
            progress=self._report_round,
        )

    def report(self, stage: Stage, done: int, total: int) -> None:
        """Call the progress callback with the best loss so far."""
        if self.progress is None:
            return
        losses = [e.loss for e in self.journal.evaluations if e.feasible]
        best = f"best loss {min(losses):.4g} mV²" if losses else "no tree yet"
        self.progress(stage, done, total, best)

    def _candidates(
        self, rng: np.random.Generator, hyperparameters: str | None, number: int, best: Evaluation
    ) -> tuple[str, Floats]:
        """Draw the candidates of a round, no more than it can use."""
        start = Hyperparameters.from_json(hyperparameters) if hyperparameters else None
        loss = LossGP.fit(Observations.of(self.journal.evaluations), start, iterations(start))
        points, _ = draw_candidates(
            rng,
            InformedPrior.at(loss, best.point),
            self.settings.draws,
            limit=self.settings.samples * self.settings.refit_after,
            progress=stage_progress(self.progress, "draws", f"round {number + 1}"),
        )
        return loss.gp.hyperparameters.to_json(), points

    def _report_round(self, accepted: int, evaluated: int, number: int) -> None:
        if self.progress is not None:
            message = f"{evaluated} evaluated, round {number}"
            self.progress(Stage.REJECTION, accepted, self.settings.samples, message)
