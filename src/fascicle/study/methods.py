"""The two methods of a fit: the posterior by an emulator, and the paper's, unchanged.

The posterior is sampled with an emulator, which is fast but not exact, and the forward model then
simulates the draws: all that is reported of a posterior comes from simulated networks.

The result of the paper's method is a population of networks, not a posterior. Candidates are drawn
from a density that is informed by the losses, the first that pass are kept, and they pass by
comparison with the best network, not with the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress, stage_progress
from fascicle.core.threads import one_thread
from fascicle.emulation.likelihood import RUNS, Emulated, sampled
from fascicle.inference.abc import Accepted, InformedPrior, draw_candidates, sample
from fascicle.inference.evaluation import Evaluation, best_of
from fascicle.inference.gaussian_process import Hyperparameters
from fascicle.inference.optimisation import Surrogates, iterations, latin_hypercube, step
from fascicle.inference.surrogates import LossGP, Observations
from fascicle.inference.tempered_sampling import SamplingRun, agreement, pooled
from fascicle.networks.prior import Prior
from fascicle.networks.settings import FitSettings
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import PaperPopulation, Posterior


@dataclass(frozen=True)
class PosteriorFit:
    """Sampling of a posterior, and simulation of its draws.

    For several recordings the posterior given the first alone is sampled, too, to show what the
    others add.
    """

    settings: FitSettings
    prior: Prior
    journal: Journal
    emulated: Sequence[Emulated]  # likelihood of each recording
    progress: Progress | None = None
    share: float = 1.0  # of its state in a mixture; with a small share, runs may agree less closely

    least_particles: ClassVar[int] = 600  # in a batch
    most_batches: ClassVar[int] = 16  # batches that are pooled, until the runs agree
    fewest_draws: ClassVar[int] = 10  # feasible ones of a run
    most_batches_of_draws: ClassVar[int] = 4
    # share of the draws, in the fewest hearts of an atlas that hold it: each takes seconds
    hearts_share: ClassVar[float] = 0.95

    def run(self) -> Posterior:
        """Sample and simulate all that is not stored yet, and return the posterior."""
        if len(self.emulated) == 1:
            return self._posterior(1)
        alone = self._sample(1)
        joint = self._posterior(len(self.emulated))
        if not self._agree(alone):
            return joint
        points = np.concatenate([run.points for run in alone])
        return replace(joint, first_alone=self.prior.learnt_columns(points))

    def _posterior(self, recordings: int) -> Posterior:
        """Sample the posterior given the first recordings, and simulate draws of both runs."""
        runs = self._sample(recordings)
        by_run = self._simulated(runs, recordings)
        fewest = min(map(len, by_run))  # of either run, if the emulator is wrong about feasibility
        draws = [draw for of_run in by_run for draw in of_run[:fewest]]
        return Posterior.of(
            self.prior,
            draws,
            best_of(self.journal.evaluations),
            runs,
            agreement(*runs).means,
            self._agree(runs),
        )

    def _in_probable_hearts(self, runs: Sequence[SamplingRun]) -> list[Floats]:
        """Points of each run; of an atlas, those in the most probable hearts (`hearts_share`)."""
        averaged = self.prior.averaged
        if not averaged.weights:
            return [run.points for run in runs]
        hearts = [averaged.tissue(run.points[:, len(self.prior.space) :]) for run in runs]
        counts = np.bincount(np.concatenate(hearts), minlength=len(averaged.weights))
        ranked = np.argsort(-counts, kind="stable")
        before = np.cumsum(counts[ranked]) - counts[ranked]
        probable = ranked[before < self.hearts_share * counts.sum()]
        return [
            run.points[np.isin(of_run, probable)] for run, of_run in zip(runs, hearts, strict=True)
        ]

    def _simulated(self, runs: Sequence[SamplingRun], recordings: int) -> list[list[Evaluation]]:
        """Simulate draws of each run, without infeasible points.

        If too few are feasible, draws of further batches follow; an error if they would not do.
        """
        draws_per_run = -(-self.settings.effective // RUNS)
        needed, tried, fewest = max(self.fewest_draws, draws_per_run // 5), 0, 0
        by_run: list[list[Evaluation]] = [[] for _ in runs]
        for number in range(self.most_batches_of_draws):
            batch = self.most_batches + number if number else 0  # no number of `_sample`
            if number:
                message = f"further {RUNS} runs, since {fewest} of {tried} draws give a network"
                runs = one_thread(self._batches)(recordings, batch, message)
            for run, points in enumerate(self._in_probable_hearts(runs)):
                points = self._rng(4 * RUNS * batch + RUNS + run, recordings).permutation(points)
                self._simulate_feasible(points, draws_per_run, by_run, run)
            tried, fewest = tried + len(runs[0].points), min(map(len, by_run))
            if fewest >= needed:
                return by_run
            if fewest * self.most_batches_of_draws < needed * (number + 1):
                break
        mapped = (
            " that is activated like mapped hearts: conduction may not be normal; leave out "
            "conduction where it is fixed, or"
        )
        raise InputError(
            f"only {fewest} of {tried} draws give a network of this heart"
            f"{mapped if self.prior.mapped else ';'} make more prior simulations "
            "(prior_simulations), or narrow the ranges of the lengths"
        )

    def _simulate_feasible(
        self, points: Floats, count: int, by_run: Sequence[list[Evaluation]], run: int
    ) -> None:
        """Add feasible evaluations at points (n, d), in their order, until a run has `count`."""
        before, feasible = sum(map(len, by_run[:run])), by_run[run]

        def report(done: int) -> None:
            if self.progress is not None:
                total = count * len(by_run)
                self.progress("networks", before + len(feasible) + done, total, "")

        while len(feasible) < count and len(points):
            batch, points = np.split(points, [count - len(feasible)])
            evaluations = self.journal.evaluate(Stage.SAMPLING, [*batch], 50, report)
            feasible += [evaluation for evaluation in evaluations if evaluation.feasible]

    def _rng(self, number: int, recordings: int) -> np.random.Generator:
        """Random generator of a run's batch, or of the draws from a run, by its number."""
        return self.journal.rng(Stage.SAMPLING, number + 2 * RUNS * (recordings > 1))

    def _agree(self, runs: Sequence[SamplingRun], share: float = 1.0) -> bool:
        """True if runs agree, and their effective sample size is as large as the settings ask."""
        enough = all(run.effective * RUNS >= self.settings.effective for run in runs)
        return enough and agreement(*runs).within(share)

    def _sample(self, recordings: int) -> list[SamplingRun]:
        """Make the runs, adding batches of particles until the runs agree."""
        # around both runs, since each run would end the other's limit of threads
        sample = one_thread(self._batches)
        batches: list[list[SamplingRun]] = []
        while True:
            message = f"{RUNS} runs of {self._particles * (len(batches) + 1)}"
            batches.append(sample(recordings, len(batches), message))
            runs = [pooled(batches_of_run) for batches_of_run in zip(*batches, strict=True)]
            if self._agree(runs, self.share) or len(batches) >= self.most_batches:
                return runs

    @property
    def _particles(self) -> int:
        """Particles of a batch: twice as many as are drawn of it, since some are infeasible."""
        return max(self.least_particles, self.settings.effective)

    def _batches(self, recordings: int, number: int, message: str) -> list[SamplingRun]:
        """A batch of each run."""
        if len(self.emulated) > 1:
            message += ", first recording alone" if recordings == 1 else ", all recordings"
        return sampled(
            self.emulated[:recordings],
            self.prior.dimension,
            # RUNS numbers for the batches and RUNS for the draws, alone and with all recordings
            [self._rng(4 * RUNS * number + run, recordings) for run in range(RUNS)],
            self._particles,
            message,
            self.progress,
        )


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
        count, size, dimension = self.settings.initial, self.settings.batch, len(self.space)
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
            workers=self.settings.batch,
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
