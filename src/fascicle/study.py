"""A study on disk: its configuration, every evaluation, and resuming after any interruption.

A study is a folder with `study.json` and `evaluations.sqlite`. Everything that takes time or
chance is written down before it is used: each proposal of the optimisation with the
hyper-parameters behind it, each round of posterior candidates, each evaluation. To resume is to
run again from the start and to read what is there instead of computing it, so an interrupted
study and an uninterrupted one are the same program and give the same bits. Step k of a stage
draws from ``default_rng([seed, stage, k])`` and from nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fascicle.errors import InputError
from fascicle.evaluation import Evaluation, Objective
from fascicle.io.atomic import write_text
from fascicle.ledger import Ledger, Record
from fascicle.parameters import Parameter, ParameterSpace

if TYPE_CHECKING:
    from fascicle.posterior.result import Posterior
    from fascicle.posterior.sample import Sampling
    from fascicle.surrogate.observations import Observations

FORMAT = 1  # of the folder; raised when old studies can no longer be read
STAGES = ("initial", "optimisation", "posterior", "walk")
CONFIGURATION = "study.json"
DATABASE = "evaluations.sqlite"


class Progress(Protocol):
    """Told how far a stage is.

    The stages are "initial", "optimisation", "posterior" (accepted samples), within it "prior"
    (uniform draws of a round), and, where that falls short, "walk" (steps of the random walks).
    """

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """`done` of `total` in `stage`; `message` says more, for people."""


class FreeParameter(BaseModel):
    """A parameter that the study learns, with the range it is searched in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    unit: str
    lower: float
    upper: float


class StudyConfig(BaseModel):
    """All that decides the outcome of a study; two runs with equal ones give equal results.

    Attributes
    ----------
    heart, target : str
        Hashes of the heart and of the target.
    space : tuple of FreeParameter
        What is learnt.
    fixed : dict
        Values of the parameters that are not learnt.
    gain : bool
        Whether a global gain of the simulated ECG is fitted.
    initial, steps, samples : int
        Latin hypercube points, points of the optimisation, posterior samples.
    batch : int
        Points evaluated at once; the optimisation also proposes as many at once.
    draws : int
        Uniform draws for the informed prior, each round.
    candidate_order : {"random", "density"}
        Order in which its draws are tried; "density" is the paper's and finds modes.
    tolerance, patience, rounds
        See `fascicle.posterior.sample.Rules`.
    sweeps : int
        Steps of the random walks that complete the sample; see `fascicle.posterior.walk`.
    seed : int
        Of all random numbers.
    version : int
        Format of the study folder.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    heart: str
    target: str
    space: tuple[FreeParameter, ...] = Field(min_length=1)
    fixed: dict[str, float] = Field(default_factory=dict)
    gain: bool = False
    initial: int = Field(default=250, ge=2)
    steps: int = Field(default=300, ge=0)
    samples: int = Field(default=30, ge=1)
    batch: int = Field(default=1, ge=1)
    draws: int = Field(default=5_000_000, ge=1)
    candidate_order: Literal["random", "density"] = "random"
    tolerance: float = Field(default=0.9, gt=0, le=1)
    patience: int = Field(default=50, ge=1)
    rounds: int = Field(default=4, ge=1)
    sweeps: int = Field(default=100, ge=1)
    seed: int = Field(default=0, ge=0)
    version: int = FORMAT

    @staticmethod
    def free(space: ParameterSpace) -> tuple[FreeParameter, ...]:
        """Make the `space` field for a parameter space."""
        return tuple(
            FreeParameter(name=p.name, unit=p.unit, lower=p.lower, upper=p.upper)
            for p in space.parameters
        )

    def parameter_space(self) -> ParameterSpace:
        """Give the parameter space that is learnt."""
        return ParameterSpace(
            tuple(Parameter(p.name, p.unit, p.lower, p.upper) for p in self.space)
        )


class Study:
    """A study folder.

    Attributes
    ----------
    folder : Path
    config : StudyConfig
    """

    def __init__(self, folder: Path, config: StudyConfig) -> None:
        self.folder = folder
        self.config = config
        self._ledger = Ledger(folder / DATABASE)

    @classmethod
    def create_or_resume(cls, folder: Path, config: StudyConfig) -> Study:
        """Open the study in `folder`, a new one if the folder is empty or missing.

        Raises
        ------
        InputError
            If the folder holds something else, or a study with other settings.
        """
        if (folder / CONFIGURATION).exists():
            _check_same(folder, _read(folder), config)
            return cls(folder, config)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # A run killed while it wrote study.json leaves only its temporary file.
            foreign = [path for path in folder.iterdir() if not path.name.startswith(".study.")]
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}; give another folder (--out)") from error
        if foreign:
            raise InputError(
                f"{folder}: not a study (it has no {CONFIGURATION}) and not empty; "
                "give another folder (--out)"
            )
        write_text(folder / CONFIGURATION, config.model_dump_json(indent=2) + "\n")
        return cls(folder, config)

    @classmethod
    def open(cls, folder: Path) -> Study:
        """Open the study that is in `folder`, to look at it or to resume it as it is."""
        if not (folder / CONFIGURATION).exists():
            raise InputError(f"{folder}: not a study; it has no {CONFIGURATION}")
        return cls(folder, _read(folder))

    def records(self) -> list[Record]:
        """All evaluations so far, in the order in which they were made."""
        return self._ledger.records()

    def run(self, objective: Objective, progress: Progress) -> Posterior:
        """Do what is left of the study, and give its result.

        A finished study gives its result again without evaluating anything.

        Parameters
        ----------
        objective : Objective
            Must give the same result for the same point whenever it is asked.
        progress : Progress
            Told about every batch of evaluations.
        """
        return _Run(self.config, self._ledger, objective, progress).posterior()


class _Run:
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

    def posterior(self) -> Posterior:
        self._initial()
        self._optimise()
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
        missing = list(points[len(known) :])
        fresh = self._compute(stage, first + len(known), missing) if missing else []
        self.evaluations += [*known, *fresh]
        return [*known, *fresh]

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
        from fascicle.bo.design import latin_hypercube

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

    def _step(self, rng: np.random.Generator, size: int) -> tuple[str, NDArray[np.float64]]:
        from fascicle.bo.step import State, step

        state = State.from_json(self._observations(), self.hyperparameters)
        fitted, points = step(rng, state, size)
        return fitted.hyperparameters_to_json(), points

    def _observations(self) -> Observations:
        """What the surrogates learn from: the logarithm of every loss so far."""
        from fascicle.surrogate.observations import Observations

        return Observations.of(self.evaluations).logarithmic()

    def _report(self, stage: str, done: int, total: int) -> None:
        losses = [evaluation.loss for evaluation in self.evaluations if evaluation.feasible]
        best = f"best loss {min(losses):.4g} mV²" if losses else "no tree yet"
        self.progress(stage, done, total, best)

    def _sample(self) -> Sampling:
        from fascicle.posterior.sample import Rules, sample
        from fascicle.posterior.walk import propose, walk

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
        from fascicle.bo.step import State, refit
        from fascicle.posterior.prior import InformedPrior, draw_candidates
        from fascicle.posterior.sample import best_of

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
        from fascicle.posterior.result import Posterior

        accepted, best = sampling.accepted, sampling.reference
        points = np.array([e.point for e in accepted]).reshape(-1, len(self.space))
        named = [self.space.from_unit(point) for point in points]
        return Posterior(
            points=points,
            values={n: np.array([values[n] for values in named]) for n in self.space.names},
            losses=np.array([evaluation.loss for evaluation in accepted]),
            distances=sampling.distances,
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


def _read(folder: Path) -> StudyConfig:
    path = folder / CONFIGURATION
    try:
        return StudyConfig.model_validate_json(path.read_text(encoding="utf-8"))
    except (ValidationError, UnicodeDecodeError) as error:
        where = "not text"
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            where = f"{'.'.join(map(str, first['loc'])) or 'JSON'}: {first['msg']}"
        raise InputError(
            f"{path}: not a configuration that this version reads ({where}); "
            "give another folder (--out)"
        ) from error


def _check_same(folder: Path, there: StudyConfig, now: StudyConfig) -> None:
    """Refuse to mix two studies in one folder."""
    different = [n for n in StudyConfig.model_fields if getattr(there, n) != getattr(now, n)]
    if different:
        told = ", ".join(_difference(n, getattr(there, n), getattr(now, n)) for n in different)
        raise InputError(
            f"{folder}: holds a study with another {told}; give another folder (--out) "
            "or the original settings"
        )


def _difference(name: str, there: object, now: object) -> str:
    if isinstance(there, (tuple, dict)):
        return name
    return f"{name} ({there} there, {now} now)"
