"""The patients of a cohort on the workers of a Dask cluster.

A worker has one patient at a time, whatever the number of its threads, all of which simulate. Where
a patient goes is decided here and not by the scheduler: that would give a worker as many patients
as it has threads, and count the end of a worker against all of them.
"""

from __future__ import annotations

import socket
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask
from distributed import KilledWorker, Worker, get_worker
from distributed.core import Status as WorkerStatus

from fascicle.core.errors import InputError
from fascicle.core.files import is_outside_allowed, outside_allowed
from fascicle.core.progress import Progress
from fascicle.patients.outcome import Outcome, Status
from fascicle.patients.patient import Patient, bug, failed, fit_patient
from fascicle.study.cluster import TIMEOUT, Cluster
from fascicle.study.lock import HeldError
from fascicle.study.pool import Threads

ATTEMPTS = 10  # of a patient whose workers were lost, or who is held by another process
AGAIN_AFTER = 30.0  # s, in which a lost worker has ended
POLL = 1.0  # s between looks at which workers there are
VISIBLE_WITHIN = 30.0  # s, until a network file system shows a new file everywhere


@dataclass(frozen=True)
class _Waiting:
    """A patient who is not at work: how often that was tried, and when it may be again (s)."""

    patient: Patient
    attempts: int = 0
    not_before: float = 0.0

    @property
    def again(self) -> _Waiting:
        return _Waiting(self.patient, self.attempts + 1, time.monotonic() + AGAIN_AFTER)

    @property
    def tried_enough(self) -> bool:
        return self.attempts + 1 >= ATTEMPTS


def fit_on_workers(
    cluster: Cluster, patients: Sequence[Patient], report: Callable[[str], None]
) -> Iterator[Outcome]:
    """Fit patients, a worker each; outcomes as soon as they are there.

    Where a worker is lost, its patient goes on at another one, with the evaluations that are kept.

    Parameters
    ----------
    cluster : Cluster
        Its workers may come and go.
    patients : sequence of Patient
        Their folders must be seen by the workers.
    report : callable
        Called with what is at work.

    Raises
    ------
    InputError
        If a worker does not see the folder of the cohort, or the scheduler is lost.
    """
    waiting = deque(map(_Waiting, patients))
    running: dict[Any, tuple[_Waiting, str]] = {}  # futures: who, and at which worker
    if not patients:
        return
    with _marker(patients) as marker:
        try:
            while waiting or running:
                there = cluster.threads()
                _start(cluster, there, waiting, running, marker)
                report(f"{len(running)} at work" if there else "waiting for workers")
                _pause(running)
                for future, (tried, address) in list(running.items()):
                    outcome = _ended(future, tried, lost=address not in there)
                    if outcome is None:
                        continue
                    del running[future]
                    cluster.cancel([future])  # a lost worker's is not begun again there
                    if outcome.status is Status.NOT_DONE and not tried.tried_enough:
                        waiting.append(tried.again)
                    else:
                        yield outcome
        finally:
            cluster.cancel(list(running))


@contextmanager
def _marker(patients: Sequence[Patient]) -> Iterator[Path]:
    """Give a file in the cohort's folder, which a worker must see."""
    path = patients[0].folder.parent / f".seen-{uuid.uuid4().hex}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    try:
        yield path
    finally:
        path.unlink()


def _start(
    cluster: Cluster,
    there: dict[str, int],
    waiting: deque[_Waiting],
    running: dict[Any, tuple[_Waiting, str]],
    marker: Path,
) -> None:
    """Give each worker without a patient the next one whose time has come."""
    busy = {address for _, address in running.values()}
    for address in there.keys() - busy:
        due = next((w for w in waiting if w.not_before <= time.monotonic()), None)
        if due is None:
            return
        waiting.remove(due)
        future = cluster.client.submit(
            _fit_here,
            due.patient,
            marker,
            is_outside_allowed(),
            key=f"fascicle-{due.patient.name}-{uuid.uuid4().hex}",
            workers=[address],
            allow_other_workers=False,
            pure=False,
        )
        running[future] = due, address


def _pause(running: Iterable[Any]) -> None:
    """Wait until a patient is done, but not for long."""
    until = time.monotonic() + POLL
    while time.monotonic() < until and not any(future.done() for future in running):
        time.sleep(POLL / 20)


def _ended(future: Any, tried: _Waiting, *, lost: bool) -> Outcome | None:
    """What has become of a patient who was at work; None if that goes on."""
    if future.status == "finished":
        with suppress(OSError, CancelledError):  # the worker is lost before it has told
            outcome: Outcome = future.result(timeout=TIMEOUT)
            return outcome
        if future.status == "finished":  # the scheduler is silent, and will tell
            return None
    error = future.exception() if future.status == "error" else None
    if isinstance(error, InputError):  # not of the patient, which is an outcome
        raise error
    if error is not None and not isinstance(error, KilledWorker):
        return bug(tried.patient, error)
    if future.status == "pending" and not lost:
        return None
    if tried.tried_enough:
        return failed(
            tried.patient,
            f"its worker was lost {ATTEMPTS} times; see what the workers say, such as that their "
            "memory or time is up",
        )
    return Outcome(patient=tried.patient.name, status=Status.NOT_DONE)


def _fit_here(patient: Patient, marker: Path, outside: bool) -> Outcome:
    """What a worker does; the outcome is `NOT_DONE` where another process works on the patient."""
    worker = get_worker()
    _check_seen(marker)
    with ExitStack() as around:
        # or xarray, which sees Dask here, asks the scheduler for leave to write a file
        around.enter_context(dask.config.set(scheduler="threads"))
        if outside:
            around.enter_context(outside_allowed())
        try:
            return fit_patient(patient, Threads(worker.state.nthreads), _stopped(worker))
        except (HeldError, KeyboardInterrupt) as error:
            reason = str(error) or "its worker was about to close"
            return Outcome(patient=patient.name, status=Status.NOT_DONE, reason=reason)


def _check_seen(marker: Path) -> None:
    """Refuse a worker that does not see the cohort's folder."""
    until = time.monotonic() + VISIBLE_WITHIN
    while not marker.exists():
        if time.monotonic() > until:
            raise InputError(
                f"{marker.parent.parent}: not seen by the worker on {socket.gethostname()}; put "
                "--out, hearts and recordings on a file system that all workers share"
            )
        time.sleep(POLL)


def _stopped(worker: Worker) -> Progress:
    """Progress callback that ends a fit for which nobody waits any more, or whose worker closes."""
    key = worker.get_current_task()

    def check(stage: str, done: int, total: int, message: str) -> None:
        task = worker.state.tasks.get(key)
        wanted = task is not None and task.state == "executing"
        if not wanted or worker.status in (WorkerStatus.closing, WorkerStatus.closed):
            raise KeyboardInterrupt

    return check
