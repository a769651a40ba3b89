"""The stages of a study, one after the other: design, optimisation, refinement, posterior."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.inference.evaluation import Evaluation, Objective
from fascicle.study.evaluations import Ledger, Record

if TYPE_CHECKING:
    from fascicle.core.progress import Progress
    from fascicle.inference.abc.rejection import Sampling
    from fascicle.inference.surrogate.observations import Observations
    from fascicle.study.posterior_result import Posterior
    from fascicle.study.settings import StudyConfig

STAGES = ("initial", "optimisation", "posterior", "walk", "refinement")  # their places seed them


class Run:
    """One pass through the three stages, reading what is stored and storing what is not."""

    def __init__(
        self, config: StudyConfig, ledger: Ledger, objective: Objective, progress: Progress
    ) -> None:
        self.config = config
        self.ledger = ledger
        self.objective = objective
        self.progress = progress
        self.space = config.parameter_space()
        self.stored = ledger.records()
        self.evaluations: list[Evaluation] = []
        self.hyperparameters: str | None = None
        self.refined = 0, 0  # which of the evaluations the refinement made
        self.refinement_best: Evaluation | None = None

    def posterior(self) -> Posterior:
        """Do all that is left, and give the result."""
        self._initial()
        self._optimise()
        self._refine()
        return self._result(self._sample())

    def _rng(self, stage: str, step: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, STAGES.index(stage), step])

    def _proposed(
        self,
        stage: str,
        step: int,
        compute: Callable[[np.random.Generator], tuple[str | None, NDArray[np.float64]]],
    ) -> NDArray[np.float64]:
        """Points (m, d) of a step: from the ledger, or computed and written there."""
        stored = self.ledger.proposal(stage, step)
        if stored is None:
            stored = compute(self._rng(stage, step))
            self.ledger.propose(stage, step, *stored)
        self.hyperparameters, points = stored
        return points.reshape(-1, len(self.space))

    def _evaluate(self, stage: str, points: Sequence[NDArray[np.float64]]) -> list[Evaluation]:
        """Outcomes at `points`: from the ledger as far as it goes, then from the objective."""
        first = len(self.evaluations)
        known = [record.evaluation for record in self.stored[first : first + len(points)]]
        for number, (evaluation, point) in enumerate(zip(known, points, strict=False), first):
            if not np.array_equal(evaluation.point, point):
                raise InputError(
                    f"{self.ledger.path}: evaluation {number} is not of the point that the study "
                    "proposes; the file was changed, start again in another folder (--out)"
                )
        self.evaluations += known
        for start in range(len(known), len(points), self.config.batch):
            missing = list(points[start : start + self.config.batch])
            self.evaluations += self._compute(stage, first + start, missing)
        return self.evaluations[first:]

    def _compute(
        self, stage: str, first: int, points: list[NDArray[np.float64]]
    ) -> list[Evaluation]:
        begin = time.perf_counter()
        results = self.objective(points)
        seconds = (time.perf_counter() - begin) / len(points)
        outcomes = [replace(e, point=p) for e, p in zip(results, points, strict=True)]
        for outcome in outcomes:
            _check_outcome(outcome)
        self.ledger.append(first, [Record(stage, outcome, seconds) for outcome in outcomes])
        return outcomes

    def _initial(self) -> None:
        from fascicle.inference.optimisation.design import latin_hypercube

        count, size = self.config.initial, self.config.batch
        design = self._proposed(
            "initial", 0, lambda rng: (None, latin_hypercube(rng, count, len(self.space)))
        )
        for start in range(0, count, size):
            self._evaluate("initial", list(design[start : start + size]))
            self._report("initial", len(self.evaluations), count)
        if not any(evaluation.feasible for evaluation in self.evaluations):
            reasons = [evaluation.reason for evaluation in self.evaluations]
            common = max(sorted(set(reasons)), key=reasons.count)
            raise InputError(
                f"none of the {count} initial points gives a tree (mostly: {common}); check the "
                "heart, or narrow the ranges of the lengths"
            )

    def _optimise(self) -> None:
        total, begin, step = self.config.steps, len(self.evaluations), 0
        while (done := len(self.evaluations) - begin) < total:
            size = min(self.config.batch, total - done)
            points = self._proposed("optimisation", step, partial(self._step, size=size))
            self._evaluate("optimisation", list(points))
            self._report("optimisation", done + size, total)
            step += 1

    def _refine(self) -> None:
        from fascicle.inference.optimisation.refine import refine

        first = len(self.evaluations)
        refine(
            self._rng("refinement", 0),
            list(self.evaluations),
            lambda points: self._evaluate("refinement", points),
            self.config.refine,
            lambda done, total: self._report("refinement", done, total),
        )
        self.refined = first, len(self.evaluations)
        feasible = [e for e in self.evaluations[first:] if e.feasible]
        self.refinement_best = min(feasible, key=lambda e: e.loss, default=None)

    def _step(self, rng: np.random.Generator, size: int) -> tuple[str, NDArray[np.float64]]:
        from fascicle.inference.optimisation.step import State, step

        state = State.from_json(self._observations(), self.hyperparameters)
        fitted, points = step(rng, state, size)
        return fitted.hyperparameters_to_json(), points

    def _observations(self) -> Observations:
        """What the surrogates learn from: the logarithm of every loss but the refinement's.

        That crowds about a few points, which would make the surrogate slow, and sure of itself only
        there; its best point is enough.
        """
        from fascicle.inference.surrogate.observations import Observations

        first, last = self.refined
        best = [self.refinement_best] if self.refinement_best is not None else []
        return Observations.of(
            [*self.evaluations[:first], *best, *self.evaluations[last:]]
        ).logarithmic()

    def _report(self, stage: str, done: int, total: int) -> None:
        losses = [evaluation.loss for evaluation in self.evaluations if evaluation.feasible]
        best = f"best loss {min(losses):.4g} mV²" if losses else "no tree yet"
        self.progress(stage, done, total, best)

    def _sample(self) -> Sampling:
        from fascicle.inference.abc.random_walks import propose, walk
        from fascicle.inference.abc.rejection import Rules, sample

        config = self.config
        rules = Rules(
            config.samples, config.tolerance, config.patience, config.rounds, config.batch
        )
        self.hyperparameters = None  # those of the last step are warm; a posterior is fitted anew
        found = sample(
            list(self.evaluations),
            lambda number, _: self._proposed(
                "posterior", number, lambda rng: self._candidates(rng, number)
            ),
            lambda points: self._evaluate("posterior", points),
            rules,
            lambda accepted, evaluated, number: self.progress(
                "posterior", accepted, config.samples, f"{evaluated} evaluated, round {number}"
            ),
        )
        if len(found.accepted) >= config.samples:
            return found
        return walk(
            found,
            lambda sweep, positions: self._proposed(
                "walk", sweep, lambda rng: (None, propose(rng, positions))
            ),
            lambda points: self._evaluate("walk", points),
            rules,
            config.sweeps,
            lambda done, total: self._report("walk", done, total),
        )

    def _candidates(self, rng: np.random.Generator, number: int) -> tuple[str, NDArray[np.float64]]:
        """Candidates of a posterior round, no more than it can use."""
        from fascicle.inference.abc.informed_prior import InformedPrior, draw_candidates
        from fascicle.inference.abc.rejection import best_of
        from fascicle.inference.optimisation.step import State, refit

        config = self.config
        state = State.from_json(self._observations(), self.hyperparameters)
        fitted, loss, feasibility = refit(state)
        candidates = draw_candidates(
            rng,
            InformedPrior.at(loss, feasibility, best_of(self.evaluations).point),
            config.draws,
            config.candidate_order,
            limit=config.samples * config.patience,
            progress=lambda done, total: self.progress("prior", done, total, f"round {number + 1}"),
        )
        return fitted.hyperparameters_to_json(), candidates.points

    def _result(self, sampling: Sampling) -> Posterior:
        from fascicle.inference.abc.rejection import best_of
        from fascicle.study.posterior_result import Posterior

        best = best_of(self.evaluations)
        # walks that never moved stand where they started: one network, not several
        chosen = {e.point.tobytes(): k for k, e in reversed(list(enumerate(sampling.accepted)))}
        kept = sorted(chosen.values())
        accepted = [sampling.accepted[k] for k in kept]
        points = np.array([e.point for e in accepted]).reshape(-1, len(self.space))
        named = [self.space.from_unit(point) for point in points]
        return Posterior(
            points=points,
            values={n: np.array([values[n] for values in named]) for n in self.space.names},
            losses=np.array([evaluation.loss for evaluation in accepted]),
            distances=sampling.distances[kept],
            best_point=best.point,
            best_values=self.space.from_unit(best.point),
            best_loss=best.loss,
            wanted=self.config.samples,
            evaluated=sampling.evaluated,
            rounds=sampling.rounds,
            sweeps=sampling.sweeps,
        )


def _check_outcome(evaluation: Evaluation) -> None:
    """Refuse what the surrogate and the distance could not digest."""
    if not evaluation.feasible:
        return
    errors = evaluation.beat_errors
    if errors.size < 2:
        raise InputError(
            f"the target has {errors.size} beat(s), and its variability needs 2 or more; "
            "give a longer recording"
        )
    if not (np.isfinite(evaluation.loss) and np.isfinite(errors).all()):
        raise ValueError(f"the loss at {evaluation.point} is {evaluation.loss}, errors {errors}")
