"""What a study has evaluated and proposed, kept in a database as soon as it is there."""

from __future__ import annotations

import shutil
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from fascicle.core.arrays import Floats
from fascicle.core.errors import InputError, one_line
from fascicle.core.files import atomic_path
from fascicle.inference.evaluation import Evaluation, Objective
from fascicle.study.interruption import interrupted_afterwards

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


MENDED = "run 'fascicle fit' on the study again, which keeps what can be read"
NOT_ITS_CONTENT = (  # errors of SQLite that are not about what is in the file
    sqlite3.SQLITE_BUSY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PERM, sqlite3.SQLITE_READONLY,
)  # fmt: skip
# of a damaged file; the second of texts in it, also in what SQLite says of it
UNREADABLE = (sqlite3.DatabaseError, UnicodeDecodeError)
SMALLEST_ROW = 32  # bytes in the file, less than any row takes
TABLES = {
    "evaluations": "stage TEXT NOT NULL, point BLOB NOT NULL, loss REAL, "
    "beat_errors BLOB NOT NULL, log_likelihoods BLOB NOT NULL, reason TEXT NOT NULL, "
    "seconds REAL NOT NULL, checksum INTEGER NOT NULL",
    "proposals": "stage TEXT NOT NULL, step INTEGER NOT NULL, hyperparameters TEXT, "
    "points BLOB NOT NULL, checksum INTEGER NOT NULL, PRIMARY KEY (stage, step)",
}
Row = tuple[Any, ...]  # of one of the tables, in the order of its columns


class DamagedStoreError(InputError):
    """A database cannot be read, or a row in it is not as it was written."""


class Database:
    """The SQLite file: evaluations as they were made, and what was proposed at each step.

    Every row has a checksum of its own, since SQLite does not notice a changed number.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def prepare(self) -> None:
        """Make the tables where they are missing."""
        with self._transaction() as connection:
            for name, columns in TABLES.items():
                connection.execute(f"CREATE TABLE IF NOT EXISTS {name} ({columns})")

    def check(self) -> None:
        """Read everything.

        Raises
        ------
        DamagedStoreError
            If something of it cannot be read.
        """
        with self._transaction() as connection:
            (verdict,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
            if verdict != "ok":
                raise DamagedStoreError(f"{self.path}: {one_line(verdict)}; {MENDED}")
            for name in TABLES:
                for row in connection.execute(f"SELECT * FROM {name}"):
                    self._checked(row)

    def records(self) -> list[Record]:
        """All evaluations, in the order in which they were made."""
        with self._transaction() as connection:
            rows = connection.execute("SELECT * FROM evaluations ORDER BY rowid").fetchall()
        return [_record(self._checked(row)) for row in rows]

    def append(self, records: Sequence[Record]) -> None:
        """Store evaluations, which are on the disk when this returns."""
        self._insert("evaluations", [_evaluation_row(record) for record in records])

    def steps(self, stage: Stage) -> int:
        """Count the proposals of a stage."""
        query = "SELECT count(*) FROM proposals WHERE stage = ?"
        with self._transaction() as connection:
            return int(connection.execute(query, (stage,)).fetchone()[0])

    def proposal(self, stage: Stage, step: int) -> tuple[str | None, Floats] | None:
        """Hyper-parameters and flat points of a step; None if it has not been taken."""
        query = "SELECT * FROM proposals WHERE stage = ? AND step = ?"
        with self._transaction() as connection:
            row = connection.execute(query, (stage, step)).fetchone()
        if row is None:
            return None
        _, _, hyperparameters, points, _ = self._checked(row)
        return hyperparameters, _floats(points)

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
        self._insert("proposals", [(str(stage), step, hyperparameters, _bytes(points))])

    def forget_proposals(self, kept: Sequence[Stage]) -> None:
        """Drop what was proposed in other stages than these; evaluations stay."""
        marks = ", ".join("?" for _ in kept)
        with self._transaction() as connection:
            connection.execute(f"DELETE FROM proposals WHERE stage NOT IN ({marks})", tuple(kept))

    def mend(self) -> int:
        """Keep the rows that can be read, and say how many evaluations are among them.

        The damaged file stays beside the new one.
        """
        aside = self.path.with_suffix(f".damaged{self.path.suffix}")
        # of a transaction cut short; SQLite finds it by its name
        journal, journal_aside = (p.with_name(f"{p.name}-journal") for p in (self.path, aside))
        journal_aside.unlink(missing_ok=True)
        shutil.copyfile(self.path, aside)
        if journal.exists():
            shutil.copyfile(journal, journal_aside)
        readable = {name: list(_readable(aside, name)) for name in TABLES}
        with atomic_path(self.path) as temporary:
            new = Database(temporary)
            new.prepare()
            for name, rows in readable.items():
                new._insert(name, rows)
            journal.unlink(missing_ok=True)  # it is not the new file's
        return len(readable["evaluations"])

    def _insert(self, table: str, rows: Sequence[Row]) -> None:
        """Add rows (without their checksums) to a table, all or none."""
        with self._transaction() as connection:
            for row in rows:
                whole = (*row, _checksum(row))
                marks = ", ".join("?" for _ in whole)
                connection.execute(f"INSERT INTO {table} VALUES ({marks})", whole)

    def _checked(self, row: Row) -> Row:
        """A row that was read, if it is as it was written."""
        if not _sound(row):
            raise DamagedStoreError(f"{self.path}: a row is not as it was written; {MENDED}")
        return row

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a connection whose changes are on the disk when the block ends, all or none."""
        try:
            with closing(sqlite3.connect(self.path)) as connection:
                connection.execute("PRAGMA synchronous = FULL")
                with connection:
                    yield connection
        except UNREADABLE as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR)
            if code & 0xFF not in NOT_ITS_CONTENT:  # the lowest byte is the primary code
                raise DamagedStoreError(f"{self.path}: {one_line(error)}; {MENDED}") from error
            raise InputError(
                f"{self.path}: {error}; see that the disk has space, that the file can be written, "
                "and that nothing else uses it; the same command then goes on"
            ) from error


def _readable(path: Path, table: str) -> Iterator[Row]:
    """Rows of a damaged file that are as they were written, without their checksums."""
    most = path.stat().st_size // SMALLEST_ROW
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA writable_schema = ON")  # reads a file that was cut off, too
        for number in range(most):
            try:
                query = f"SELECT * FROM {table} WHERE rowid = ?"
                row = connection.execute(query, (number,)).fetchone()
            except UNREADABLE:
                continue
            if row is not None and _sound(row):
                yield row[:-1]


def _evaluation_row(record: Record) -> Row:
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


def _record(row: Row) -> Record:
    stage, point, loss, errors, log_likelihoods, reason, seconds, _ = row
    if loss is None:
        return Record(Stage(stage), Evaluation.infeasible(_floats(point), reason), seconds)
    likelihoods = _floats(log_likelihoods)
    found = Evaluation(_floats(point), loss, _floats(errors), log_likelihoods=likelihoods)
    return Record(Stage(stage), found, seconds)


def _checksum(row: Row) -> int:
    """Of what a row holds; numbers and blobs come back from SQLite with the same bits."""
    return zlib.crc32(repr(row).encode())


def _sound(row: Row) -> bool:
    return bool(_checksum(row[:-1]) == row[-1])


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
    known : dict of bytes to Record
        Every stored evaluation, of this pass or an earlier one, by the bytes of its point.
    before : frozenset of bytes
        Points of those of earlier passes.
    records : list of Record
        What this pass has asked for so far, in order.
    """

    database: Database
    objective: Objective
    dimension: int
    seed: int
    workers: int
    known: dict[bytes, Record] = field(init=False)
    before: frozenset[bytes] = field(init=False)
    records: list[Record] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.known = {_bytes(r.evaluation.point): r for r in self.database.records()}
        self.before = frozenset(self.known)

    @property
    def evaluations(self) -> list[Evaluation]:
        """Those of `records`."""
        return [record.evaluation for record in self.records]

    def knew(self, points: Sequence[Floats]) -> bool:
        """Whether all points, each of shape (d,), were evaluated in earlier passes."""
        return all(_bytes(point) in self.before for point in points)

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

    def evaluate(
        self,
        stage: Stage,
        points: Sequence[Floats],
        batch: int | None = None,
        progress: Callable[[int], None] = lambda done: None,
    ) -> list[Evaluation]:
        """Give the outcomes at `points`, each of shape (d,).

        Those that are not known are evaluated, and stored as soon as the next `batch` of them, or
        else `workers`, is there. Ctrl-C waits for that.

        Parameters
        ----------
        stage : Stage
            That asks for them.
        points : sequence of (d,) arrays
            In the unit cube.
        batch : int, optional
            How many are stored at a time.
        progress : callable
            Told how many of the points are known whenever some were stored, and at the end.
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
        new = [Record(stage, evaluation, seconds) for evaluation in evaluations]
        for record in new:
            _check(record.evaluation)
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
