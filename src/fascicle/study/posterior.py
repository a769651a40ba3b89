"""To be replaced: the stages of the paper with a refinement, in the place of a posterior."""

from __future__ import annotations

from fascicle.inference.evaluation import best_of
from fascicle.inference.optimisation.refine import refine
from fascicle.inference.surrogate.surrogates import Observations
from fascicle.study import paper
from fascicle.study.evaluations import Stage
from fascicle.study.population import Population


class Run(paper.Run):
    """One pass through the stages."""

    def population(self) -> Population:
        """Do all that is left, and give the result."""
        self.explore()
        self.optimise()
        self._refine()
        return Population.of(self.space, self.sample(best_of(self.journal.evaluations)))

    def known(self) -> Observations:
        """What the surrogates learn from: of the refinement, which crowds, the best point alone."""
        records = self.journal.records
        refined = [r for r in records if r.stage is Stage.REFINEMENT and r.evaluation.feasible]
        best = min(refined, key=lambda record: record.evaluation.loss, default=None)
        return Observations.of(
            r.evaluation for r in records if r.stage is not Stage.REFINEMENT or r is best
        )

    def _refine(self) -> None:
        refine(
            self.journal.rng(Stage.REFINEMENT, 0),
            self.journal.evaluations,
            lambda points: self.journal.evaluate(Stage.REFINEMENT, points),
            self.settings.refine,
            lambda done, total: self.report(Stage.REFINEMENT, done, total),
        )
