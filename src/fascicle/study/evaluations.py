"""What a study has evaluated and proposed, kept in a database as soon as it is there."""

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

# Points of a step (m, d), and the surrogates' hyper-parameters behind them, from a random generator
# and the hyper-parameters of the step before.
Compute = Callable[[np.random.Generator, str | None], tuple[str | None, Floats]]


class Stage(StrEnum):
    """A stage of a study; its place in this list seeds its random numbers."""

    INITIAL = "initial"
    OPTIMISATION = "optimisation"
    REJECTION = "rejection"
    SAMPLING = "sampling"


@dataclass(frozen=True)
class Record:
    """An evaluation as it is stored: when in the study, and how long it took (s)."""

    stage: Stage
    evaluation: Evaluation
    seconds: float


class DamagedStoreError(InputError):
    """A database cannot be read."""


class Database:
    """The SQLite file: evaluations as they were made, and what was proposed at each step."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def prepare(self) -> Path | None:
        """Make missing tables; where a damaged file, replaced by a new one, has been moved."""
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
        """All evaluations, in the order in which they were made."""
        with self._transaction() as connection:
            rows = connection.execute("SELECT * FROM evaluations ORDER BY rowid").fetchall()
            return [_record(row) for row in rows]

    def append(self, records: Sequence[Record]) -> None:
        """Store evaluations, which are on the disk when this returns."""
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
        """Store what a step, counted from 0 in its stage, proposes: points (m, d)."""
        row = str(stage), step, hyperparameters, _bytes(points)
        with self._transaction() as connection:
            connection.execute("INSERT INTO proposals VALUES (?, ?, ?, ?)", row)

    def forget_proposals(self, kept: Sequence[Stage]) -> None:
        """Drop what was proposed in other stages than these; evaluations stay."""
        marks = ", ".join("?" for _ in kept)
        with self._transaction() as connection:
            connection.execute(f"DELETE FROM proposals WHERE stage NOT IN ({marks})", tuple(kept))

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a connection whose changes are on the disk when the block ends, all or none."""
        place = self.path.absolute().as_uri()
        if not (os.access(self.path.parent, os.W_OK) or Path(f"{self.path}-wal").exists()):
            place += "?immutable=1"  # a folder that can only be read has no room for a log
        try:
            with closing(sqlite3.connect(place, uri=True)) as connection:
                connection.execute("PRAGMA synchronous = FULL")
                with connection:
                    yield connection
        except (sqlite3.DatabaseError, ValueError, TypeError) as error:
            # the lowest byte of an error that is not about what is in the file
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
    found = Evaluation(_floats(point), loss, _floats(errors), log_likelihoods=likelihoods)
    return Record(Stage(stage), found, seconds)


@dataclass
class Journal:
    """One pass over a study: what is stored is read, what is missing is made and stored."""

    database: Database
    objective: Objective
    dimension: int  # d, the number of coordinates of a point
    seed: int
    workers: int  # evaluations at a time
    # every stored evaluation, of this pass or an earlier one, by the bytes of its point
    known: dict[bytes, Record] = field(init=False)
    records: list[Record] = field(default_factory=list, init=False)  # asked for so far, in order

    def __post_init__(self) -> None:
        self.known = {_bytes(r.evaluation.point): r for r in self.database.records()}

    @property
    def evaluations(self) -> list[Evaluation]:
        """Those of `records`."""
        return [record.evaluation for record in self.records]

    def rng(self, stage: Stage, step: int) -> np.random.Generator:
        """The only source of randomness of a step."""
        return np.random.default_rng([self.seed, list(Stage).index(stage), step])

    def propose(self, stage: Stage, step: int, compute: Compute) -> Floats:
        """Give the points of a step, counted from 0 in its stage, made where none are stored."""
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
        """Give the outcomes at `points`, each of shape (d,).

        Those that are not known are evaluated, and stored as soon as the next `batch` of them, or
        else `workers`, is there. Ctrl-C waits for that. `progress` is called with how many are
        known whenever some were stored, and at the end.
        """
        keys = [_bytes(point) for point in points]
        missing = {k: p for k, p in zip(keys, points, strict=True) if k not in self.known}
        left = list(missing.values())
        size = batch or self.workers
        # closed at once when interrupted: what no worker has begun is not begun any more
        with closing(outcome for outcome in (self.objective(left) if left else ())) as outcomes:
            for start in range(0, len(left), size):
                with interrupted_afterwards():
                    self._store(stage, left[start : start + size], outcomes)
                progress(len(points) - max(0, len(left) - start - size))
        if not left:
            progress(len(points))
        # a point may have been evaluated in another stage, when there were fewer steps
        found = [replace(self.known[key], stage=stage) for key in keys]
        self.records += found
        return [record.evaluation for record in found]

    def _store(
        self, stage: Stage, points: Sequence[Floats], outcomes: Iterator[Evaluation]
    ) -> None:
        """Store the next outcomes, which are those at `points`."""
        begin = time.perf_counter()
        evaluations = [replace(next(outcomes), point=point) for point in points]
        seconds = (time.perf_counter() - begin) / len(points)
        for evaluation in evaluations:
            _check(evaluation)
        new = [Record(stage, evaluation, seconds) for evaluation in evaluations]
        self.database.append(new)
        self.known |= {_bytes(record.evaluation.point): record for record in new}


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


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Let Ctrl-C end the block only when it is done; a second one does not wait.

    Nothing is changed where Ctrl-C is ignored, nor in any thread but the main one, which alone
    hears of it.
    """
    here = threading.current_thread() is threading.main_thread()
    if not here or not callable(signal.getsignal(signal.SIGINT)):
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
        signal.raise_signal(signal.SIGINT)  # as whoever listened before wants it
