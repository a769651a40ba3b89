"""Posterior: two independent runs of tempered sampling on an emulator, and simulated draws.

The emulator is fast but not exact: the posterior is sampled with it, and the forward model then
simulates the draws. All that is reported of a posterior comes from simulated networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fascicle.core.errors import InputError
from fascicle.core.progress import Progress
from fascicle.core.threads import one_thread
from fascicle.emulation.likelihood import RUNS, Emulated, sampled
from fascicle.inference.evaluation import Evaluation, best_of
from fascicle.inference.tempered_sampling import SamplingRun, agreement, pooled
from fascicle.networks.prior import Prior
from fascicle.networks.settings import FitSettings
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import Posterior


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
        draws_per_run = -(-self.settings.effective // RUNS)
        draws = [
            draw
            for number, run in enumerate(runs)
            for draw in self._simulated(run, draws_per_run, number, recordings)
        ]
        return Posterior.of(
            self.prior,
            draws,
            best_of(self.journal.evaluations),
            runs,
            agreement(*runs).means,
            self._agree(runs),
        )

    def _simulated(
        self, run: SamplingRun, count: int, number: int, recordings: int
    ) -> list[Evaluation]:
        """Simulate draws of a run in random order, without infeasible points."""
        points = [*self._rng(RUNS + number, recordings).permutation(run.points)]
        feasible: list[Evaluation] = []
        total = RUNS * count

        def report(done: int) -> None:
            if self.progress is not None:
                self.progress("networks", number * count + len(feasible) + done, total, "")

        while len(feasible) < count and points:
            batch, points = points[: count - len(feasible)], points[count - len(feasible) :]
            evaluations = self.journal.evaluate(Stage.SAMPLING, batch, 50, report)
            feasible += [evaluation for evaluation in evaluations if evaluation.feasible]
        if len(feasible) < count:
            mapped = (
                " that is activated like mapped hearts: conduction may not be normal; leave out "
                "conduction where it is fixed, or"
            )
            raise InputError(
                f"only {len(feasible)} of {len(run.points)} draws give a network of this heart"
                f"{mapped if self.prior.mapped else ';'} make more prior simulations "
                "(prior_simulations), or narrow the ranges of the lengths"
            )
        return feasible

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
            batches.append(sample(recordings, len(batches)))
            runs = [pooled(batches_of_run) for batches_of_run in zip(*batches, strict=True)]
            if self._agree(runs, self.share) or len(batches) >= self.most_batches:
                return runs

    def _batches(self, recordings: int, number: int) -> list[SamplingRun]:
        """A batch of each run."""
        # twice as many particles as are drawn from a run, since some are infeasible
        count = max(self.least_particles, self.settings.effective)
        # numbers below 4 RUNS are those of the first batches and of the draws from the runs
        first = 0 if number == 0 else 4 * RUNS * number
        message = f"{RUNS} runs of {count * (number + 1)}"
        if len(self.emulated) > 1:
            message += ", first recording alone" if recordings == 1 else ", all recordings"
        return sampled(
            self.emulated[:recordings],
            self.prior.dimension,
            [self._rng(first + run, recordings) for run in range(RUNS)],
            count,
            message,
            self.progress,
        )
