"""Evaluations and proposals of a study, stored in a database as soon as they are made.

An evaluation is the loss and the log-likelihood of the network at a point of the unit cube; a
proposal is the set of points that a step of the inference asks to be evaluated.
"""

from __future__ import annotations

import os
import signal
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line
from fascicle.inference.evaluation import Evaluation, Objective

# Makes the surrogates' hyper-parameters and the points (m, d) of a step, from a random generator
# and the hyper-parameters of the step before.
Compute = Callable[[np.random.Generator, str | None], tuple[str | None, Floats]]


class Stage(StrEnum):
    """Stage of a study, whose position in this list seeds its random numbers."""

    INITIAL = "initial"
    OPTIMISATION = "optimisation"
    REJECTION = "rejection"
    SAMPLING = "sampling"


@dataclass(frozen=True)
class Record:
    """Stored evaluation, with its stage of the study and the time (s) that it took."""

    stage: Stage
    evaluation: Evaluation
    seconds: float


class DamagedStoreError(InputError):
    """Raised if a database cannot be read."""


class Database:
    """SQLite file of the evaluations, in order, and of the proposals of each step."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def prepare(self) -> Path | None:
        """Make missing tables; return the new path of a damaged file if one was moved aside."""
        try:
            self._make_tables()
            self.records()
        except DamagedStoreError:
            aside = self.path.with_suffix(f".damaged{self.path.suffix}")
            for ending in ("", "-wal", "-shm"):
                if (part := Path(f"{self.path}{ending}")).exists():
                    os.replace(part, f"{aside}{ending}")
            self._make_tables()
            return aside
        return None

    def _make_tables(self) -> None:
        with self._transaction() as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute(
                "CREATE TABLE IF NOT EXISTS evaluations (stage TEXT NOT NULL, point BLOB NOT NULL, "
                "loss REAL, beat_errors BLOB NOT NULL, log_likelihoods BLOB NOT NULL, "
                "reason TEXT NOT NULL, seconds REAL NOT NULL)"
            )
            connection.execute(
                "CREATE TABLE IF NOT EXISTS proposals (stage TEXT NOT NULL, step INTEGER NOT NULL, "
                "hyperparameters TEXT, points BLOB NOT NULL, PRIMARY KEY (stage, step))"
            )
            (verdict,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
            if verdict != "ok":
                raise sqlite3.DatabaseError(verdict)

    def records(self) -> list[Record]:
        """Evaluations, in the order in which they were made."""
        with self._transaction() as connection:
            rows = connection.execute("SELECT * FROM evaluations ORDER BY rowid").fetchall()
            return [_record(row) for row in rows]

    def append(self, records: Sequence[Record]) -> None:
        """Store evaluations; they are on the disk when the function returns."""
        with self._transaction() as connection:
            rows = [_row(record) for record in records]
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
            return None if row is None else (row[0], _floats(row[1]))

    def propose(self, stage: Stage, step: int, hyperparameters: str | None, points: Floats) -> None:
        """Store the points (m, d) proposed by a step, counted from 0 in its stage."""
        row = str(stage), step, hyperparameters, _bytes(points)
        with self._transaction() as connection:
            connection.execute("INSERT INTO proposals VALUES (?, ?, ?, ?)", row)

    def forget_proposals(self, kept: Sequence[Stage]) -> None:
        """Delete the proposals of all stages but `kept`; evaluations stay."""
        marks = ", ".join("?" for _ in kept)
        with self._transaction() as connection:
            connection.execute(f"DELETE FROM proposals WHERE stage NOT IN ({marks})", tuple(kept))

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a connection whose changes are all on the disk when the block ends, or none."""
        place = self.path.absolute().as_uri()
        if not (os.access(self.path.parent, os.W_OK) or Path(f"{self.path}-wal").exists()):
            place += "?immutable=1"  # SQLite cannot write a log into a read-only folder
        try:
            with closing(sqlite3.connect(place, uri=True)) as connection:
                connection.execute("PRAGMA synchronous = FULL")
                with connection:
                    yield connection
        except (sqlite3.DatabaseError, ValueError, TypeError) as error:
            # the lowest byte tells errors of access from those of the file's content
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
            if code not in (
                sqlite3.SQLITE_BUSY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL,
                sqlite3.SQLITE_IOERR, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PERM,
                sqlite3.SQLITE_READONLY,
            ):  # fmt: skip
                raise DamagedStoreError(
                    f"{self.path}: damaged ({one_line(error)}); run 'fascicle fit' on the study "
                    "again, which moves it aside and evaluates again"
                ) from error
            raise InputError(
                f"{self.path}: {error}; see that the disk has space, that the file can be written, "
                "and that nothing else uses it; the same command then goes on"
            ) from error


def _row(record: Record) -> tuple[Any, ...]:
    evaluation = record.evaluation
    return (
        str(record.stage),
        _bytes(evaluation.point),
        float(evaluation.loss) if evaluation.feasible else None,
        _bytes(evaluation.beat_errors),
        _bytes(evaluation.log_likelihoods),
        evaluation.reason or "",
        float(record.seconds),
    )


def _record(row: tuple[Any, ...]) -> Record:
    stage, point, loss, errors, log_likelihoods, reason, seconds = row
    if loss is None:
        return Record(Stage(stage), Evaluation.infeasible(_floats(point), reason), seconds)
    likelihoods = _floats(log_likelihoods)
    evaluation = Evaluation(_floats(point), loss, _floats(errors), log_likelihoods=likelihoods)
    return Record(Stage(stage), evaluation, seconds)


@dataclass
class Journal:
    """Run of a study, which reads stored proposals and evaluations and computes missing ones."""

    database: Database
    objective: Objective
    dimension: int  # d, the number of coordinates of a point
    seed: int
    workers: int  # evaluations at a time
    # all stored evaluations, of this run or an earlier one, by the bytes of their points
    evaluated: dict[bytes, Record] = field(init=False)
    records: list[Record] = field(default_factory=list, init=False)  # used by this run, in order

    def __post_init__(self) -> None:
        self.evaluated = {_bytes(r.evaluation.point): r for r in self.database.records()}

    @property
    def evaluations(self) -> list[Evaluation]:
        """Evaluations of `records`."""
        return [record.evaluation for record in self.records]

    def rng(self, stage: Stage, step: int) -> np.random.Generator:
        """Random generator of a step, which uses no other."""
        return np.random.default_rng([self.seed, list(Stage).index(stage), step])

    def propose(self, stage: Stage, step: int, compute: Compute) -> Floats:
        """Return the points of a step, counted from 0 in its stage, stored or computed now."""
        stored = self.database.proposal(stage, step)
        if stored is None:
            before = self.database.proposal(stage, step - 1)
            stored = compute(self.rng(stage, step), before[0] if before is not None else None)
            self.database.propose(stage, step, *stored)
        return stored[1].reshape(-1, self.dimension)

    def evaluate(
        self,
        stage: Stage,
        points: Sequence[Floats],
        batch: int | None = None,
        progress: Callable[[int], None] = lambda done: None,
    ) -> list[Evaluation]:
        """Return the evaluations at `points`, each of shape (d,).

        Points that were not evaluated yet are evaluated now, and stored in batches of `batch`, or
        else `workers`. Ctrl-C waits for a batch to be stored. `progress` is called with the number
        of evaluated points after each batch, or once if no point was missing.
        """
        keys = [_bytes(point) for point in points]
        missing = {k: p for k, p in zip(keys, points, strict=True) if k not in self.evaluated}
        points_left = list(missing.values())
        size = batch or self.workers
        # closed at once when interrupted, so that no worker begins another evaluation
        with closing(
            outcome for outcome in (self.objective(points_left) if points_left else ())
        ) as outcomes:
            for start in range(0, len(points_left), size):
                with interrupted_afterwards():
                    self._store(stage, points_left[start : start + size], outcomes)
                progress(len(points) - max(0, len(points_left) - start - size))
        if not points_left:
            progress(len(points))
        # a point may have been evaluated in another stage of a run with fewer steps
        records = [replace(self.evaluated[key], stage=stage) for key in keys]
        self.records += records
        return [record.evaluation for record in records]

    def _store(
        self, stage: Stage, points: Sequence[Floats], outcomes: Iterator[Evaluation]
    ) -> None:
        """Take the next outcomes, at `points`, and store them."""
        begin = time.perf_counter()
        evaluations = [replace(next(outcomes), point=point) for point in points]
        seconds = (time.perf_counter() - begin) / len(points)
        for evaluation in evaluations:
            _check(evaluation)
        new = [Record(stage, evaluation, seconds) for evaluation in evaluations]
        self.database.append(new)
        self.evaluated |= {_bytes(record.evaluation.point): record for record in new}


def _check(evaluation: Evaluation) -> None:
    """Refuse an evaluation that the inference cannot use."""
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


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block; a second Ctrl-C interrupts at once.

    Nothing is changed if Ctrl-C is ignored, or in a thread other than the main thread, which alone
    receives signals.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or not callable(signal.getsignal(signal.SIGINT)):
        yield
        return
    pressed = False

    def remember(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        signal.raise_signal(signal.SIGINT)  # for the handler set before
