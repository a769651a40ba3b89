"""Workers of a Dask cluster, which may die, join late and be restarted.

The heart goes to every worker once, and to those that come later when they come; the scheduler
keeps it for them. Jobs are named by their content, so that one that is sent again is the same job.
"""

from __future__ import annotations

import asyncio
import hashlib
import pickle
import re
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, TypeVar

from distributed import Client, KilledWorker, Worker, WorkerPlugin, get_worker

from fascicle.core.errors import InputError, one_line
from fascicle.core.progress import Lines, Progress, progress_of
from fascicle.core.ranges import shown
from fascicle.core.threads import keep_one_thread
from fascicle.forward.model import WrittenModel
from fascicle.study.pool import Remote, Task, run_part

Item = TypeVar("Item")
Result = TypeVar("Result")

TIMEOUT = 30  # s, until a scheduler has answered
NOTICED = 1  # s between looks at what is waited for
ANSWERED = 5  # s that a scheduler has to say which workers it has
PAUSE = 0.5  # s before a broken connection is tried again
RETRIES = 20  # of a job whose workers were lost, which a walltime does to all that wait there
RUNNING = "running"  # a client that has its scheduler
ADDRESS = r"(tcp|tls)://[^/\s]+:\d{1,5}"
KEY = 24  # digits of a name by content


class WorkerData(WorkerPlugin):
    """What a worker is given when it joins, and keeps: a model, or what is asked of one.

    Parameters
    ----------
    name : str
        Of its content.
    files : dict of name to bytes
        Of a model.
    small : object
        What is not in them.
    """

    def __init__(self, name: str, files: dict[str, bytes], small: Any) -> None:
        self.name, self.files, self.small = name, files, small
        self.folder: Path | None = None

    def setup(self, worker: Worker) -> None:
        """Write the files for this worker to read; BLAS takes one thread here from now on."""
        keep_one_thread()  # jobs of several threads would set it back for one another
        folder = Path(mkdtemp(prefix="fascicle-", dir=worker.local_directory))
        try:
            for name, content in self.files.items():
                (folder / name).write_bytes(content)
        except OSError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self.files.clear()  # they are on the worker's disk
        self.folder = folder  # last: a job may already be waiting for it

    def teardown(self, worker: Worker) -> None:
        """Remove the files."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


class Cluster(Remote):
    """Workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``"tcp://10.0.0.1:8786"``.
    progress : Progress, "lines" or None
        Called, with the stage "workers", while it has none or does not answer; or lines on standard
        error; or nothing.

    Raises
    ------
    InputError
        If it is no address, or no scheduler answers there.
    """

    def __init__(self, address: str, progress: Progress | Lines | None = "lines") -> None:
        if not isinstance(address, str) or not re.fullmatch(ADDRESS, address):
            raise InputError(
                f"{shown(address)} is no address of a Dask scheduler; it prints its own when it "
                "starts, such as tcp://10.0.0.1:8786"
            )
        self.progress = progress_of(progress)
        try:
            self.client: Any = Client(address, timeout=TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
        except (OSError, TypeError) as error:  # the second of TLS that is not configured
            raise InputError(
                f"{address}: no Dask scheduler answers ({one_line(error)}); start one with "
                "'dask scheduler', and workers with 'dask worker ADDRESS'"
            ) from error
        super().__init__()
        self.address = address
        self._known: set[str] = set()
        self._connection = self.client.scheduler_comm
        self._waits = False  # for a worker, or for the scheduler

    @property
    def workers(self) -> int:  # type: ignore[override]
        """Threads of the workers that are there now, 1 at least."""
        return max(1, sum(self.threads().values()))

    def threads(self) -> dict[str, int]:
        """Threads of each worker that is there now, by its address."""
        there: dict[str, int] = self._ask(self.client.nthreads)
        return there

    def _submit(self, *job: Any) -> Any:
        self._check_there()
        key = f"fascicle-{_name(pickle.dumps(job))}"
        return self.client.submit(_job, *job, key=key, pure=False)

    def cancel(self, futures: Sequence[Any]) -> None:
        """Cancel jobs, unless losing the scheduler has done so."""
        if self.client.status == RUNNING:
            self.client.cancel(futures)

    def _results(self, futures: Sequence[Any]) -> Sequence[Any]:
        """Fetch together what jobs have given: one by one each would take some milliseconds."""
        first = self._result(futures[0])
        try:
            return [first, *self._gather(futures[1:])]
        except KilledWorker:  # of one that had ended: what it had given was lost with it
            return [first, *map(self._result, futures[1:])]

    def _result(self, future: Any) -> Any:
        """Wait for a job; where its workers were lost it is done again, by others."""
        for _ in range(RETRIES):
            try:
                return self._gather([future])[0]
            except KilledWorker:
                self._ask(self.client.retry, [future])
        return self._gather([future])[0]

    def _gather(self, futures: Sequence[Any]) -> list[Any]:
        """Wait for jobs, and fetch what they have given."""
        if not futures:
            return []
        results: list[Any] = self._ask(self.client.gather, list(futures), jobs=futures)
        return results

    def _ask(self, method: Callable[..., Any], *given: Any, jobs: Sequence[Any] = ()) -> Any:
        """Ask the client for something, again where a connection broke, as a lost worker's does.

        A job's own error is raised as it is.
        """
        for tried in range(RETRIES + 1):
            try:
                return self._wait_for(method, *given)
            except OSError as error:
                if any(job.status == "error" and job.exception() is error for job in jobs):
                    raise
                self._check_there(error)
                of_workers = error.errno is not None and not isinstance(error, ConnectionError)
                if of_workers or tried == RETRIES:
                    raise InputError(
                        f"{self.address}: its workers fail ({one_line(error)}); see what they say"
                    ) from error
                time.sleep(PAUSE)
            except CancelledError as error:
                if self._same_scheduler:
                    raise InputError(
                        f"{self.address}: jobs were cancelled there ({one_line(error)}); what is "
                        "evaluated is kept, and the same command goes on"
                    ) from error
                raise self._lost() from error  # by the client, when it lost its scheduler
        raise AssertionError("the last try returns or raises")

    def _wait_for(self, method: Callable[..., Any], *given: Any) -> Any:
        """Wait as long as it takes, since jobs may be long; say meanwhile what is waited for."""
        answer = self._begin(method, *given)
        try:
            while not wait([answer], NOTICED).done:
                self._say(self._what_is_missing(answer))
            result = answer.result()
            self._say("")
            return result
        finally:
            answer.cancel()  # if it is interrupted

    def _begin(self, method: Callable[..., Any], *given: Any) -> Future[Any]:
        """Call a method of the client in its loop, where it waits for nothing."""
        self._check_there()

        async def call() -> Any:
            return await method(*given)

        return asyncio.run_coroutine_threadsafe(call(), self.client.loop.asyncio_loop)

    def _what_is_missing(self, answer: Future[Any]) -> str:
        """Say why an answer does not come, in words; empty if it just takes its time."""
        threads = self._begin(self.client.nthreads)
        try:
            wait([threads, answer], ANSWERED, FIRST_COMPLETED)
            if answer.done() or threads.result(timeout=0):
                return ""
            return "has no worker; waiting for one"
        except OSError as error:  # no answer in time is one
            self._check_there(error)
            return "does not answer; waiting for it"
        finally:
            threads.cancel()

    def _say(self, missing: str) -> None:
        if self.progress is not None and (missing or self._waits):
            message = f"{self.address} {missing}" if missing else ""
            self.progress("workers", int(not missing), 1, message)
        self._waits = bool(missing)

    @property
    def _same_scheduler(self) -> bool:
        """Whether the connection is the one through which models were sent."""
        there: bool = self.client.status == RUNNING
        return there and self.client.scheduler_comm is self._connection

    def _check_there(self, error: OSError | None = None) -> None:
        """Say so in one line if the scheduler is lost."""
        if self.client.status != RUNNING:
            raise self._lost() from error

    def _lost(self) -> InputError:
        return InputError(
            f"{self.address}: the Dask scheduler was lost; what is evaluated is kept: start it "
            "again, and the same command goes on"
        )

    def _model(self, task: Task) -> Any:
        if not self._same_scheduler:  # a restarted one has no models
            self._connection = self.client.scheduler_comm
            self._known.clear()
            self._models.clear()
        return super()._model(task)

    def _send(self, task: Task) -> str:
        with TemporaryDirectory(prefix="fascicle-") as folder:
            written = task.model.write(Path(folder), task.bodies)
            files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
        return self._hold(files, (written.conduction, written.rules, written.action_potential))

    def _rest(self, portable: Any) -> str:
        return self._hold({}, portable)

    def _hold(self, files: dict[str, bytes], small: Any) -> str:
        """Give all workers, those that come later too, something to keep; its name."""
        name = f"fascicle-{_name(pickle.dumps((files, small)))}"
        if name not in self._known:
            self._ask(self.client.register_plugin, WorkerData(name, files, small))
            self._known.add(name)
        return name


def _name(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:KEY]


def _held(name: str) -> tuple[Path, Any]:
    """What this worker was given; a worker that has just joined gets its jobs sooner than that."""
    worker = get_worker()
    until = time.monotonic() + TIMEOUT
    while time.monotonic() < until:
        held = worker.plugins.get(name)
        if isinstance(held, WorkerData) and held.folder is not None:
            return held.folder, held.small
        time.sleep(0.1)
    raise RuntimeError(f"worker {worker.address} was never given {name}")


def _job(
    model: str, rest: str, function: Callable[[Any, Item], Result], items: Sequence[Item]
) -> list[Result]:
    folder, small = _held(model)
    _, portable = _held(rest)
    task: Task = portable.of(WrittenModel(folder, *small).read())
    return run_part(task, function, items)
