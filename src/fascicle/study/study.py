"""A study on disk: its configuration, every evaluation, and resuming after any interruption.

A study is a folder with `study.json` and `evaluations.sqlite`. Everything that takes time or
chance is written down before it is used: each proposal of the optimisation with the
hyper-parameters behind it, each round of candidates, each evaluation. To resume is to
run again from the start and to read what is there instead of computing it, so an interrupted
study and an uninterrupted one are the same program and give the same bits. Step k of a stage
draws from ``default_rng([seed, stage, k])`` and from nothing else.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from pydantic import Field, ValidationError

from fascicle.core.errors import InputError
from fascicle.core.files import write_text
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.core.progress import Progress
from fascicle.inference.evaluation import Objective
from fascicle.study.evaluations import Database, Journal, Record, Stage
from fascicle.study.population import Population
from fascicle.study.settings import FitSettings, first_problem

CONFIGURATION = "study.json"
DATABASE = "evaluations.sqlite"
FORMAT: Final = 4  # of the folder


class StudyConfig(FitSettings):
    """All that decides the outcome of a study; two runs with equal ones give equal results.

    Attributes
    ----------
    heart, target : str
        Hashes of the heart and of the target.
    space : tuple of Parameter
        What is learnt, in which ranges and with which priors.
    fixed : dict of name to float
        Quantities that are held at other values than their defaults.
    version : int
        Format of the study folder.
    """

    heart: str
    target: str
    space: tuple[Parameter, ...] = Field(min_length=1)
    fixed: dict[str, float] = Field(default_factory=dict)
    version: Literal[4] = FORMAT

    @property
    def parameter_space(self) -> ParameterSpace:
        """The parameter space that is learnt."""
        return ParameterSpace(self.space)


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
        self._database = Database(folder / DATABASE)

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
        return self._database.records()

    def steps(self, stage: Stage) -> int:
        """Count the times that a stage has proposed points so far."""
        return self._database.steps(stage)

    def run(self, objective: Objective, progress: Progress | None = None) -> Population:
        """Do what is left of the study, and give its result.

        A finished study gives its result again without evaluating anything.

        Parameters
        ----------
        objective : Objective
            Must give the same result for the same point whenever it is asked.
        progress : Progress, optional
            Called after every batch of evaluations.
        """
        from fascicle.study import paper, posterior  # the surrogate, which only a fit needs

        config, space = self.config, self.config.parameter_space
        journal = Journal(self._database, objective, len(space), config.seed, config.workers)
        method = {"paper": paper.Run, "posterior": posterior.Run}[config.method]
        return method(config, space, journal, progress).population()


def _read(folder: Path) -> StudyConfig:
    path = folder / CONFIGURATION
    try:
        return StudyConfig.model_validate_json(path.read_text(encoding="utf-8"))
    except (ValidationError, UnicodeDecodeError) as error:
        where = "not text"
        if isinstance(error, ValidationError):
            name, _, message = first_problem(error)
            where = f"{name or 'JSON'}: {message}"
            if name == "version":
                where = "made by another version of fascicle, with which losses cannot be compared"
        raise InputError(
            f"{path}: not a configuration that this version reads ({where}); "
            "give another folder (--out)"
        ) from error


def _check_same(folder: Path, there: StudyConfig, now: StudyConfig) -> None:
    """Refuse to mix two studies in one folder."""
    different = [n for n in StudyConfig.model_fields if getattr(there, n) != getattr(now, n)]
    if different:
        listed = ", ".join(_difference(n, getattr(there, n), getattr(now, n)) for n in different)
        raise InputError(
            f"{folder}: holds a study with another {listed}; give another folder (--out) "
            "or the original settings"
        )


def _difference(name: str, there: object, now: object) -> str:
    return name if isinstance(there, tuple) else f"{name} ({there} there, {now} now)"
