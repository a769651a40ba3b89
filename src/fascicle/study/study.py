"""A study on disk: its configuration, every evaluation, and resuming after any interruption.

A study is a folder with `study.json` and `evaluations.sqlite`. All that takes time or is random is
stored before it is used: each proposal of the optimisation with the hyper-parameters behind it,
each round of candidates, each evaluation. A resumed study runs again from the start, and reads what
is stored instead of computing it; it therefore takes the same steps as a study that was never
interrupted, with exactly the same result. Step k of a stage draws from
``default_rng([seed, number of the stage, k])`` alone.

One process at a time works on a study (`study_lock`). All stored evaluations must come
from one forward model. To check this, a few of them are repeated, and the losses compared.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, Final, Literal

import numpy as np
from filelock import FileLock, Timeout
from pydantic import ConfigDict, Field, ValidationError

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.core.files import write_text
from fascicle.core.parameters import Parameter, ParameterSpace
from fascicle.core.progress import Progress
from fascicle.inference.evaluation import Evaluation, Objective
from fascicle.networks.prior import AveragedOver, Prior
from fascicle.networks.settings import FitSettings, first_problem
from fascicle.purkinje.growth import REPULSION
from fascicle.study.evaluations import Database, Journal, Record, Stage
from fascicle.study.population import RESULT, Population

STUDY_FORMAT: Final = 8  # version of the folder's format


class StudyFile(StrEnum):
    """File or folder in a study's folder."""

    CONFIGURATION = "study.json"
    DATABASE = "evaluations.sqlite"
    HEART = "heart"
    STATES = "states"  # studies of conduction states
    LOCK = ".study.lock"  # released by the operating system when its process ends


class StudyConfig(FitSettings):
    """Configuration of a study: studies with equal configurations have equal results.

    A study can be resumed with an equal configuration, but for the fields of `may_change`. Heart,
    targets and scenarios are identified by digests.
    """

    # a delay may be infinite, which strict JSON cannot hold
    model_config = ConfigDict(ser_json_inf_nan="constants")

    heart: str
    target: str  # digest of the first recording's target
    other_targets: tuple[str, ...] = ()
    scenarios: tuple[str, ...] = Field(default=("",), min_length=1)  # "" for intrinsic beats
    space: tuple[Parameter, ...] = Field(min_length=1)  # learnt parameters
    fixed: dict[str, float] = Field(default_factory=dict)  # values other than the defaults
    growth: dict[str, float]  # growth rules, which `fixed` may override
    growth_term: str = REPULSION.function.__name__  # name of the function of a GrowthTerm
    conduction: dict[str, float | None]  # of the tissues, likewise; None: derived from others
    likelihood: dict[str, float | str] = Field(default_factory=dict)  # constants, of a posterior
    averaged: tuple[Parameter, ...] = ()  # quantities averaged over
    tissues: tuple[dict[str, float], ...] = ({},)  # tissues, or hearts, averaged over
    tissue_weights: tuple[float, ...] = ()  # their prior probabilities; empty: all the same
    states: dict[str, float] = Field(default_factory=dict)  # priors of conduction states, if learnt
    mapped: bool = False  # whether intrinsic beats are activated like mapped human hearts
    share: float = 1.0  # of this conduction state in the draws of the whole study
    version: Literal[8] = STUDY_FORMAT  # of the folder's format

    may_change: ClassVar = ("workers", "steps", "samples", "effective", "share")

    @property
    def prior(self) -> Prior:
        """Prior of the study, a mixture of its conduction states."""
        averaged = AveragedOver(ParameterSpace(self.averaged), self.tissues, self.tissue_weights)
        return Prior(ParameterSpace(self.space), self.fixed, averaged, self.states, self.mapped)


class Study:
    """A study folder."""

    checked: ClassVar[int] = 4  # number of stored evaluations that are repeated
    # relative, of losses: above rounding on other machines, below changes of the model
    tolerance: ClassVar[float] = 1e-6

    def __init__(self, folder: Path, config: StudyConfig) -> None:
        self.folder = folder
        self.config = config
        self._database = Database(folder / StudyFile.DATABASE)

    @classmethod
    def create_or_resume(
        cls, folder: Path, config: StudyConfig, progress: Progress | None = None
    ) -> Study:
        """Open the study in `folder`, or make a new one if the folder is empty or missing.

        `progress` is called if the database was damaged, and was moved aside.
        """
        check_study_folder(folder)
        with study_lock(folder):
            if (folder / StudyFile.CONFIGURATION).exists():
                check_same(folder, _read(folder), config)
            else:
                write_text(
                    folder / StudyFile.CONFIGURATION, config.model_dump_json(indent=2) + "\n"
                )
            _remove_leftovers(folder)
            study = cls(folder, config)
            aside = study._database.prepare()
        if aside is not None and progress is not None:
            progress("repair", 1, 1, f"{StudyFile.DATABASE} was damaged, and is now {aside.name}")
        return study

    @classmethod
    def open(cls, folder: Path) -> Study:
        """Open the study that is in `folder`, to look at it or to resume it as it is."""
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder; give that of a study")
        if not (folder / StudyFile.CONFIGURATION).exists():
            raise InputError(f"{folder}: not a study; it has no {StudyFile.CONFIGURATION}")
        if not (folder / StudyFile.DATABASE).is_file():
            raise InputError(
                f"{folder}: the study has no {StudyFile.DATABASE}; run 'fascicle fit' on it again"
            )
        return cls(folder, _read(folder))

    def records(self) -> list[Record]:
        """Evaluations so far, in the order in which they were made, then those of its states.

        Points of a conduction state lie in the unit cube of that state's prior.
        """
        databases = sorted(self.folder.glob(f"{StudyFile.STATES}/*/{StudyFile.DATABASE}"))
        all_databases = (self._database, *(Database(path) for path in databases))
        return [record for database in all_databases for record in database.records()]

    def steps(self, stage: Stage) -> int:
        """Count the times that a stage has proposed points so far."""
        return self._database.steps(stage)

    def run(
        self,
        objective: Objective,
        progress: Progress | None = None,
        emulated: Sequence[Callable[[Floats], Floats]] = (),
    ) -> Population:
        """Run the study from where it was interrupted, and return its result.

        A posterior needs the emulated log-likelihoods of each recording.

        A finished study returns its stored result. A few stored points are evaluated again, to
        check that the forward model has not changed: `objective` must be deterministic.
        """
        with study_lock(self.folder):
            self.check_objective(objective)
            self._take_over()
            from fascicle.study import methods  # slow to import, and only a fit needs them

            config, prior = self.config, self.config.prior
            seed, batch = config.seed, config.batch
            journal = Journal(self._database, objective, prior.dimension, seed, batch)
            if config.method == "paper":
                return methods.PaperFit(config, prior.learnt, journal, progress).run()
            return methods.PosteriorFit(
                config, prior, journal, emulated, progress, config.share
            ).run()

    def check_objective(self, objective: Objective) -> None:
        """Refuse a forward model that differs from that of the stored evaluations."""
        evaluations = [record.evaluation for record in self._database.records()]
        sample = evaluations[:: max(1, len(evaluations) // self.checked)][: self.checked]
        if not sample:
            return
        for stored, repeated in zip(sample, objective([e.point for e in sample]), strict=True):
            if not _same(stored, repeated):
                raise InputError(
                    f"{self.folder}: holds a study with another forward model (at one point of it "
                    f"{_outcome(stored)} then, {_outcome(repeated)} now); give another folder "
                    "(out), or go on with the version of fascicle that began it"
                )

    def _take_over(self) -> None:
        """Store the settings of this run that may differ (`StudyConfig.may_change`).

        The result is removed first, since its presence means that the study is finished. If the
        process is killed before the settings are written, the next run does this again.
        """
        stored = _read(self.folder)
        if stored == self.config:
            return
        if stored != self.config.model_copy(update={"workers": stored.workers}):
            (self.folder / RESULT[self.config.method]).unlink(missing_ok=True)
            # proposals of these stages do not depend on the numbers that may change
            self._database.forget_proposals((Stage.INITIAL, Stage.OPTIMISATION))
        write_text(
            self.folder / StudyFile.CONFIGURATION, self.config.model_dump_json(indent=2) + "\n"
        )


class HeldError(InputError):
    """Raised if another process, or another thread, works on a study."""


@contextmanager
def study_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a study's folder, made if it is missing; the lock may be nested."""
    lock = FileLock(folder.resolve() / StudyFile.LOCK, blocking=False, is_singleton=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise HeldError(
            f"{folder}: another process is working on this study; wait for it or stop it"
        ) from None
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); give another folder (out)"
        ) from None
    try:
        yield
    finally:
        lock.release()


def check_study_folder(folder: Path) -> None:
    """Refuse a folder that holds files but no study."""
    if not folder.exists():
        return
    try:
        # A run killed while it wrote study.json leaves only its temporary file, and the lock.
        foreign = [path for path in folder.iterdir() if not path.name.startswith(".study.")]
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}; give another folder (out)") from error
    if foreign and not (folder / StudyFile.CONFIGURATION).exists():
        raise InputError(
            f"{folder}: not a study (it has no {StudyFile.CONFIGURATION}) and not empty; "
            "give another folder (out)"
        )


def is_finished(folder: Path, config: StudyConfig) -> bool:
    """True if a folder holds the finished study of a configuration."""
    check_study_folder(folder)
    if not (folder / StudyFile.CONFIGURATION).exists():
        return False
    stored = _read(folder)
    check_same(folder, stored, config)
    unchanged = stored == config.model_copy(update={"workers": stored.workers})
    return unchanged and (folder / RESULT[config.method]).exists()


def _remove_leftovers(folder: Path) -> None:
    """Remove temporary files and folders of runs that were killed."""
    temporary = r"\.(study|evaluations|posterior|population|summary|activation|heart|networks|"
    temporary += r"(target|scenario)(-\d+)?)\..*"
    for path in folder.glob(".*"):
        if path.name == StudyFile.LOCK or not re.fullmatch(temporary, path.name):
            continue
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _same(stored: Evaluation, repeated: Evaluation) -> bool:
    """True if two evaluations of one point agree, as if made by one forward model."""
    if not (stored.feasible and repeated.feasible):
        return stored.feasible == repeated.feasible
    if not np.isclose(repeated.loss, stored.loss, rtol=Study.tolerance, atol=0):
        return False
    repeated_logs, stored_logs = repeated.log_likelihoods, stored.log_likelihoods
    if len(repeated_logs) != len(stored_logs):  # a study is opened without its likelihoods
        return True
    return bool(np.allclose(repeated_logs, stored_logs, rtol=0, atol=1e-3))


def _outcome(evaluation: Evaluation) -> str:
    if not evaluation.feasible:
        return "no network"
    loss, likelihood = f"{evaluation.loss:.6g} mV²", evaluation.log_likelihood
    return loss if np.isnan(likelihood) else f"{loss} and log likelihood {likelihood:.4f}"


def _read(folder: Path) -> StudyConfig:
    path, remedy = folder / StudyFile.CONFIGURATION, "give another folder (out)"
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text)
    except ValueError:  # of UTF-8, of JSON
        raise InputError(f"{path}: not JSON, so no configuration of a study; {remedy}") from None
    version = content.get("version", STUDY_FORMAT) if isinstance(content, dict) else STUDY_FORMAT
    if version != STUDY_FORMAT:
        raise InputError(
            f"{path}: a study of format {version}, made by another version of fascicle, with which "
            f"losses cannot be compared (this one has format {STUDY_FORMAT}); fit it again into "
            f"another folder, or read it with the version that made it"
        )
    try:
        return StudyConfig.model_validate_json(text)
    except ValidationError as error:
        name, _, message = first_problem(error)
        raise InputError(
            f"{path}: not a configuration that this version reads ({name or 'JSON'}: {message}); "
            f"{remedy}"
        ) from error


def check_same(folder: Path, stored: StudyConfig, now: StudyConfig) -> None:
    """Refuse a configuration that differs from the stored one beyond `StudyConfig.may_change`."""
    if stored.growth_term != now.growth_term:
        raise InputError(
            f"{folder}: its networks grow by the term '{stored.growth_term}', not by "
            f"'{now.growth_term}'; give fascicle.fit or fascicle.load_study the same rules="
        )
    before, after = _identity(stored), _identity(now)
    digests = {  # which say nothing to readers
        "heart": "of another heart", "target": "of another target",
        "other_targets": "with other further targets", "scenarios": "with other scenarios",
        "tissue_weights": "of another person (--sex, --age, --height, --weight)",
    }  # fmt: skip
    different = [
        digests.get(name)
        or f"{name}: there {before.get(name, 'none')}, now {after.get(name, 'none')}"
        for name in before | after
        if before.get(name) != after.get(name)
    ]
    if not different and stored.prior.names != now.prior.names:
        different = ["the order of the parameters"]
    if different:
        listed = "; ".join(different[:3])
        more = f"; and {len(different) - 3} more" if len(different) > 3 else ""
        raise InputError(
            f"{folder}: holds another study ({listed}{more}); choose another folder (out), or give "
            "the settings, inputs and growth rules of that study"
        )


def _identity(config: StudyConfig) -> dict[str, str]:
    """Texts of all settings and inputs that decide the outcome, by their names in messages."""
    identity: dict[str, str] = {}
    for name in StudyConfig.model_fields:
        value = getattr(config, name)
        if name in ("space", "averaged"):
            role = "learnt" if name == "space" else "averaged over"
            identity |= {parameter.name: f"{role} ({_prior(parameter)})" for parameter in value}
        elif isinstance(value, dict):  # fixed, growth, conduction, likelihood
            label = "" if name == "fixed" else f"{name} "
            identity |= {f"{label}{key}": _number(number) for key, number in value.items()}
        elif name not in (*StudyConfig.may_change, "growth_term"):
            identity[name] = f"{value}"
    return identity


def _prior(parameter: Parameter) -> str:
    middle = f", median {parameter.median:.15g}, sd {parameter.sd:.15g}" if parameter.median else ""
    place = "" if parameter.order is None else ", number {} of {} in order".format(*parameter.order)
    return f"{parameter.prior} {parameter.lower:.15g} to {parameter.upper:.15g}{middle}{place}"


def _number(value: float | str | None) -> str:
    if isinstance(value, str):
        return value
    return "none" if value is None else f"{value:.15g}"
