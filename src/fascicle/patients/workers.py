"""The patients of a cohort on the workers of a Dask cluster.

A worker fits one patient at a time and simulates on all its threads. Patients are assigned here
and not by the scheduler, which would give a worker as many patients as it has threads, and count
the loss of a worker against all of them.
"""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import nullcontext
from typing import Any

import dask
from distributed import KilledWorker, Worker, get_worker
from distributed.core import Status as WorkerStatus

from fascicle.core.errors import InputError, OutputError
from fascicle.core.files import is_outside_allowed, outside_allowed
from fascicle.core.progress import Progress
from fascicle.patients.patient import Outcome, Patient, Status, fit_patient
from fascicle.pools.cluster import Cluster
from fascicle.pools.pool import Threads
from fascicle.study.study import HeldError


def fit_on_workers(
    cluster: Cluster,
    patients: Sequence[Patient],
    report: Callable[[str], None],
    attempts: int = 10,
    pause: float = 30.0,
) -> Iterator[Outcome]:
    """Fit each patient on one worker; yield outcomes as patients finish.

    If a worker is lost, another one resumes its patient from the stored evaluations. A patient
    whose workers are lost, or whom another process is fitting, is tried `attempts` times, with a
    `pause` (s) before every attempt but the first. InputError means that a worker does not see the
    folder of the cohort, or that the scheduler is lost.
    """
    waiting = deque((patient, 1) for patient in patients)  # with the number of the attempt
    running: dict[Any, tuple[Patient, int, str]] = {}  # patient, attempt, address
    for patient in patients:
        patient.folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        while waiting or running:
            available = cluster.threads()
            for address in available.keys() - {address for _, _, address in running.values()}:
                if waiting:
                    patient, attempt = waiting.popleft()
                    job = patient, pause if attempt > 1 else 0.0, is_outside_allowed()
                    future = cluster.client.submit(_fit_here, *job, workers=[address], pure=False)
                    running[future] = patient, attempt, address
            report(f"{len(running)} at work" if available else "waiting for workers")
            until = time.monotonic() + 1.0
            while time.monotonic() < until and not any(future.done() for future in running):
                time.sleep(0.05)
            for future, (patient, attempt, address) in list(running.items()):
                if future.status == "pending" and address in available:
                    continue
                del running[future]
                outcome = _ended(future, patient)
                # else the scheduler would restart the task of a lost worker
                cluster.cancel([future])
                if outcome.status is not Status.NOT_DONE:
                    yield outcome
                elif attempt < attempts:
                    waiting.append((patient, attempt + 1))
                elif outcome.reason:
                    yield outcome
                else:
                    yield patient.failed(
                        f"its worker was lost {attempts} times; see what the workers say, such as "
                        "that their memory or time is up"
                    )
    finally:
        cluster.cancel(list(running))


def _ended(future: Any, patient: Patient) -> Outcome:
    """Outcome of a patient whose fit has ended; `NOT_DONE` if the worker was lost."""
    try:
        if future.status != "pending":
            outcome: Outcome = future.result(timeout=30)
            return outcome
    except (KilledWorker, CancelledError, OSError):  # lost, perhaps before it returned its outcome
        pass
    except InputError:  # about the cluster or the folder; a patient's own become outcomes
        raise
    except Exception as error:  # noqa: BLE001 - a patient's bug must not stop the others; it is shown
        return patient.bug(error)
    return Outcome(patient=patient.name, status=Status.NOT_DONE)


def _fit_here(patient: Patient, pause: float, outside: bool) -> Outcome:
    """Fit a patient on this worker; `NOT_DONE` if another process is fitting the patient."""
    worker = get_worker()
    time.sleep(pause)
    _check_seen(patient)
    # else xarray, which detects Dask here, asks the scheduler for a lock to write a file
    with dask.config.set(scheduler="threads"), outside_allowed() if outside else nullcontext():
        try:
            return fit_patient(patient, Threads(worker.state.nthreads), _stopped(worker))
        except (HeldError, KeyboardInterrupt) as error:
            reason = str(error) or "its worker was about to close"
            return Outcome(patient=patient.name, status=Status.NOT_DONE, reason=reason)


def _check_seen(patient: Patient, patience: float = 30.0) -> None:
    """Refuse a worker that does not see the cohort's folder, as network file systems do in 30 s."""
    until = time.monotonic() + patience
    while not patient.folder.parent.exists():
        if time.monotonic() > until:
            raise OutputError(
                f"{patient.cohort}: not seen by the worker on {socket.gethostname()}; put --out, "
                "hearts and recordings on a file system that all workers share"
            )
        time.sleep(patience / 30)


def _stopped(worker: Worker) -> Progress:
    """Progress callback that ends a fit that was cancelled, or whose worker is closing."""
    key = worker.get_current_task()

    def check(stage: str, done: int, total: int, message: str) -> None:
        task = worker.state.tasks.get(key)
        executing = task is not None and task.state == "executing"
        if not executing or worker.status in (WorkerStatus.closing, WorkerStatus.closed):
            raise KeyboardInterrupt

    return check
