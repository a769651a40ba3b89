"""The database of a study: durable evaluations and proposals."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fascicle.core.errors import InputError
from fascicle.inference.evaluation import Evaluation


@dataclass(frozen=True)
class Record:
    """An evaluation as it was stored: when in the study, and how long it took (s)."""

    stage: str
    evaluation: Evaluation
    seconds: float


class Ledger:
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
                stage,
                Evaluation(
                    _floats(point), loss if loss is not None else np.nan, _floats(errors), reason
                ),
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
                record.evaluation.reason,
                record.seconds,
            )
            for k, record in enumerate(records)
        ]
        with self._transaction() as connection:
            connection.executemany("INSERT INTO evaluations VALUES (?, ?, ?, ?, ?, ?, ?)", rows)

    def proposal(self, stage: str, step: int) -> tuple[str | None, NDArray[np.float64]] | None:
        """Hyper-parameters and flat points of a step; None if it has not been taken."""
        query = "SELECT hyperparameters, points FROM proposals WHERE stage = ? AND step = ?"
        with self._transaction() as connection:
            row = connection.execute(query, (stage, step)).fetchone()
        return (row[0], _floats(row[1])) if row is not None else None

    def propose(
        self, stage: str, step: int, hyperparameters: str | None, points: NDArray[np.float64]
    ) -> None:
        """Store what a step proposes."""
        row = (stage, step, hyperparameters, _bytes(points))
        with self._transaction() as connection:
            connection.execute("INSERT INTO proposals VALUES (?, ?, ?, ?)", row)


def _bytes(array: NDArray[np.float64]) -> bytes:
    return np.ascontiguousarray(array, dtype="<f8").tobytes()


def _floats(blob: bytes) -> NDArray[np.float64]:
    return np.frombuffer(blob, dtype="<f8").astype(np.float64)
