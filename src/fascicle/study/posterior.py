"""A posterior: two independent runs of importance sampling on the likelihood of the recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress
from fascicle.inference.evaluation import best_of
from fascicle.inference.importance.agreement import agreement
from fascicle.inference.importance.sampling import Run as SamplingRun
from fascicle.inference.importance.sampling import State, importance_sample
from fascicle.study.bank import prior_points
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import Posterior
from fascicle.study.settings import FitSettings

RUNS = 2
BATCH = 100  # evaluations that are stored at a time


@dataclass(frozen=True)
class Run:
    """One pass through the runs of the sampler.

    Attributes
    ----------
    settings : FitSettings
        Sizes of the runs.
    space : ParameterSpace
        The d parameters that are learnt.
    journal : Journal
        Gives evaluations with their likelihoods, stored ones where there are any.
    recordings : int
        How many there are. The posterior of the first alone is sampled first, from which that of
        all goes on: what the others add is seen, too.
    progress : Progress, optional
        Called after every batch of evaluations.
    """

    settings: FitSettings
    space: ParameterSpace
    journal: Journal
    recordings: int = 1
    progress: Progress | None = None

    def population(self) -> Posterior:
        """Do all that is left, and give the result."""
        runs = [self._sample(number, 1) for number in range(RUNS)]
        posterior = self._posterior(runs, 1)
        if self.recordings == 1:
            return posterior
        joint = [self._sample(number, self.recordings, run) for number, run in enumerate(runs)]
        alone = posterior.values if posterior.converged else None
        return replace(self._posterior(joint, self.recordings), first_alone=alone)

    def _posterior(self, runs: list[SamplingRun], recordings: int) -> Posterior:
        """Draw from both runs."""
        count = -(-self.settings.effective // RUNS)
        chosen = [
            run.draw(self._rng(RUNS + number, recordings), count) for number, run in enumerate(runs)
        ]
        points = np.concatenate([run.points[k] for run, k in zip(runs, chosen, strict=True)])
        return Posterior.of(
            self.space,
            self.journal.evaluate(Stage.SAMPLING, list(points)),
            best_of(self.journal.evaluations),
            [run.state for run in runs],
            agreement(*runs),
        )

    def _rng(self, number: int, recordings: int) -> np.random.Generator:
        """Random numbers of a run, or of draws from one."""
        return self.journal.rng(Stage.SAMPLING, number + 2 * RUNS * (recordings > 1))

    def _sample(
        self, number: int, recordings: int, begun: SamplingRun | None = None
    ) -> SamplingRun:
        """Make one run; how it goes depends on its number and on the seed alone."""
        # Every second network of the prior: the runs have nothing in common.
        prior = prior_points(len(self.space), self.settings.bank)[number::RUNS]
        each = self.settings.evaluations // RUNS
        said = [f"run {number + 1} of {RUNS}"]
        if self.recordings > 1:
            said[0] += ", first recording alone" if begun is None else ", all recordings"
        done = [number * (len(prior) + each)]
        if begun is not None:  # evaluates those points again, which are there
            done = [RUNS * (len(prior) + each) + number * each - len(begun.points)]

        def log_likelihoods(points: Floats) -> Floats:
            values = []
            for start in range(0, len(points), BATCH):
                part = list(points[start : start + BATCH])
                found = self.journal.evaluate(Stage.SAMPLING, part, BATCH)
                values += [
                    e.log_likelihoods[:recordings].sum() if e.feasible else -np.inf for e in found
                ]
                done[0] += len(part)
                self._report(done[0], ", ".join(said))
            return np.array(values)

        def report(state: State) -> None:
            said[1:] = [
                f"log evidence {state.log_evidence:.1f}",
                f"effective sample {state.effective:.0f}",
            ]
            self._report(done[0], ", ".join(said))

        run: SamplingRun = importance_sample(
            self._rng(number, recordings),
            log_likelihoods,
            prior,
            effective=-(-self.settings.effective // RUNS),
            most=each,
            begun=begun,
            progress=report,
        )
        return run

    def _report(self, done: int, said: str) -> None:
        if self.progress is None:
            return
        losses = [e.loss for e in self.journal.evaluations if e.feasible]
        best = f", best loss {min(losses):.4g} mV²" if losses else ""
        self.progress(Stage.SAMPLING, done, self._total, said + best)

    @property
    def _total(self) -> int:
        """Evaluations at most."""
        return self.settings.bank + self.settings.evaluations * min(self.recordings, 2)
