"""A posterior: two independent runs of importance sampling on the likelihood of the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress
from fascicle.inference.evaluation import best_of
from fascicle.inference.importance_sampling import (
    SamplingRun,
    State,
    agreement,
    importance_sample,
    sampling,
)
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import Posterior
from fascicle.study.prior_simulations import prior_points
from fascicle.study.settings import FitSettings

RUNS = 2


@dataclass(frozen=True)
class PosteriorFit:
    """One pass through the runs of the sampler.

    Of several recordings the posterior of the first alone is sampled first, from which that of all
    goes on: what the others add is seen, too.
    """

    settings: FitSettings
    space: ParameterSpace
    journal: Journal
    recordings: int = 1
    progress: Progress | None = None

    def run(self) -> Posterior:
        """Do all that is left, and give the result."""
        runs = self._sample(1)
        posterior = self._posterior(runs, 1)
        if self.recordings == 1:
            return posterior
        joint = self._sample(self.recordings, runs)
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
        self, recordings: int, begun: Sequence[SamplingRun | None] = (None,) * RUNS
    ) -> list[SamplingRun]:
        """Make the runs; how each goes depends on its number and on the seed alone."""
        each = self.settings.evaluations // RUNS
        states: dict[int, State] = {}  # where each run stands
        # what a run before this one might have done; its points are asked for again, and are there
        done = [0 if begun[0] is None else self._phase - sum(len(r.points) for r in begun if r)]

        def log_likelihoods(points: Floats) -> Floats:
            again = self.journal.knew(list(points))

            def report(count: int) -> None:
                if again:
                    self._report_stored(done[0] + count)
                else:
                    self._report(done[0] + count, self._status(states, recordings))

            found = self.journal.evaluate(Stage.SAMPLING, list(points), 100, report)
            done[0] += len(points)
            return np.array(
                [e.log_likelihoods[:recordings].sum() if e.feasible else -np.inf for e in found]
            )

        runs: list[SamplingRun] = importance_sample(
            log_likelihoods,
            *(
                sampling(
                    self._rng(number, recordings),
                    # every second network of the prior: the runs have nothing in common
                    prior_points(len(self.space), self.settings.prior_simulations)[number::RUNS],
                    effective=-(-self.settings.effective // RUNS),
                    most=each,
                    begun=begun[number],
                    progress=partial(states.__setitem__, number),
                )
                for number in range(RUNS)
            ),
        )
        return runs

    def _status(self, states: Mapping[int, State], recordings: int) -> str:
        """What is said of the runs while they go on."""
        said = f"{RUNS} runs"
        if self.recordings > 1:
            said += ", first recording alone" if recordings == 1 else ", all recordings"
        if not states:
            return said
        evidences = " and ".join(f"{state.log_evidence:.1f}" for state in states.values())
        effective = sum(state.effective for state in states.values())
        return (
            f"{said}, log evidence {evidences}, effective sample about {effective:.0f} of "
            f"{self.settings.effective}"
        )

    def _report_stored(self, done: int) -> None:
        """A stage of its own: it says nothing of how long new evaluations take."""
        if self.progress is not None:
            total = len(self.journal.before)
            self.progress("stored", min(done, total), total, "")

    def _report(self, done: int, said: str) -> None:
        if self.progress is None:
            return
        stored = (record.evaluation for record in self.journal.known.values())
        losses = [evaluation.loss for evaluation in stored if evaluation.feasible]
        best = f", best loss {min(losses):.4g} mV²" if losses else ""
        total = self._phase + self.settings.evaluations * (self.recordings > 1)
        self.progress(Stage.SAMPLING, done, total, said + best)

    @property
    def _phase(self) -> int:
        """Evaluations at most until the first recording is done."""
        return self.settings.prior_simulations + self.settings.evaluations
