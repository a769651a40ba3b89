"""A posterior: two independent runs of nested sampling on the likelihood of the recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.parameters import ParameterSpace
from fascicle.core.progress import Progress
from fascicle.inference.evaluation import best_of
from fascicle.inference.nested.agreement import agreement
from fascicle.inference.nested.sampling import BATCH, NestedRun, State, nested_sample
from fascicle.study.evaluations import Journal, Stage
from fascicle.study.population import Posterior
from fascicle.study.settings import FitSettings

RUNS = 2


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
    progress : Progress, optional
        Called after every batch of evaluations.
    """

    settings: FitSettings
    space: ParameterSpace
    journal: Journal
    progress: Progress | None = None

    def population(self) -> Posterior:
        """Do all that is left, and give the result."""
        runs = [self._sample(number) for number in range(RUNS)]
        count = -(-self.settings.effective // RUNS)
        chosen = [
            run.draw(self.journal.rng(Stage.SAMPLING, number), count)
            for number, run in enumerate(runs)
        ]
        points = np.concatenate([run.points[k] for run, k in zip(runs, chosen, strict=True)])
        return Posterior.of(
            self.space,
            self.journal.evaluate(Stage.SAMPLING, list(points)),
            best_of(self.journal.evaluations),
            [run.state for run in runs],
            agreement(*runs),
        )

    def _sample(self, number: int) -> NestedRun:
        """Make one run; how it goes depends on its number and on the seed alone."""
        each = self.settings.evaluations // RUNS

        def report(state: State) -> None:
            if self.progress is not None:
                losses = [e.loss for e in self.journal.evaluations if e.feasible]
                best = f"best loss {min(losses):.4g} mV², " if losses else ""
                self.progress(
                    Stage.SAMPLING,
                    number * each + state.evaluations,
                    RUNS * each,
                    f"run {number + 1} of {RUNS}: {best}log evidence {state.log_evidence:.1f}, "
                    f"effective sample {state.effective:.0f}",
                )

        run: NestedRun = nested_sample(
            int(self.journal.rng(Stage.SAMPLING, number).integers(2**32)),
            len(self.space),
            self._log_likelihoods,
            live=self.settings.live,
            effective=-(-self.settings.effective // RUNS),
            most=each,
            progress=report,
        )
        return run

    def _log_likelihoods(self, points: Floats) -> Floats:
        found = self.journal.evaluate(Stage.SAMPLING, list(points), BATCH)
        return np.array([e.log_likelihood if e.feasible else -np.inf for e in found])
