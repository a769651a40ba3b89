"""What a study has evaluated and proposed, kept in a database as soon as it is there."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError
from fascicle.inference.evaluation import Evaluation, Objective

# Points of a step (m, d), and the surrogates' hyper-parameters behind them, from a random generator
# and the hyper-parameters of the step before.
Compute = Callable[[np.random.Generator, str | None], tuple[str | None, Floats]]


class Stage(StrEnum):
    """A stage of a study; its place in this list seeds its random numbers."""

    INITIAL = "initial"
    OPTIMISATION = "optimisation"
    REJECTION = "rejection"
    REFINEMENT = "refinement"


@dataclass(frozen=True)
class Record:
    """An evaluation as it is stored: when in the study, and how long it took (s)."""

    stage: Stage
    evaluation: Evaluation
    seconds: float


class Database:
    """The SQLite file: evaluations in order, and what was proposed at each step."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._transaction() as connection:
            connection.execute(
                "CREATE TABLE IF NOT EXISTS evaluations (idx INTEGER PRIMARY KEY, stage TEXT "
                "NOT NULL, point BLOB NOT NULL, loss REAL, beat_errors BLOB NOT NULL, "
                "reason TEXT NOT NULL, seconds REAL NOT NULL)"
            )
            connection.execute(
                "CREATE TABLE IF NOT EXISTS proposals (stage TEXT NOT NULL, step INTEGER NOT NULL, "
                "hyperparameters TEXT, points BLOB NOT NULL, PRIMARY KEY (stage, step))"
            )

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a connection whose changes are on the disk when the block ends, all or none."""
        try:
            with closing(sqlite3.connect(self.path)) as connection:
                connection.execute("PRAGMA synchronous = FULL")
                with connection:
                    yield connection
        except sqlite3.IntegrityError as error:
            raise InputError(
                f"{self.path}: another process is writing to this study; wait for it or stop it"
            ) from error
        except sqlite3.OperationalError as error:
            raise InputError(
                f"{self.path}: {error}; check the disk, and that nothing else uses the study"
            ) from error
        except sqlite3.DatabaseError as error:
            raise InputError(
                f"{self.path}: {error}; the study cannot be read, start again in another folder "
                "(--out)"
            ) from error

    def records(self) -> list[Record]:
        """All evaluations, in the order in which they were made."""
        query = "SELECT stage, point, loss, beat_errors, reason, seconds FROM evaluations"
        with self._transaction() as connection:
            rows = connection.execute(f"{query} ORDER BY idx").fetchall()
        return [
            Record(
                Stage(stage),
                Evaluation.infeasible(_floats(point), reason)
                if loss is None
                else Evaluation(_floats(point), loss, _floats(errors)),
                seconds,
            )
            for stage, point, loss, errors, reason, seconds in rows
        ]

    def append(self, first: int, records: Sequence[Record]) -> None:
        """Store evaluations under the numbers `first`, and so on."""
        rows = [
            (
                first + k,
                record.stage,
                _bytes(record.evaluation.point),
                record.evaluation.loss if record.evaluation.feasible else None,
                _bytes(record.evaluation.beat_errors),
                record.evaluation.reason or "",
                record.seconds,
            )
            for k, record in enumerate(records)
        ]
        with self._transaction() as connection:
            connection.executemany("INSERT INTO evaluations VALUES (?, ?, ?, ?, ?, ?, ?)", rows)

    def steps(self, stage: Stage) -> int:
        """Count the proposals of a stage."""
        query = "SELECT count(*) FROM proposals WHERE stage = ?"
        with self._transaction() as connection:
            return int(connection.execute(query, (stage,)).fetchone()[0])

    def proposal(self, stage: Stage, step: int) -> tuple[str | None, Floats] | None:
        """Hyper-parameters and flat points of a step; None if it has not been taken."""
        query = "SELECT hyperparameters, points FROM proposals WHERE stage = ? AND step = ?"
        with self._transaction() as connection:
            row = connection.execute(query, (stage, step)).fetchone()
        return (row[0], _floats(row[1])) if row is not None else None

    def propose(self, stage: Stage, step: int, hyperparameters: str | None, points: Floats) -> None:
        """Store what a step proposes.

        Parameters
        ----------
        stage, step
            Which step, counted from 0 in its stage.
        hyperparameters : str, optional
            Of the surrogates behind it, as JSON.
        points : (m, d) array
            In the unit cube.
        """
        row = (stage, step, hyperparameters, _bytes(points))
        with self._transaction() as connection:
            connection.execute("INSERT INTO proposals VALUES (?, ?, ?, ?)", row)


@dataclass
class Journal:
    """One pass over a study: what is stored is read, what is missing is made and stored.

    Attributes
    ----------
    database : Database
        Where it is stored.
    objective : Objective
        Evaluates points.
    dimension : int
        d, the number of coordinates of a point.
    seed : int
        Of every random number.
    workers : int
        Evaluations at a time.
    records : list of Record
        What this pass has evaluated or read so far.
    """

    database: Database
    objective: Objective
    dimension: int
    seed: int
    workers: int
    records: list[Record] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self._stored = self.database.records()

    @property
    def evaluations(self) -> list[Evaluation]:
        """Those of `records`."""
        return [record.evaluation for record in self.records]

    def rng(self, stage: Stage, step: int) -> np.random.Generator:
        """The only source of randomness of a step."""
        return np.random.default_rng([self.seed, list(Stage).index(stage), step])

    def propose(self, stage: Stage, step: int, compute: Compute) -> Floats:
        """Give the points of a step, shape (m, d).

        Parameters
        ----------
        stage, step
            Which step, counted from 0 in its stage.
        compute : callable
            Makes the points where none are stored.
        """
        stored = self.database.proposal(stage, step)
        if stored is None:
            before = self.database.proposal(stage, step - 1)
            stored = compute(self.rng(stage, step), before[0] if before is not None else None)
            self.database.propose(stage, step, *stored)
        return stored[1].reshape(-1, self.dimension)

    def evaluate(self, stage: Stage, points: Sequence[Floats]) -> list[Evaluation]:
        """Give the outcomes at `points`, each of shape (d,)."""
        first = len(self.records)
        known = self._stored[first : first + len(points)]
        for number, (record, point) in enumerate(zip(known, points, strict=False), first):
            if not np.array_equal(record.evaluation.point, point):
                raise InputError(
                    f"{self.database.path}: evaluation {number} is not of the point that the "
                    "study proposes; the file was changed, start again in another folder (--out)"
                )
        self.records += known
        for start in range(len(known), len(points), self.workers):
            self._compute(stage, points[start : start + self.workers])
        return [record.evaluation for record in self.records[first:]]

    def _compute(self, stage: Stage, points: Sequence[Floats]) -> None:
        begin = time.perf_counter()
        outcomes = self.objective(points)
        seconds = (time.perf_counter() - begin) / len(points)
        new = [
            Record(stage, replace(outcome, point=point), seconds)
            for outcome, point in zip(outcomes, points, strict=True)
        ]
        for record in new:
            _check(record.evaluation)
        self.database.append(len(self.records), new)
        self.records += new


def _check(evaluation: Evaluation) -> None:
    """Refuse what the surrogate and the distance cannot use."""
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


def _bytes(array: Floats) -> bytes:
    return np.ascontiguousarray(array, dtype="<f8").tobytes()


def _floats(blob: bytes) -> Floats:
    return np.frombuffer(blob, dtype="<f8").astype(np.float64)
