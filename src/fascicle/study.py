"""A study on disk: its configuration, every evaluation, and resuming after any interruption.

A study is a folder with `study.json` and `evaluations.sqlite`. Everything that takes time or
chance is written down before it is used: each proposal of the optimisation with the
hyper-parameters behind it, each round of posterior candidates, each evaluation. To resume is to
run again from the start and to read what is there instead of computing it, so an interrupted
study and an uninterrupted one are the same program and give the same bits. Step k of a stage
draws from ``default_rng([seed, stage, k])`` and from nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fascicle.errors import InputError
from fascicle.evaluation import Objective
from fascicle.io.atomic import write_text
from fascicle.ledger import Ledger, Record
from fascicle.parameters import Parameter, ParameterSpace

if TYPE_CHECKING:
    from fascicle.posterior.result import Posterior

FORMAT = 1  # of the folder; raised when old studies can no longer be read
CONFIGURATION = "study.json"
DATABASE = "evaluations.sqlite"


class Progress(Protocol):
    """Told how far a stage is.

    The stages of a study are "initial", "optimisation", "refinement", "posterior" (accepted
    samples), within it "prior" (uniform draws of a round), and, where that falls short, "walk"
    (steps of the random walks); before them come "compilation" and "preparation" of a large heart.
    """

    def __call__(self, stage: str, done: int, total: int, message: str) -> None:
        """`done` of `total` in `stage`; `message` says more, for people."""


def stage_of(
    progress: Progress | None, stage: str, message: str = ""
) -> Callable[[int, int], None] | None:
    """What tells `progress` how far one stage is, for code that knows of no others."""
    if progress is None:
        return None

    def told(done: int, total: int) -> None:
        progress(stage, done, total, message)

    return told


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
    gain: bool = False
    initial: int = Field(default=250, ge=2)
    steps: int = Field(default=300, ge=0)
    refine: int = Field(default=200, ge=0)
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
        if not (folder / DATABASE).is_file():
            raise InputError(
                f"{folder}: the study has no {DATABASE}; run 'fascicle fit' on it again"
            )
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
        from fascicle.stages import Run

        return Run(self.config, self._ledger, objective, progress).posterior()


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
